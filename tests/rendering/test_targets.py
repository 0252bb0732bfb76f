"""Targets and coverage: unbiased, cached by content, and honest about what is seen."""

import re

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import trimesh
from isas_cli.scenes import kirby
from PIL import Image
from scenes_for_tests import (
    ROUGHNESS,
    TEXTURE,
    dictionary,
    problem,
    under_spots,
    without_targets,
)
from shapes_for_tests import ball, shaped

from isas_cli.config.schema import TargetConfig, UnknownConfig
from isas_cli.engine import assemble
from isas_cli.engine.evaluate import Evaluator
from isas_cli.filters.filter import Layout
from isas_cli.losses import L2
from isas_cli.rendering import coverage, targets
from isas_cli.rendering.renderer import Renderer
from isas_cli.runtime import backend, images
from isas_cli.runtime.errors import InputError
from isas_cli.scene import built
from isas_cli.scene.problem import Problem
from isas_cli.unknowns.kind import well_seen


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path))


def silent(done: int, total: int) -> None:
    pass


def paths(number: int) -> TargetConfig:
    return TargetConfig(spp=number)


def test_pixels_match_mitsuba_s_own_rendering():
    """Same mean as mi.render with the same integrator and a box filter, per view."""
    p = problem({ROUGHNESS: 0.4})
    p.unknowns.write(p.unknowns.truths())
    for view, sensor in enumerate(p.scene.sensors()):
        own = Renderer(p).view(view, 2048, lambda i: 50 + i)
        stock = np.array(mi.render(p.scene, sensor=sensor, spp=2048, seed=3))
        # Fireflies of the small lamp: compare the means of blocks, and most of the pixels.
        assert own.shape == stock.shape
        assert own.mean() == pytest.approx(stock.mean(), rel=0.02)
        assert np.median(np.abs(own - stock) / stock) < 0.03


def test_rendered_targets_are_cached_by_content():
    calls = []
    p = problem({TEXTURE: 0.5})
    count = lambda done, total: calls.append(done)  # noqa: E731
    first, _, key = targets.render(p, paths(4), count)
    rendered = len(calls)
    assert rendered > 0
    again, _, same = targets.render(p, paths(4), count)
    assert len(calls) == rendered and same == key
    assert np.array_equal(np.array(first), np.array(again))
    targets.render(p, paths(5), count)
    assert len(calls) > rendered, "another sample count is another target"
    p.content_hash = "other"
    seen = len(calls)
    targets.render(p, paths(4), count)
    assert len(calls) > seen, "another scene is another target"


def test_a_damaged_cache_is_made_anew(tmp_path):
    p = problem({TEXTURE: 0.5})
    first, _, key = targets.render(p, paths(2), silent)
    (tmp_path / f"target-{key}-{mi.variant()}.npz").write_bytes(b"half a file")
    again, _, _ = targets.render(p, paths(2), silent)
    assert np.array_equal(np.array(first), np.array(again))


def test_a_cache_that_cannot_be_written_does_not_stop_the_run(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path / "file" / "below"))
    images, _, _ = targets.render(problem({TEXTURE: 0.5}), paths(2), silent)
    assert dr.width(images) == 3 * 2 * 96


def content(**sizes) -> str:
    scene = mi.load_dict(dictionary(**sizes), optimize=False)
    return assemble._content_hash(scene, scene.integrator(), mi.traverse(scene))


def test_the_content_hash_sees_what_matters():
    assert content() == content()
    assert content() != content(depth=5)
    assert content() != content(resolution=(12, 9))
    assert content() != content(size=8)
    scene = mi.load_dict(dictionary(), optimize=False)
    hashes = set()
    for hidden in (False, True):
        shown = mi.load_dict({"type": "prb", "max_depth": 4, "hide_emitters": hidden})
        hashes |= {assemble._content_hash(scene, shown, mi.traverse(scene), d) for d in ("a", "b")}
    assert len(hashes) == 4


