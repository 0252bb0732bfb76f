"""Ranges are those of what takes the numbers, not of what holds them."""

import mitsuba as mi
import numpy as np
import pytest
import trimesh
from icc import P3, profile
from PIL import Image

from isas_cli.config.schema import UnknownConfig
from isas_cli.engine import assemble
from isas_cli.runtime.errors import InputError
from isas_cli.unknowns import ranges, registry, routes
from isas_cli.unknowns.kind import Loaded
from isas_cli.unknowns.specs import parse
from isas_cli.unknowns.unknowns import Unknowns
from isas_cli.unknowns.value import Value

INFINITE = np.inf


def bitmap(channels: int) -> dict:
    """Anew each time: the plugin takes the tensor's memory."""
    texels = mi.TensorXf(np.full((2, 2, channels), 0.5, np.float32))
    return {"type": "bitmap", "data": texels, "raw": True}


DIFFUSE = {"type": "diffuse"}


def ball(**bsdf) -> mi.SceneParameters:
    described = {"type": "scene", "ball": {"type": "sphere", "bsdf": bsdf}}
    return mi.traverse(mi.load_dict(described, optimize=False))


UNIT = (0.0, 1.0)
OF_BSDFS = {
    "mask": ({"opacity": 0.5, "a": DIFFUSE}, {"opacity.value": UNIT}),
    "mask, bitmap": ({"opacity": bitmap(1), "a": DIFFUSE}, {"opacity.data": UNIT}),
    "blendbsdf": ({"weight": 0.5, "a": DIFFUSE, "b": DIFFUSE}, {"weight.value": UNIT}),
    "dielectric": ({"specular_transmittance": 0.9}, {"specular_transmittance.value": UNIT}),
    "roughdielectric": ({"int_ior": 1.5}, {"eta": (1.001, INFINITE), "alpha.value": (0.03, 1)}),
    # A bubble in water.
    "roughdielectric, thin": ({"int_ior": 1.0, "ext_ior": 1.33}, {"eta": (0.1, 0.999)}),
    "roughconductor": ({"material": "Au"}, dict.fromkeys(("eta.value", "k.value"), (0, INFINITE))),
    "conductor": ({"material": "Ag"}, dict.fromkeys(("eta.value", "k.value"), (0, INFINITE))),
    "principled": (
        {"specular": 0.5, "roughness": bitmap(1)},
        {
            "specular": (0.001, 1.0),
            "roughness.data": (0.03, 1.0),
            **dict.fromkeys(("clearcoat.value", "clearcoat_gloss.value", "sheen.value"), UNIT),
            **dict.fromkeys(("sheen_tint.value", "spec_tint.value", "flatness.value"), UNIT),
            **dict.fromkeys(("anisotropic.value", "metallic.value", "spec_trans.value"), UNIT),
        },
    ),
    "principled, eta": ({"eta": 1.5}, {"eta": (1.001, INFINITE)}),
    "principledthin": ({}, {"diff_trans.value": (0.0, 2.0), "eta.value": (1.001, INFINITE)}),
    "hair": (
        {},
        {
            "longitudinal_roughness": (0.03, 1.0),
            "eumelanin": (0.0, INFINITE),
            "eta": (1.001, INFINITE),
        },
    ),
    "normalmap": ({"normalmap": bitmap(3), "a": DIFFUSE}, {"normalmap.data": UNIT}),
}


@pytest.mark.parametrize("name", OF_BSDFS)
def test_a_material_gives_its_parameters_their_ranges(name):
    given, wanted = OF_BSDFS[name]
    params = ball(type=name.partition(",")[0], **given)
    found = {word: ranges.usual(params, f"ball.bsdf.{word}")[:2] for word in wanted}
    assert found == wanted


def test_a_texture_within_a_texture_takes_the_range_of_what_it_feeds():
    chequers = {"type": "checkerboard", "color0": 0.2, "color1": bitmap(1)}
    params = ball(type="mask", opacity=chequers, a=DIFFUSE)
    assert ranges.usual(params, "ball.bsdf.opacity.color0.value")[:2] == UNIT
    assert ranges.usual(params, "ball.bsdf.opacity.color1.data")[:2] == UNIT


