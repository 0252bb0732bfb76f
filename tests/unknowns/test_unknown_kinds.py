"""Unknowns of every kind: textures, single values, colours, lights and environment maps."""

import json
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from gradient_estimates import Gradients, configured, difference_quotients
from hard_scenes import assemble
from lit_scene import SKY, STARTS, UNDER, lit, sky_texels
from montecarlo import welch
from runs_for_tests import ran
from scenes_for_tests import without_targets
from xml_for_tests import camera, paths

from isas_cli.config.schema import UnknownConfig
from isas_cli.rendering import coverage
from isas_cli.rendering.renderer import Renderer
from isas_cli.runtime import images
from isas_cli.runtime.errors import InputError
from isas_cli.scene import scene_file
from isas_cli.unknowns.parameters import flat
from isas_cli.unknowns.specs import parse

LEVEL = 1e-4
# The smallest wrong share of a directional derivative that must be visible.
VISIBLE = 0.25


def problem(sky: str, depth: int = 4):
    return assemble(lit(sky, depth), STARTS | UNDER[sky])


def directions(unknown, rng: np.random.Generator) -> list[np.ndarray]:
    """Where derivatives are compared: all entries together, and of a map its seam on both sides."""
    together = rng.uniform(0.5, 1.5, unknown.start.shape).astype(np.float32)
    if unknown.start.shape != SKY:
        return [together]
    first, last = np.zeros(SKY, np.float32), np.zeros(SKY, np.float32)
    first[:, 0], last[:, -1] = 1, 1
    return [together, first, last]


# Unrolled at depth 4, replayed at depth 9.
OTHERS = (("map", 9), ("constant", 4))


@pytest.mark.parametrize(
    "sky, depth", [("map", 4), *(pytest.param(*more, marks=pytest.mark.slow) for more in OTHERS)]
)
def test_gradients_of_all_kinds_at_once_are_those_of_finite_differences(sky, depth, rng):
    made = problem(sky, depth)
    loss = configured("loss", "l2")
    gradients = Gradients(made, loss, batch=4096)
    rows = gradients.uniform(96, 1)
    kinds = 0
    for unknown in made.unknowns:
        entries = gradients.entries()[unknown.key]
        for direction in directions(unknown, rng):
            quotients = difference_quotients(made, [loss], {unknown.key: direction}, 0.1, 16)
            along = rows[:, entries] @ direction.ravel().astype(np.float64)
            differences = quotients[0, 1]
            outcome = welch(along[:, None], differences[:, None], LEVEL)
            size = abs(differences.mean())
            print(unknown.key, size, outcome)
            assert outcome.p_value > LEVEL, unknown.key
            assert outcome.always_visible < VISIBLE * size, unknown.key
            # Halving the step changes nothing: the difference quotients are derivatives.
            assert abs(quotients[0].mean(axis=1) @ [1, -1]) < 0.05 * size, unknown.key
            kinds += 1
    assert kinds == len(STARTS) + len(UNDER[sky]) + 2 * (sky == "map")


def test_recorded_kernels_follow_an_environment_map(rng):
    """A frozen step sees each new map, gives its gradient back, and samples by it."""
    made = problem("map")
    from isas_cli.estimators.two_path import TwoPath
    from isas_cli.rendering.pixels import PixelDistribution, Tiles

    uniform = PixelDistribution.uniform(Tiles.over(made.views))
    maps = [rng.uniform(0.1, 1, SKY).astype(np.float32) for _ in range(6)]
    maps[3][1, 2] = 300
    found = []
    for freeze in (False, True):
        estimator = TwoPath(made, configured("loss", "l2"), 4096, freeze=freeze)
        for i, texels in enumerate(maps):
            values = {u.key: u.start for u in made.unknowns} | {"sky.data": texels}
            made.unknowns.attach(made.unknowns.values_of(values))
            estimator.accumulate(uniform, 5, i)
            found.append(np.array(flat(made.unknowns.gradients()["sky.data"])))
    made.unknowns.write(made.unknowns.starts())
    traced, recorded = found[:6], found[6:]
    for one, other in zip(traced, recorded, strict=True):
        assert np.abs(one).max() > 0
        np.testing.assert_allclose(one, other, atol=1e-5 * np.abs(one).max())
    assert np.abs(traced[4] - traced[5]).max() > 0.01 * np.abs(traced[4]).max()