def test_the_content_hash_sees_what_a_transforms_text_rounds():
    def placed(x: float) -> str:
        place = mi.ScalarTransform4f().translate([x, 0, 0])
        shape = {"type": "sphere", "to_world": place}
        scene = mi.load_dict({"type": "scene", "ball": shape}, optimize=False)
        params = mi.traverse(scene)
        assert "1.23457e+06" in str(params["ball.to_world"])
        return assemble._content_hash("", None, params)

    assert placed(1234567.0) == placed(1234567.0) != placed(1234567.5)


def test_the_content_hash_leaves_areas_out():
    """A GPU adds them up in any order."""
    scene = mi.load_dict(dictionary(), optimize=False)
    text, hashes = str(scene), set()
    assert "surface_area = " in text
    for area in ("1.5", "1.4999999"):
        other = re.sub(r"(surface_area =) [^\s,]+", rf"\1 {area}", text)
        hashes.add(assemble._content_hash(other, None, mi.traverse(scene)))
    assert len(hashes) == 1


def test_normals_that_mitsuba_makes_do_not_tell_scenes_apart(tmp_path, rng):
    """It adds them up by threads, in any order, but not those that files have."""
    mesh = trimesh.creation.icosphere(2)
    mesh.vertices *= rng.uniform(0.8, 1.2, (len(mesh.vertices), 1))
    # A triangle that is hardly one, and a fold whose two sides cancel.
    thin = [[0, 0, 2], [1, 0, 2], [2, 1e-6, 2]]
    fold = [[0, 0, 3], [1, 0, 3], [0, 1, 3]]
    corners = len(mesh.vertices) + np.array([[0, 1, 2], [3, 4, 5], [3, 5, 4]])
    points, faces = np.vstack([mesh.vertices, thin, fold]), np.vstack([mesh.faces, corners])
    trimesh.Trimesh(points, faces, process=False).export(tmp_path / "a.ply", vertex_normal=False)
    shape = {"type": "ply", "filename": str(tmp_path / "a.ply")}
    scene = mi.load_dict({"type": "scene", "a": shape}, optimize=False)
    params = mi.traverse(scene)
    made = np.array(params["a.vertex_normals"])

    def told(normals: np.ndarray) -> str:
        params["a.vertex_normals"] = mi.Float(normals)
        return assemble._content_hash(scene, None, params)

    as_loaded = told(made)
    assert told(made + rng.uniform(-1e-6, 1e-6, made.shape)) == as_loaded
    own = made.copy()
    own[:3] = np.roll(made[:3], 1)
    assert len({as_loaded, told(-made), told(own)}) == 3


def test_what_is_seen_is_kept_by_variant(monkeypatch):
    """As targets are: what a run gets does not hang on which of a card and a CPU came first."""
    p = problem({TEXTURE: 0.5})
    own = coverage._key(p, 1)
    monkeypatch.setattr(mi, "variant", lambda: "another_ad_rgb")
    assert coverage._key(p, 1) != own


def test_coverage_finds_the_texels_that_no_view_sees():
    """The floor reaches far behind the cameras: texels there are not seen."""
    p = problem({TEXTURE: 0.5}, size=16, resolution=(96, 64), depth=2, floor=6.0)
    p.unknowns.items[0].seen = None
    coverage.fill_in(p, 1)
    seen = p.unknowns.items[0].seen
    assert seen.shape == (16, 16, 3)
    assert 0.2 < seen.mean() < 1
    # What is not seen moves the images little, beside what is: check by moving all of either.
    start = p.unknowns.items[0].start
    moved = [
        np.where(which, 0.9, start).astype(np.float32) for which in (seen & False, seen, ~seen)
    ]
    images = []
    for values in moved:
        p.unknowns.write(p.unknowns.values_of({TEXTURE: values}))
        images.append(Renderer(p).range(0, p.views.total, 16, lambda i: i))
    by_seen, by_unseen = (np.abs(image - images[0]).mean() for image in images[1:])
    print(seen.mean(), by_unseen / by_seen)
    assert by_unseen < 0.05 * (~seen).sum() / seen.sum() * by_seen