def test_lights_and_what_shines_through_them_are_not_negative():
    spot = {"type": "spot", "texture": bitmap(3)}
    panel = {"type": "rectangle", "emitter": {"type": "area", "radiance": bitmap(3)}}
    described = {"type": "scene", "spot": spot, "panel": panel}
    params = mi.traverse(mi.load_dict(described, optimize=False))
    positive = 0.0, INFINITE
    assert ranges.usual(params, "spot.texture.data")[:2] == positive
    assert ranges.usual(params, "panel.emitter.radiance.data") == (*positive, "radiance")


def test_what_several_share_lies_in_the_ranges_of_all():
    reference = {"type": "ref", "id": "paint"}
    bsdf = {"type": "principled", "base_color": reference, "roughness": reference}
    described = {"type": "scene", "paint": bitmap(1), "ball": {"type": "sphere", "bsdf": bsdf}}
    params = mi.traverse(mi.load_dict(described, optimize=False))
    (key,) = (key for key in params.keys() if key.endswith(".data"))
    assert ranges.usual(params, key)[:2] == (0.03, 1.0)
    assert ranges.role(params, key) == "colour"


@pytest.mark.parametrize("scale, most", [(1.0, 1.0), (0.5, 2.0)])
def test_vertex_colours_are_what_the_material_reads(scale, most):
    texture = {"type": "mesh_attribute", "name": "vertex_color", "scale": scale}
    props = mi.Properties()
    props["bsdf"] = mi.load_dict({"type": "diffuse", "reflectance": texture})
    mesh = mi.Mesh("triangle", 3, 1, props=props)
    mesh.add_attribute("vertex_color", 3, [0.5] * 9)
    mesh.add_attribute("vertex_other", 1, [0.5] * 3)
    mesh.set_id("mesh")
    params = mi.traverse(mi.load_dict({"type": "scene", "mesh": mesh}, optimize=False))
    assert ranges.usual(params, "mesh.vertex_color")[:2] == (0.0, most)
    # Nobody reads it.
    assert ranges.usual(params, "mesh.vertex_other")[:2] == (-INFINITE, INFINITE)


def test_fog():
    fog = {"type": "homogeneous", "sigma_t": 0.5, "albedo": 0.7}
    described = {"type": "scene", "box": {"type": "cube", "interior": fog}}
    params = mi.traverse(mi.load_dict(described, optimize=False))
    found = {key: ranges.usual(params, key)[:2] for key in params.keys() if "medium" in key}
    assert found["box.interior_medium.albedo.value.value"] == UNIT
    assert found["box.interior_medium.sigma_t.value.value"] == (0.0, INFINITE)


def test_a_truth_beyond_the_range_is_told_the_range_that_holds_it():
    params = ball(type="principled", clearcoat=1.75)
    specs = {"ball.bsdf.clearcoat.value": UnknownConfig(start=0.5)}
    with pytest.raises(InputError, match=r"outside its range \[0, 1\]; give range: \[0, 1.75\]"):
        parse(params, specs, True)
    assert ranges.around(0.0, 1.0, np.float32([-0.3105, 1.3612])) == "[-0.311, 1.37]"


def test_a_start_that_nobody_gave_is_called_the_scene_s_own():
    params, key = ball(type="principled", clearcoat=1.75), "ball.bsdf.clearcoat.value"
    told = r"the start, lies outside its range \[0, 1\]; give range: \[0, 1.75\], or give another"
    with pytest.raises(InputError, match=told):
        parse(params, {key: UnknownConfig()}, False)


@pytest.mark.parametrize("g", [0.9905, 0.9962, 0.9999, -0.9999, 0.999999])
def test_a_range_that_is_told_does_not_come_to_what_cannot_be_rendered(g):
    """A phase function's g of 1, which is refused, or an index of 1."""
    low, high = map(float, ranges.around(-0.99, 0.99, np.float32([g]))[1:-1].split(", "))
    assert -1 < low <= np.float32(g) <= high < 1
    low, high = ranges.around(1.001, np.inf, np.float32([1.0004]))[1:-1].split(", ")
    assert 1 < float(low) <= np.float32(1.0004) and high == "inf"