def test_light_and_colour_that_can_trade_brightness(rng, monkeypatch):
    """A factor a channel between a map and its truth leaves nothing; what else differs stays."""
    made = without_targets(lit("map"), STARTS | UNDER["map"])
    roles = {made.unknowns[key].kind.role for key in made.unknowns.traded}
    assert roles == {"light", "colour"} and "sky.data" in made.unknowns.traded
    sky = made.unknowns["sky.data"]
    sky.seen = rng.random(SKY) < 0.7
    array = (sky.truth * [0.5, 1, 3] + rng.normal(0, 0.1, SKY)).astype(np.float32)
    left = []
    for channel in range(3):
        one, true = (x[..., channel][sky.seen[..., channel]] for x in (array, sky.truth))
        (factor,), *_ = np.linalg.lstsq(one[:, None], true, rcond=None)
        left.append((one * factor - true) ** 2)
    expected = np.sqrt(np.concatenate(left).mean())
    assert sky.scaled_error(array) == pytest.approx(expected, 1e-4)
    assert sky.scaled_error(array) < 0.3 * sky.error(array)
    assert sky.scaled_error(sky.truth * np.float32([0.5, 1, 3])) < 1e-6
    kinds, error = [], type(sky.kind).error
    with monkeypatch.context() as patched:
        patched.setattr(
            type(sky.kind), "error", lambda s, a, *more: kinds.append(a.dtype) or error(s, a, *more)
        )
        sky.scaled_error(array)
    assert kinds == [np.float32], "of a large grid twice as much would be held"
    alone = without_targets(lit("map"), {"sky.data": 0.5})
    assert alone.unknowns.traded == []


def render(scene: mi.Scene) -> np.ndarray:
    return np.array(mi.render(scene, spp=16, seed=3))


def test_an_environment_map_is_kept_in_its_own_shape(rng):
    """The columns that Mitsuba adds are no unknowns, and follow those that are. What is written
    renders as if the scene had been loaded with it, its table for sampling included."""
    made = without_targets(lit("map"), STARTS | UNDER["map"])
    sky = next(u for u in made.unknowns if u.key == "sky.data")
    np.testing.assert_array_equal(sky.truth, sky_texels())
    assert sky.start.shape == SKY
    assert made.unknowns.starts()["sky.data"].shape == SKY

    texels = rng.uniform(0.1, 1, SKY).astype(np.float32)
    texels[1, 0] = 50  # beside the seam, and far brighter than all others
    made.unknowns.write(made.unknowns.truths() | made.unknowns.values_of({"sky.data": texels}))
    inside = np.array(mi.traverse(made.scene)["sky.data"])
    np.testing.assert_array_equal(inside, np.pad(texels, ((0, 0), (1, 1), (0, 0)), mode="wrap"))
    fresh = mi.load_dict(lit("map", texels=texels), optimize=False)
    np.testing.assert_allclose(render(made.scene), render(fresh), rtol=1e-5, atol=1e-6)
    made.unknowns.write(made.unknowns.truths())
    loaded = mi.load_dict(lit("map"), optimize=False)
    np.testing.assert_allclose(render(made.scene), render(loaded), rtol=1e-5, atol=1e-6)


def test_texels_at_zero_have_the_gradient_of_any_others():
    """No light is sampled towards dark texels, but what is scattered there counts in full."""
    made = assemble(lit("map"), {"sky.data": 0.5})
    gradients = Gradients(made, configured("loss", "l2"), batch=4096)
    rows = []
    for dark in (0.0, 2e-3):
        texels = np.full(SKY, 0.5, np.float32)
        texels[:, :4] = dark
        gradients.values = made.unknowns.values_of({"sky.data": texels})
        rows.append(gradients.uniform(64, 3 + bool(dark)))
    halves = [row.reshape(-1, *SKY)[:, :, :4].sum(axis=(2, 3)) for row in rows]
    outcome = welch(*halves, LEVEL)
    print(np.abs(halves[1].mean(axis=0)), outcome)
    assert outcome.p_value > LEVEL
    assert outcome.always_visible < 0.2 * np.abs(halves[1].mean(axis=0)).max()