def meter(size: float, **more) -> Problem:
    """A lamp of this size above a meter that lies on a table."""
    turn = mi.ScalarTransform4f().rotate([0, 1, 0], 180)
    film = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
    lamp = turn.translate([0, 0, -3]).scale(size)
    described = {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 2},
        "table": {"type": "rectangle", "sensor": {"type": "irradiancemeter", "film": film}},
        "lamp": {"type": "rectangle", "to_world": lamp, "emitter": {"type": "area"}},
    }
    return without_targets(described | more, {"lamp.emitter.radiance.value": 0.5})


def test_what_a_single_pixel_sees_now_and_then_is_seen():
    p = meter(0.15)
    coverage.fill_in(p, 1)
    assert p.unknowns.items[0].seen.all()


def test_what_a_single_pixel_sees_beside_a_camera_is_seen_as_much_as_it_counts():
    """A camera that sees nothing of it, of whose pixels each has four paths."""
    away = mi.ScalarTransform4f().look_at([0, 0, 9], [0, 0, 10], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 32, "height": 32, "rfilter": {"type": "box"}}
    camera = {"type": "perspective", "to_world": away, "film": film}
    p = meter(0.3, eye=camera)
    coverage.fill_in(p, 1)
    (unknown,) = p.unknowns
    assert unknown.seen.all()
    beside, alone = (
        coverage.measure(each, {unknown.key: unknown.lit}, 1)[unknown.key].sum()
        for each in (p, meter(0.3))
    )
    # A meter by itself has 1,024 times as many.
    assert 1024 * beside == pytest.approx(alone, rel=0.6)


def test_what_a_cone_comes_to_light_counts(monkeypatch, tmp_path):
    """Of a spot that starts as a small patch of the floor: what the true one shows, the foot of the
    wall too; of photographs, and for what a run goes by, what any may show."""
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path))
    cone = {"spot.cutoff_angle": 10.0}
    scene = under_spots(spot={"cutoff_angle": 40.0, "beam_width": 5.0})
    p = without_targets(scene, {TEXTURE: 0.5, ROUGHNESS: 0.5} | cone)
    coverage.fill_in(p, 1)
    u = p.unknowns[TEXTURE]
    begun = u.kind.seen(coverage.measure(p, {TEXTURE: u.start}, 1)[TEXTURE]).mean()
    print(begun, u.seen.mean(), u.told.mean())
    assert begun < 0.25 and min(u.seen.mean(), u.told.mean()) > 0.5
    for each in p.unknowns:
        each.truth = None
    coverage.fill_in(p, 1)
    assert np.array_equal(u.seen, u.told) and u.seen.mean() > 0.5


def test_what_a_dim_lamp_comes_to_light_counts_and_a_run_does_not_go_by_it(monkeypatch, tmp_path):
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path))
    as_wide = {"cutoff_angle": 12.0, "intensity": 100.0}
    scene = under_spots(left=as_wide | {"x": -0.5}, right=as_wide | {"x": 0.5})
    p = without_targets(scene, {TEXTURE: 0.5, "right.intensity.value": 1e-3})
    coverage.fill_in(p, 1)
    u = p.unknowns[TEXTURE]
    counts = [each[:, half].sum() for each in (u.seen, u.told) for half in np.s_[:8, 8:]]
    print(counts)
    assert min(counts[:2]) > 20 and counts[2] > 20 and counts[3] == 0
    layout = Layout.of(u, u.start.shape, False)
    assert np.array_equal(np.array(layout.seen).reshape(u.told.shape) > 0, u.told)