def test_what_an_object_lacks_at_present_is_no_unknown():
    """Hair without an absorption of its own lists one that is nothing."""
    params = ball(type="hair")
    assert "ball.bsdf.sigma_a" in params
    assert "ball.bsdf.sigma_a" not in registry.offered(Loaded(params))


def test_a_range_that_is_given_may_be_wider_than_the_usual_one():
    """It is what messages advise, and values may go there."""
    params, key = ball(type="principled", clearcoat=1.75), "ball.bsdf.clearcoat.value"
    (found,) = parse(params, {key: UnknownConfig(start=0.5, range=[0, 1.75])}, True)
    assert (found.low, found.high) == pytest.approx((0, 1.75), abs=1e-5)
    fog = {"type": "homogeneous", "sigma_t": 0.5, "albedo": 0.7}
    described = {"type": "scene", "box": {"type": "cube", "interior": fog}}
    params = mi.traverse(mi.load_dict(described, optimize=False))
    key = "box.interior_medium.albedo.value.value"
    (found,) = parse(params, {key: UnknownConfig(start=5.0, range=[0, 10])}, False)
    assert found.high == 10 and found.start.max() == 5
    # A hair from an end of its own that has no derivative, and whatever is narrower.
    params, key = ball(type="principled", metallic=0.5), "ball.bsdf.metallic.value"
    for given in (None, [0, 1], [0.2, 0.7]):
        (found,) = parse(params, {key: UnknownConfig(start=0.5, range=given)}, True)
        bare = found.kind.bare
        wanted = (0.2, 0.7) if given == [0.2, 0.7] else (bare[0], 1 - bare[1])
        assert (found.low, found.high) == pytest.approx(wanted)


def grid(value: float, channels: int = 1) -> dict:
    texels = mi.TensorXf(np.full((2, 2, 2, channels), value, np.float32))
    return {"type": "gridvolume", "data": texels, "raw": True}


@pytest.mark.parametrize("shared", [False, True])
def test_a_grid_is_what_takes_it_wherever_it_stands(shared):
    """Also one that stands for itself and is referred to."""
    described = {"type": "scene"}
    fog = {"type": "heterogeneous", "sigma_t": grid(2.0), "albedo": grid(0.5, 3)}
    if shared:
        described |= {"thick": fog["sigma_t"], "bright": fog["albedo"]}
        fog |= {"sigma_t": {"type": "ref", "id": "thick"}}
        fog |= {"albedo": {"type": "ref", "id": "bright"}}
    described["box"] = {"type": "cube", "interior": fog}
    params = mi.traverse(mi.load_dict(described, optimize=False))
    density, albedo = (
        ("thick.data", "bright.data")
        if shared
        else (f"box.interior_medium.{word}.data" for word in ("sigma_t", "albedo"))
    )
    made = parse(params, {key: UnknownConfig(start=0.5) for key in (density, albedo)}, False)
    assert [(u.low, u.high) for u in made] == [(1e-3, 1e4), (0.01, 0.99)]
    assert made[0].kind.words == {"sigma_t"} and made[1].kind.words == {"albedo"}
    assert [u.kind.colours for u in made] == [False, True]


@pytest.mark.parametrize("scale, floor", [(5.0, 1e-3), (2e-4, 2e-7)])
def test_a_thin_medium_keeps_its_truth(scale, floor):
    """Of millimetres: what a density stays above is a share of what there is."""
    fog = {"type": "homogeneous", "sigma_t": scale, "albedo": 0.5}
    described = {"type": "scene", "box": {"type": "cube", "interior": fog}}
    params = mi.traverse(mi.load_dict(described, optimize=False))
    (key,) = (key for key in params.keys() if "sigma_t" in key)
    (made,) = parse(params, {key: UnknownConfig(start=2 * scale)}, True)
    assert made.low == pytest.approx(floor) and made.truth == pytest.approx(scale)
    assert not made.kind.rewrites