def test_pictures_and_colours_arrive_linear(tmp_path, monkeypatch, rng):
    """Of a file: sRGB pictures of 8 bits are decoded unless they say raw, in colour and in grey;
    `rgb` numbers stand as they are."""
    monkeypatch.chdir(tmp_path)
    encoded = rng.integers(0, 256, (4, 6, 3)).astype(np.uint8)
    images.write_png(Path("colour.png"), encoded)
    images.write_png(Path("grey.png"), encoded[..., :1])

    def bitmap(name: str, file: str, raw: str = "") -> str:
        return f"""<texture type="bitmap" name="{name}"><string name="filename" value="{file}"/>
          {raw}</texture>"""

    raw = '<boolean name="raw" value="true"/>'
    materials = {
        "a": bitmap("base_color", "colour.png") + bitmap("roughness", "grey.png"),
        "b": bitmap("base_color", "colour.png", raw) + bitmap("roughness", "grey.png", raw),
        "c": '<rgb name="base_color" value="0.5, 0.25, 0.1"/>',
    }
    shapes = "".join(
        f'<shape type="rectangle" id="{name}"><bsdf type="principled">{inside}</bsdf></shape>'
        for name, inside in materials.items()
    )
    Path("scene.xml").write_text(
        '<scene version="3.0.0"><emitter type="constant" id="sky"><rgb name="radiance" '
        f'value="0.5, 0.2, 4"/></emitter><sensor type="perspective"/>{shapes}</scene>'
    )
    params = mi.traverse(scene_file.load("scene.xml", None)[0])
    values = encoded / 255
    linear = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    for name, wanted in (("a", linear), ("b", values)):
        found = np.array(params[f"{name}.bsdf.base_color.data"])
        np.testing.assert_allclose(found, wanted, atol=1e-6)
        found = np.array(params[f"{name}.bsdf.roughness.data"])
        np.testing.assert_allclose(found, wanted[..., :1], atol=1e-6)
        # So is a start that is such a file.
        key = f"{name}.bsdf.base_color.data"
        (unknown,) = parse(params, {key: UnknownConfig(start="colour.png")}, True)
        np.testing.assert_allclose(unknown.start, wanted, atol=1e-5)
    colour = np.array(params["c.bsdf.base_color.value"]).ravel()
    np.testing.assert_allclose(colour, [0.5, 0.25, 0.1])
    np.testing.assert_allclose(np.array(params["sky.radiance.value"]).ravel(), [0.5, 0.2, 4])


def test_of_an_environment_map_the_texels_before_the_cameras_are_seen(monkeypatch, tmp_path):
    """Cameras that look past everything: a texel is seen where changing it changes the images."""
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path))
    look = mi.ScalarTransform4f().look_at
    scene = {
        k: v for k, v in lit("map").items() if k in ("type", "integrator", "sky", "sensor_000")
    }
    scene["sensor_000"]["to_world"] = look(origin=[0, 0, 0], target=[1, 0.3, 0.2], up=[0, 1, 0])
    scene["hidden"] = {"type": "sphere", "center": [-50, 0, 0]}
    made = without_targets(scene, {"sky.data": 0.5, "sky.scale": 0.8})
    for unknown in made.unknowns:
        unknown.seen = None
    coverage.fill_in(made, 1)
    seen, scale = (u.seen for u in made.unknowns)
    assert seen.shape == SKY and scale.all()

    grey = np.full(SKY, 0.5, np.float32)
    changes = np.zeros(SKY[:2])
    for row, column in np.ndindex(SKY[:2]):
        texels = grey.copy()
        texels[row, column] += 1
        values = {"sky.data": texels, "sky.scale": np.ones(1, np.float32)}
        made.unknowns.write(made.unknowns.values_of(values))
        changes[row, column] = (render(made.scene) - 0.5).sum()
    strong, none = changes > 0.05 * changes.max(), changes < 1e-4 * changes.max()
    assert 2 <= strong.sum() < 12 and none.sum() > 12
    assert seen[strong].all() and not seen[none].any()


def test_what_a_dark_light_will_light_is_seen():
    place = mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 8, "height": 8}
    scene = {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 3},
        "sensor": {"type": "perspective", "to_world": place, "film": film},
        "sky": {"type": "constant"},
        "ball": {"type": "sphere", "bsdf": {"type": "diffuse"}},
    }
    made = without_targets(scene, {"sky.radiance.value": 0.0, "ball.bsdf.reflectance.value": 0.4})
    coverage.fill_in(made, 1)
    assert all(unknown.seen.all() for unknown in made.unknowns)
    assert np.all(render(made.scene) == 0), "and is where it starts"


def test_the_picture_of_a_lamp_is_not_black_everywhere():
    picture = mi.Bitmap(np.ones((4, 4, 3), np.float32))
    radiance = {"type": "bitmap", "bitmap": picture, "raw": True}
    scene = {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 3},
        "sensor": {"type": "perspective"},
        "lamp": {"type": "rectangle", "emitter": {"type": "area", "radiance": radiance}},
    }
    with pytest.raises(InputError, match="a lamp's picture that is zero everywhere"):
        without_targets(scene, {"lamp.emitter.radiance.data": 0.0})
    assert without_targets(scene, {"lamp.emitter.radiance.data": 0.5})