def test_what_is_hardly_seen_does_not_count_however_much_there_is_of_it():
    """Most texels grazed: their median would count them all."""
    well, grazed = np.full(20, 1.0), np.linspace(1e-3, 2e-2, 75)
    found = well_seen(np.concatenate([well, grazed, np.zeros(5), [np.nan]]))
    assert found[:20].all() and not found[20:].any()


def test_an_unknown_that_no_view_sees_is_refused():
    scene = dictionary()
    scene["hidden"] = {
        "type": "sphere",
        "center": [0, 50, 50],
        "radius": 0.01,
        "bsdf": {"type": "diffuse", "reflectance": 0.5},
    }
    import scenes_for_tests

    original = scenes_for_tests.dictionary
    scenes_for_tests.dictionary = lambda **sizes: scene
    try:
        p = problem({"hidden.bsdf.reflectance.value": 0.3})
    finally:
        scenes_for_tests.dictionary = original
    with pytest.raises(InputError, match="hidden.bsdf.reflectance.value.*no view sees it"):
        coverage.fill_in(p, 1)
    p.unknowns.write(p.unknowns.starts())


def test_the_image_error_is_that_of_the_mean_images():
    """Neither the noise of the targets nor the evaluation's own counts: zero at the truth, and
    elsewhere what a rendering with many paths says."""
    p = problem({ROUGHNESS: 0.4}, resolution=(48, 32))
    rendered, _, key = targets.render(p, paths(2), silent)
    p.set_targets(rendered, None, key)
    evaluator = Evaluator(p, L2(), 100_000, 8, 1)
    assert evaluator(p.unknowns.truths())["image_rmse"] == 0
    other = p.unknowns.values_of({ROUGHNESS: np.array([0.7], np.float32)})
    images = []
    for number, values in enumerate((p.unknowns.truths(), other)):
        p.unknowns.write(values)
        pixel = dr.tile(dr.arange(mi.UInt32, p.views.total), 32)
        mean = Renderer(p).pixels(pixel, 64, lambda s, n=number: 900 * n + s)
        images.append(np.array(mean).reshape(3, 32, -1).mean(axis=1))
    exact = np.sqrt(np.mean((images[0] - images[1]) ** 2))
    assert evaluator(other)["image_rmse"] == pytest.approx(exact, rel=0.1)


@pytest.mark.parametrize("apart", [0.0, 1e-3], ids=["none", "less than noise"])
def test_an_image_error_that_noise_hides_is_known_from_none(apart):
    p = problem({ROUGHNESS: 0.5})
    evaluator = Evaluator(p, L2(), 500, 4, 0)
    first, second = evaluator._halves(p.unknowns.starts())
    evaluator.references = first + apart, second - apart
    assert evaluator(p.unknowns.starts())["image_rmse"] == 0
    assert evaluator.unresolved == (apart > 0)


@pytest.mark.parametrize("channels", [["Y"], ["R", "G", "B"]], ids=["grey", "colours"])
def test_a_given_target_without_colours_is_said(tmp_path, channels):
    """It would pull red, green and blue to one value; one that merely shows grey does not."""
    p = problem({ROUGHNESS: 0.5})
    files = [tmp_path / f"{n}.exr" for n in range(len(p.film_sizes))]
    for file, (width, height) in zip(files, p.film_sizes):
        images.write_exr(file, np.full((height, width, len(channels)), 0.5), channels, {})
    before = list(p.warnings)
    targets.load(p, [str(file) for file in files], None)
    told = p.warnings[len(before) :]
    assert len(told) == (channels == ["Y"])
    assert all("no colours" in each and str(files[0]) in each for each in told)