@pytest.mark.parametrize(
    "start, given, low",
    [(2e-4, None, 2e-7), (2e-4, [0, 1], 2e-7), (3e-4, [1e-5, 1], 1e-5), (0.0, [0, 1], 5e-4)],
)
def test_a_small_density_starts_where_it_was_told_to(start, given, low):
    """Nothing at all is a share of what the file has."""
    fog = {"type": "homogeneous", "sigma_t": 0.5, "albedo": 0.5}
    described = {"type": "scene", "box": {"type": "cube", "interior": fog}}
    params = mi.traverse(mi.load_dict(described, optimize=False))
    (key,) = (key for key in params.keys() if "sigma_t" in key)
    (made,) = parse(params, {key: UnknownConfig(start=start, range=given)}, True)
    assert made.low == pytest.approx(low) and made.start == pytest.approx(max(start, low))


def test_one_small_entry_takes_no_floor_from_the_others():
    start = np.array([1e-5, 0.5], np.float32)
    assert ranges.lowest(0.0, 1e-3, start) == 1e-3
    assert ranges.lowest(0.0, 1e-3, start[:1]) == pytest.approx(1e-8)


def test_a_thin_grid_with_nothing_in_it_stays_above_a_share_of_its_most():
    values = np.zeros((2, 2, 2, 1), np.float32)
    values[0] = 0.02
    thin = {"type": "gridvolume", "data": mi.TensorXf(values), "raw": True}
    fog = {"type": "heterogeneous", "sigma_t": thin, "albedo": grid(0.5, 3)}
    described = {"type": "scene", "box": {"type": "cube", "interior": fog}}
    params = mi.traverse(mi.load_dict(described, optimize=False))
    (made,) = parse(params, {"box.interior_medium.sigma_t.data": UnknownConfig(start=0.01)}, True)
    assert made.low == pytest.approx(2e-5) and made.truth.min() >= np.float32(made.low)


DENSITY, ALBEDO = "box.interior_medium.sigma_t.data", "box.interior_medium.albedo.data"
HALF = np.repeat(np.float32([0, 2]), 4).reshape(2, 2, 2, 1)


def cloud(kind: str = "heterogeneous", integrator: str = "prbvolpath", **own) -> mi.SceneParameters:
    box = {"type": "cube", "interior": {"type": kind, **own}}
    described = {"type": "scene", "integrator": {"type": integrator}, "box": box}
    return mi.traverse(mi.load_dict(described, optimize=False))


def half_empty() -> mi.SceneParameters:
    return cloud(sigma_t=grid(1.0) | {"data": mi.TensorXf(HALF)}, albedo=grid(0.5, 3))


@pytest.mark.parametrize("given", [None, [0, 5]])
def test_no_density_comes_to_nothing(given, tmp_path):
    """Where there is none no path tells that some is missing."""
    np.save(tmp_path / "half.npy", HALF)
    spec = UnknownConfig(start=str(tmp_path / "half.npy"), range=given)
    (made,) = parse(half_empty(), {DENSITY: spec}, True)
    for least in (made.low, made.start.min(), made.truth.min()):
        assert least == pytest.approx(1e-3)


@pytest.mark.parametrize(
    "given, least", [(None, "0.001"), ([1e-5, 5], "1e-05"), ([1e-3, 5], "0.001")]
)
def test_a_truth_is_lifted_no_farther_than_into_its_range_and_that_is_told(given, least):
    (made,) = parse(half_empty(), {DENSITY: UnknownConfig(start=1.0, range=given)}, True)
    assert made.truth.min() == pytest.approx(float(least)) and made.truth.max() == 2
    (told,) = assemble._lifted([made])
    assert f"4 of the scene's 8 numbers are below {least} and count as that" in told
    (of_photographs,) = parse(half_empty(), {DENSITY: UnknownConfig(range=given)}, False)
    assert of_photographs.start.min() == pytest.approx(float(least))
    assert assemble._lifted([of_photographs]) == []


def test_a_range_that_ends_below_what_values_stay_above_holds_its_truth():
    params, key = cloud("homogeneous", albedo=0.003), "box.interior_medium.albedo.value.value"
    (made,) = parse(params, {key: UnknownConfig(start=0.002, range=[0, 0.005])}, True)
    assert made.truth == pytest.approx(0.003) and 0 < made.low < 1e-4
    assert not made.kind.rewrites and assemble._lifted([made]) == []


class Logarithm(Value):
    """In units of its own, as examples/plugin's."""

    def __init__(self, key: str, loaded: Loaded):
        super().__init__(key, loaded)
        self.range, self.bare = [-20.0, 0.0], (0.0, 0.0)
        self.present = np.log(self.present)