PLACES = "0,1.2,3", "2.5,1.5,-2", "-3,1,-1"
CAMERAS = "".join(camera(each, 32, 24, target="0,0.5,0", fov=70) for each in PLACES)
SCENE = f"""<scene version="3.0.0">{paths(3)}{CAMERAS}
  <emitter type="envmap" id="sky"><string name="filename" value="sky.exr"/></emitter>
  <shape type="sphere" id="lamp"><point name="center" x="0.8" y="1.6" z="0.3"/>
    <float name="radius" value="0.3"/>
    <emitter type="area"><rgb name="radiance" value="6,5,4"/></emitter></shape>
  <shape type="rectangle" id="floor">
    <transform name="to_world"><rotate x="1" angle="-90"/></transform>
    <bsdf type="diffuse"><texture name="reflectance" type="bitmap">
      <string name="filename" value="floor.png"/></texture></bsdf></shape>
  <shape type="sphere" id="ball"><point name="center" x="-0.4" y="0.5" z="0"/>
    <float name="radius" value="0.5"/><bsdf type="principled">
    <rgb name="base_color" value="0.8,0.5,0.3"/><float name="roughness" value="0.25"/>
    <float name="metallic" value="0.8"/></bsdf></shape></scene>"""
TOGETHER = {
    "floor.bsdf.reflectance.data": {"start": 0.5, "lr": 0.03},
    "ball.bsdf.base_color.value": {"start": [0.5, 0.5, 0.5], "lr": 0.015, "range": [0.1, 0.9]},
    "ball.bsdf.roughness.value": {"start": 0.5, "lr": 0.015, "range": [0.1, 0.52]},
    "lamp.emitter.radiance.value": {"start": 3, "lr": 0.15, "range": [0, 10]},
    "sky.data": {"start": 0.5, "lr": 0.04, "range": [0.19, 0.81]},
}


def test_five_kinds_are_found_together_each_with_its_own_rate_and_range(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    images.write_png(Path("floor.png"), (rng.random((8, 8, 3)) * 150 + 80).astype(np.uint8))
    texels = rng.uniform(0.2, 0.8, SKY).astype(np.float32)
    images.write_exr(Path("sky.exr"), texels, ["R", "G", "B"], {})
    Path("scene.xml").write_text(SCENE)
    arguments = ["scene=file", "scene.path=scene.xml", "budget.iterations=160", "frames.spp=2"]
    arguments += ["frames.snapshots=0", "target.spp=256", "estimator.batch=4096", "report=false"]
    recorded = ran(Path("r"), *arguments, f"scene.unknowns={json.dumps(TOGETHER)}")
    for key in TOGETHER:
        error = recorded.history[f"parameter_rmse/{key}"].to_numpy()
        print(key, error[0], error[-1])
        # At the others' rate the lamp would hardly have left its start.
        assert error[-1] < (0.1 if key.startswith("lamp") else 0.7) * error[0], key
    (said,) = (each for each in recorded.summary["warnings"] if "trade brightness" in each)
    assert said.index("'sky.data'") < said.index("and colour")
    scaled = recorded.history["value/sky.data/scaled"]
    assert (scaled <= recorded.history["parameter_rmse/sky.data"]).all() and scaled.min() > 0
    found = images.read(tmp_path / "r" / "frames" / "result_sky.data.exr")
    assert found.shape == SKY
    assert 0.19 - 1e-3 < found.min() and found.max() < 0.81 + 1e-3
    assert np.ptp(found) > 0.3  # the texels have left their start


def test_frozen_kernels_see_every_value_of_a_texture_of_one_channel():
    """Values that come from NumPy, as starts and truths do."""
    scene = lit("constant")
    scene["wall"]["bsdf"]["roughness"] = {
        "type": "bitmap",
        "data": mi.TensorXf(np.full((4, 4, 1), 0.4, np.float32)),
        "raw": True,
    }
    key = "wall.bsdf.roughness.data"
    made = without_targets(scene, {key: 0.5})
    renderer = Renderer(made)
    for roughness in (0.4, 0.4, 0.7, 0.2, 0.5, 0.9, 0.3):
        values = made.unknowns.values_of({key: np.full((4, 4, 1), roughness, np.float32)})
        made.unknowns.write(values)
        frozen = renderer.range(0, made.views.total, 16, lambda i: i)
        np.testing.assert_array_equal(frozen, Renderer(made).range(0, made.views.total, 16, int))