def test_what_is_transparent_in_a_target_is_black(tmp_path):
    """A PNG's colours stand beside its alpha; those of an EXR are over black already."""
    p = problem({ROUGHNESS: 0.5})
    sides, files, masks = [], [], []
    for ending in ("png", "exr"):
        files = [str(tmp_path / f"{n}.{ending}") for n in range(len(p.film_sizes))]
        for file, (width, height) in zip(files, p.film_sizes):
            alpha = np.where(np.arange(width) < width // 2, 0.5, 1.0) * np.ones((height, 1))
            colours = np.full((height, width, 3), 0.25) * (
                alpha[..., None] if ending == "exr" else 1
            )
            if ending == "exr":
                images.write_exr(file, np.dstack([colours, alpha]), [*"RGBA"], {})
            else:
                stored = np.dstack([images.srgb_encode(colours), alpha])
                Image.fromarray(np.rint(255 * stored).astype(np.uint8)).save(file)
        before = len(p.warnings)
        sides.append(np.array(targets.load(p, files, None)[0]))
        told = p.warnings[before:]
        assert len(told) == (ending == "png") and all("counts as black" in each for each in told)
    assert np.allclose(*sides, atol=0.004)
    files = [file.replace("exr", "png") for file in files]
    for n, (width, height) in enumerate(p.film_sizes):
        masks.append(str(tmp_path / f"mask{n}.png"))
        whole = np.uint8(255) * (np.arange(width) >= width // 2) * np.ones((height, 1), np.uint8)
        Image.fromarray(whole).save(masks[-1])
    before = len(p.warnings)
    targets.load(p, files, masks)
    assert p.warnings[before:] == []


def test_what_is_transparent_where_the_scene_shows_a_sky_is_said(tmp_path):
    """Of an EXR. Mitsuba's prb has no alpha where it shows a sky, and hidden skies are black."""
    p = problem({ROUGHNESS: 0.5})
    files = [str(tmp_path / f"{n}.exr") for n in range(len(p.film_sizes))]
    for beside, hidden, wanted in ((0.0, False, 1), (0.0, True, 0), (0.2, False, 0)):
        p.integrator.hide_emitters = hidden
        for file, (width, height) in zip(files, p.film_sizes):
            pixels = np.full((height, width, 4), 1.0, np.float32)
            pixels[:, : width // 2] = beside, beside, beside, 0
            images.write_exr(file, pixels, [*"RGBA"], {})
        before = len(p.warnings)
        targets.load(p, files, None)
        told = p.warnings[before:]
        assert len(told) == wanted and all("counts as black" in each for each in told)


def test_no_number_in_a_target_may_be_hidden(tmp_path):
    p = problem({ROUGHNESS: 0.5})
    files, masks = [], []
    for n, (width, height) in enumerate(p.film_sizes):
        pixels, hides = np.full((height, width, 3), 0.5), np.full((height, width), 255, np.uint8)
        pixels[0, 1], pixels[2, 3, 0], hides[:3] = np.nan, np.inf, 0
        files.append(str(tmp_path / f"{n}.exr"))
        masks.append(str(tmp_path / f"mask{n}.png"))
        images.write_exr(files[-1], pixels, [*"RGB"], {})
        Image.fromarray(hides).save(masks[-1])
    pixels, mask, _ = targets.load(p, files, masks)
    assert np.isfinite(np.array(pixels)).all() and np.array(mask).any()
    Image.fromarray(np.full_like(hides, 255)).save(masks[-1])
    for given in (masks, None):
        with pytest.raises(InputError, match="exr: 2 pixels are NaN or infinite; mend or mask"):
            targets.load(p, files, given)


def test_light_that_a_target_s_file_cannot_say_is_said(tmp_path):
    p = problem({ROUGHNESS: 0.5})
    files = [str(tmp_path / f"{n}.png") for n in range(len(p.film_sizes))]
    for file, (width, height) in zip(files, p.film_sizes):
        pixels = np.full((height, width, 3), 120, np.uint8)
        pixels[0, 0, 1] = 255
        Image.fromarray(pixels).save(file)
    before = len(p.warnings)
    targets.load(p, files, None)
    (told,) = p.warnings[before:]
    assert "as bright as their files can say" in told and files[0] in told


def test_of_what_is_transparent_no_light_is_lost(tmp_path):
    """Programs that cut objects out leave white where nothing is."""
    p = problem({ROUGHNESS: 0.5})
    files = [str(tmp_path / f"{n}.png") for n in range(len(p.film_sizes))]
    for file, (width, height) in zip(files, p.film_sizes):
        pixels = np.full((height, width, 4), 120, np.uint8)
        pixels[:, :, 3] = 255
        pixels[:, : width // 2] = 255, 255, 255, 0
        Image.fromarray(pixels).save(file)
    before = len(p.warnings)
    targets.load(p, files, None)
    (told,) = p.warnings[before:]
    assert "counts as black" in told


def test_a_mask_that_hides_a_whole_view_is_said(tmp_path):
    p = problem({ROUGHNESS: 0.5})
    files, masks = [], []
    for n, (width, height) in enumerate(p.film_sizes):
        files.append(str(tmp_path / f"{n}.exr"))
        masks.append(str(tmp_path / f"mask{n}.png"))
        images.write_exr(files[-1], np.full((height, width, 3), 0.5), [*"RGB"], {})
        Image.fromarray(np.full((height, width), 255 * (n != 1), np.uint8)).save(masks[-1])
    before = len(p.warnings)
    targets.load(p, files, masks)
    assert p.warnings[before:] == [
        f"mask {masks[1]} hides every pixel: its target counts for nothing"
    ]


def test_colours_of_targets_that_cannot_be_heeded_are_said_once(tmp_path):
    p = problem({ROUGHNESS: 0.5})
    files = [str(tmp_path / f"{n}.png") for n in range(len(p.film_sizes))]
    for file, (width, height) in zip(files, p.film_sizes):
        pixels = np.full((height, width, 3), 120, np.uint8)
        Image.fromarray(pixels).save(file, icc_profile=b"x")
    before = len(p.warnings)
    targets.load(p, files, None)
    (told,) = p.warnings[before:]
    assert f"of {', '.join(files)} cannot be heeded" in told and told.endswith("to sRGB")


def test_targets_of_what_unknowns_write_otherwise_are_others():
    """A file's own normals are not those that a shape's unknown vertices have."""
    with backend.loading():
        figure = shaped(*ball(2), "figure")
    values = mi.traverse(figure)
    normals = np.array(values["vertex_normals"]).reshape(-1, 3) + [0.3, 0, 0]
    values["vertex_normals"] = mi.Float(
        (normals / np.linalg.norm(normals, axis=1)[:, None]).ravel()
    )
    values.update()
    described = kirby.build(1, 8, 2) | {"figure": figure}
    keys = []
    for unknown in ("figure.bsdf.reflectance.value", "figure.vertices"):
        p = without_targets(
            described, {unknown: UnknownConfig(start=0.4 if "bsdf" in unknown else "smooth")}
        )
        keys.append(targets.render(p, paths(4), silent)[2])
        replaced = [key for key, _ in p.unknowns.replaced()]
        assert replaced == ([] if "bsdf" in unknown else ["figure.vertices"])
    assert keys[0] != keys[1]


def test_what_a_builder_says_beside_arrays_is_in_the_hash():
    """Mitsuba's own text of a bitmap leaves its wrap mode out."""
    texture = {"type": "bitmap", "data": np.zeros((2, 2, 3)), "wrap_mode": "clamp"}
    place = mi.ScalarTransform4f().translate([1, 2, 3.0000001])
    first = built.told({"a": {"texture": texture, "to_world": place}})
    assert "clamp" in first and "ndarray" in first
    assert first != built.told(
        {"a": {"texture": texture | {"wrap_mode": "mirror"}, "to_world": place}}
    )
    moved = mi.ScalarTransform4f().translate([1, 2, 3.5])
    assert first != built.told({"a": {"texture": texture, "to_world": moved}})