def test_what_a_kind_makes_of_its_scene_s_value_is_not_lifted_as_if_it_were_that():
    params, key = cloud("homogeneous", albedo=0.003), "box.interior_medium.albedo.value.value"
    made = Logarithm(key, Loaded(params))
    assert made.rewrites
    made.heed(-7.0, 0.0)
    assert made.present == pytest.approx(np.log(0.01)) and made.lifted == 0


def test_what_a_medium_emits_may_be_black():
    grids = cloud(integrator="emission", sigma_t=grid(2.0), albedo=grid(0.0, 3))
    plain = cloud("homogeneous", "emission", sigma_t=2.0, albedo=0.0)
    for params, key in ((grids, ALBEDO), (plain, "box.interior_medium.albedo.value.value")):
        (made,) = parse(params, {key: UnknownConfig(start=0.5)}, True)
        assert made.low == 0 and not made.truth.any()


@pytest.mark.parametrize(
    "word, low, high", [("cutoff_angle", 15.1, 90.0), ("beam_width", 0.0, 19.9)]
)
def test_a_spot_keeps_an_edge_in_which_its_light_falls_off(word, low, high):
    lamp = {"type": "spot", "cutoff_angle": 20.0, "beam_width": 15.0}
    params = mi.traverse(mi.load_dict({"type": "scene", "spot": lamp}, optimize=False))
    *found, unit = ranges.usual(params, f"spot.{word}")
    assert found == pytest.approx([low, high]) and unit == "degrees"


def test_a_beam_may_not_become_wider_than_its_cone():
    lamp = {"type": "spot", "cutoff_angle": 20.0, "beam_width": 15.0}
    params = mi.traverse(mi.load_dict({"type": "scene", "spot": lamp}, optimize=False))
    beam, cone = UnknownConfig(start=16.0), UnknownConfig(start=18.0)
    both = {"spot.beam_width": beam, "spot.cutoff_angle": cone}
    with pytest.raises(InputError, match=r"might cross: give both a range, such as \[0, 16.9\]"):
        parse(params, both, True)
    beam.range, cone.range = [0.0, 16.9], [17.0, 90.0]
    assert len(parse(params, both, True)) == 2


@pytest.mark.parametrize(
    "starts, words",
    [
        ((10.0, 40.0), r"might cross: give both a range, such as \[0, 17.4\] and \[17.5, 90\]$"),
        ((14.9, 15.15), r"such as \[0, 15.0375\] and \[15.075, 90\]$"),
        ((19.5, 17.0), "no ranges part a beam of 19.5 from a cone of 17: let starts and truths"),
    ],
)
def test_ranges_advised_for_a_spot_hold_starts_and_truths(starts, words):
    lamp = {"type": "spot", "cutoff_angle": 20.0, "beam_width": 15.0}
    params = mi.traverse(mi.load_dict({"type": "scene", "spot": lamp}, optimize=False))
    keys = "spot.beam_width", "spot.cutoff_angle"
    with pytest.raises(InputError, match=words):
        parse(params, {k: UnknownConfig(start=v) for k, v in zip(keys, starts)}, True)


def test_a_grid_s_range_is_of_what_its_medium_makes_of_it():
    counts = {
        "type": "gridvolume",
        "data": mi.TensorXf(np.full((2, 2, 2, 1), 30000.0)),
        "raw": True,
    }
    fog = {"type": "heterogeneous", "sigma_t": counts, "albedo": 0.5, "scale": 1e-4}
    described = {"type": "scene", "box": {"type": "cube", "interior": fog}}
    params = mi.traverse(mi.load_dict(described, optimize=False))
    keys = "box.interior_medium.sigma_t.data", "box.interior_medium.albedo.value.value"
    found = parse(params, {k: UnknownConfig(start=s) for k, s in zip(keys, (1e4, 0.4))}, True)
    assert found[0].high == pytest.approx(1e8)
    assert found[0].kind.unit == "0.0001 × 1 / scene unit" and found[1].kind.unit == ""


def test_what_thin_glass_lets_through_is_a_colour():
    params = ball(type="thindielectric", specular_transmittance=bitmap(3))
    (key,) = (key for key in params.keys() if key.endswith("specular_transmittance.data"))
    assert ranges.role(params, key) == "colour"


def test_a_material_s_specular_number_is_no_colour():
    params = ball(type="principled", specular=0.5)
    assert ranges.role(params, "ball.bsdf.specular") == ""
    assert ranges.role(params, "ball.bsdf.base_color.value") == "colour"


def test_a_list_is_that_of_each_vertex_or_of_none():
    mesh = trimesh.creation.icosphere(1)
    found = mi.Mesh("m", len(mesh.vertices), len(mesh.faces))
    values = mi.traverse(found)
    values["vertex_positions"] = mesh.vertices.astype(np.float32).ravel()
    values["faces"] = mesh.faces.astype(np.uint32).ravel()
    values.update()
    found.add_attribute("vertex_grey", 1, np.full(len(mesh.vertices), 0.5, np.float32))
    params = mi.traverse(mi.load_dict({"type": "scene", "m": found}, optimize=False))
    (key,) = (key for key in params.keys() if key.endswith("vertex_grey"))
    with pytest.raises(InputError, match="does not fit"):
        parse(params, {key: UnknownConfig(start=[0.2, 0.5, 0.7])}, False)
    (made,) = parse(params, {key: UnknownConfig(start=[0.2])}, False)
    assert (made.start == np.float32(0.2)).all()


def test_a_grid_of_no_medium_stays_a_hair_from_its_ends():
    volume = {"type": "volume", "volume": grid(0.5)}
    params = ball(type="diffuse", reflectance=volume)
    (key,) = (key for key in params.keys() if key.endswith(".data"))
    (made,) = parse(params, {key: UnknownConfig(start=0.3)}, False)
    assert 0 < made.low < 1e-3 and made.high == pytest.approx(1)


@pytest.mark.parametrize("under, refused", [("conductor", True), ("roughconductor", False)])
def test_a_shared_map_of_normals_around_a_mirror_is_refused(under, refused):
    bsdf = {"type": "normalmap", "normalmap": {"type": "ref", "id": "bumps"}}
    bsdf["nested"] = {"type": under}
    described = {"type": "scene", "bumps": bitmap(3), "ball": {"type": "sphere", "bsdf": bsdf}}
    params = mi.traverse(mi.load_dict(described, optimize=False))
    (key,) = (key for key in params.keys() if key.endswith(".data"))
    told = "it turns what mirrors and clear glass show"
    assert (told in routes.refusal(params, key)) == refused


@pytest.mark.parametrize("around", ["", "twosided", "twosided, blendbsdf"])
def test_what_lets_light_through_is_not_found_within_two_sides(around):
    """Mitsuba would not load the result."""
    material = {"type": "principled", "base_color": 0.5}
    if "blendbsdf" in around:
        material = {"type": "blendbsdf", "weight": 0.5, "a": material, "b": DIFFUSE}
    params = ball(**({"type": "twosided", "a": material} if around else material))
    (key,) = (key for key in params.keys() if key.endswith("spec_trans.value"))
    assert (key in registry.offered(Loaded(params))) == (not around)
    if around:
        with pytest.raises(InputError, match="twosided takes no material that lets light through"):
            parse(params, {key: UnknownConfig(start=0.5)}, True)


@pytest.mark.parametrize("word, channels", [("normalmap", 3), ("roughness", 1)])
def test_a_start_picture_of_what_is_no_colour_is_taken_as_stored(tmp_path, word, channels):
    flat = np.full((2, 2, 3), 128, np.uint8)
    if word == "normalmap":
        flat[..., 2] = 255
        params = ball(type="normalmap", normalmap=bitmap(3), a=DIFFUSE)
    else:
        params = ball(type="principled", roughness=bitmap(1))
    Image.fromarray(flat).save(tmp_path / "start.png")
    key = f"ball.bsdf.{word}.data"
    (made,) = parse(params, {key: UnknownConfig(start=str(tmp_path / "start.png"))}, False)
    assert made.start.shape == (2, 2, channels)
    np.testing.assert_allclose(made.start[0, 0], flat[0, 0, :channels] / 255, atol=1 / 255)
    assert not made.kind.colours


def test_a_start_picture_of_a_program_s_colours_is_decoded(tmp_path):
    """Of numbers in memory `raw` says that they are linear, not that files are data."""
    Image.new("RGB", (2, 2), (128, 128, 128)).save(tmp_path / "start.png")
    params = ball(type="diffuse", reflectance=bitmap(3))
    spec = UnknownConfig(start=str(tmp_path / "start.png"))
    (made,) = parse(params, {"ball.bsdf.reflectance.data": spec}, False)
    np.testing.assert_allclose(made.start, 0.2158605, atol=1e-5)
    assert made.kind.colours


@pytest.mark.parametrize("colour", [(255, 255, 255), (255, 0, 0)])
def test_a_start_picture_of_a_wide_gamut_is_taken(tmp_path, colour):
    """What lies beyond our colours, by rounding or more, is brought back."""
    file = tmp_path / "start.png"
    Image.new("RGB", (2, 2), colour).save(file, icc_profile=profile(P3))
    params = ball(type="diffuse", reflectance=bitmap(3))
    key = "ball.bsdf.reflectance.data"
    (made,) = parse(params, {key: UnknownConfig(start=str(file))}, False)
    np.testing.assert_allclose(made.start[0, 0], np.array(colour) / 255, atol=1e-3)


def test_one_colour_is_that_of_every_vertex():
    mesh = mi.Mesh("triangle", 3, 1)
    mesh.add_attribute("vertex_color", 3, [0.5] * 9)
    mesh.set_id("mesh")
    params = mi.traverse(mi.load_dict({"type": "scene", "mesh": mesh}, optimize=False))
    (made,) = parse(params, {"mesh.vertex_color": UnknownConfig(start=[0.2, 0.3, 0.4])}, False)
    np.testing.assert_allclose(made.start.reshape(3, 3), [[0.2, 0.3, 0.4]] * 3)


@pytest.mark.parametrize("raw", [False, True])
def test_a_texture_s_own_file_is_a_start_at_its_truth(tmp_path, raw, rng):
    """Also where it is no colour: Mitsuba decodes 8 bits unless they are said to be raw."""
    file = tmp_path / "rough.png"
    Image.fromarray(rng.integers(20, 250, (4, 4), np.uint8)).save(file)
    described = {"type": "bitmap", "filename": str(file), "raw": raw, "format": "variant"}
    params = ball(type="principled", roughness=described)
    (made,) = parse(params, {"ball.bsdf.roughness.data": UnknownConfig(start=str(file))}, True)
    np.testing.assert_allclose(made.start, made.truth, atol=1e-3)


@pytest.mark.parametrize("size", [(5, 1), (1, 5), (1, 1)])
def test_a_file_of_a_single_row_is_a_start_at_its_truth(tmp_path, size, rng):
    """Mitsuba holds the row twice."""
    file = tmp_path / "row.png"
    Image.fromarray(rng.integers(20, 250, (*size, 3), np.uint8)).save(file)
    described = {"type": "bitmap", "filename": str(file), "format": "variant"}
    params = ball(type="diffuse", reflectance=described)
    (made,) = parse(params, {"ball.bsdf.reflectance.data": UnknownConfig(start=str(file))}, True)
    np.testing.assert_allclose(made.start, made.truth, atol=1e-3)


@pytest.mark.parametrize("shape", [(1, 4, 3), (4, 1, 1)])
def test_numbers_of_a_single_row_are_no_texture_to_find(shape):
    texels = mi.TensorXf(np.full(shape, 0.5, np.float32))
    params = ball(type="diffuse", reflectance={"type": "bitmap", "data": texels, "raw": True})
    with pytest.raises(InputError, match="a single row or column: give it twice"):
        parse(params, {"ball.bsdf.reflectance.data": UnknownConfig(start=0.5)}, True)


def test_a_start_lies_as_mitsuba_takes_the_scene_s_own_file(tmp_path):
    """Whatever its Orientation tag asks, which is heeded where the scene has no file."""
    file, exif = tmp_path / "upside_down.jpg", Image.Exif()
    pixels = np.zeros((16, 16, 3), np.uint8)
    pixels[8:] = 200
    exif[0x112] = 3
    Image.fromarray(pixels).save(file, exif=exif, quality=100, subsampling=0)
    own = {"type": "bitmap", "filename": str(file), "format": "variant"}
    held = {"type": "bitmap", "data": mi.TensorXf(np.full((16, 16, 3), 0.5, np.float32))}
    paint, sky = "ball.bsdf.reflectance.data", {"type": "envmap", "filename": str(file)}
    scenes = [
        (ball(type="diffuse", reflectance=own), paint),
        (mi.traverse(mi.load_dict({"type": "scene", "sky": sky}, optimize=False)), "sky.data"),
        (ball(type="diffuse", reflectance=held | {"raw": True}), paint),
    ]
    spec = UnknownConfig(start=str(file))
    made = [parse(params, {key: spec}, True)[0] for params, key in scenes]
    for each in made[:2]:
        np.testing.assert_allclose(each.start, each.truth, atol=0.02)
        assert each.start[0].max() < 0.1 < 0.5 < each.start[-1].min()
    np.testing.assert_allclose(made[2].start, made[0].start[::-1, ::-1], atol=0.02)


@pytest.mark.parametrize("raw", [False, True])
def test_a_start_whose_colours_cannot_be_heeded_is_said(tmp_path, raw):
    file = tmp_path / "rough.png"
    Image.new("L", (4, 4), 100).save(file)
    described = {"type": "bitmap", "filename": str(file), "raw": raw, "format": "variant"}
    params = ball(type="principled", roughness=described)
    Image.new("L", (4, 4), 100).save(file, icc_profile=b"x")
    key = "ball.bsdf.roughness.data"
    (made,) = parse(params, {key: UnknownConfig(start=str(file))}, True)
    told = made.kind.unheeded
    assert len(told) == (not raw)
    assert all(f"['{key}'].start: a colour profile" in each for each in told)


@pytest.mark.parametrize("light, role", [("cutoff_angle", ""), ("intensity.value", "light")])
def test_how_wide_a_light_is_is_no_brightness(light, role):
    spot = {"type": "spot", "cutoff_angle": 30.0}
    params = mi.traverse(mi.load_dict({"type": "scene", "spot": spot}, optimize=False))
    (made,) = parse(params, {f"spot.{light}": UnknownConfig(start=40.0)}, True)
    assert made.kind.role == role


def test_a_light_s_scale_is_not_averaged_with_colours():
    sky = {"type": "envmap", "bitmap": mi.Bitmap(np.ones((4, 8, 3), np.float32))}
    described = {"type": "scene", "sky": sky, "ball": {"type": "sphere", "bsdf": DIFFUSE}}
    scene = mi.load_dict(described, optimize=False)
    keys = "sky.scale", "ball.bsdf.reflectance.value"
    found = parse(mi.traverse(scene), {key: UnknownConfig(start=0.4) for key in keys}, True)
    assert found[0].kind.unit == "scale"
    assert Unknowns(mi.traverse(scene), found).unit is None


def test_a_truth_with_what_is_no_number_is_refused():
    params = ball(type="diffuse", reflectance=bitmap(3))
    texels = np.full((2, 2, 3), 0.5, np.float32)
    texels[0, 1] = np.nan
    params["ball.bsdf.reflectance.data"] = mi.TensorXf(texels)
    params.update()
    with pytest.raises(InputError, match="3 of its 12 numbers are not finite: mend its file"):
        parse(params, {"ball.bsdf.reflectance.data": UnknownConfig(start=0.5)}, True)


def test_what_an_id_of_the_file_holds_is_named_by_its_own_key():
    """Not the key that is spelt most like it, which may be another object's."""
    text = """<scene version="3.0.0"><shape type="sphere" id="lamp"><bsdf type="diffuse"/></shape>
    <shape type="sphere" id="ball"><bsdf type="twosided" id="paint"><bsdf type="diffuse">
    <rgb name="reflectance" value="0.3"/></bsdf></bsdf></shape></scene>"""
    params = mi.traverse(mi.load_string(text, optimize=False))
    with pytest.raises(InputError, match="holds is 'ball.bsdf.brdf_0.reflectance.value'$"):
        parse(params, {"paint.reflectance.value": UnknownConfig(start=0.5)}, True)
    with pytest.raises(InputError, match="did you mean"):
        parse(params, {"pant.reflectance.value": UnknownConfig(start=0.5)}, True)
