"""Unknown lenses of photographs: which way rays go, who shares one, and that they are found."""

from pathlib import Path
from types import SimpleNamespace

import _drawn_box as box
import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from problems_for_tests import built, configured
from runs_for_tests import QUIET
from shapes_for_tests import covered

import isas_cli
from isas_cli import losses
from isas_cli.config.schema import PhotosConfig
from isas_cli.estimators.silhouettes import Settings
from isas_cli.estimators.two_path import TwoPath
from isas_cli.rendering import rays
from isas_cli.rendering.contours import Contours
from isas_cli.rendering.outline import Cameras
from isas_cli.rendering.pixels import PixelDistribution, Tiles
from isas_cli.runtime import backend, streams
from isas_cli.runtime.errors import InputError
from isas_cli.scene import export
from isas_cli.scene.photos import building
from isas_cli.scene.photos.camera import Camera
from isas_cli.scene.photos.lens import Lens

SMALL = ["scene=photos", "evaluation.count=2", *QUIET, "estimator.batch=4096"]
ALL = "photos.lens=[focal,centre,radial]"
POSED = "photos.pose=true", "photos.background=black"


@pytest.fixture(scope="module")
def taken(tmp_path_factory) -> list[str]:
    """Settings of four pictures of a box whose mesh and light are known."""
    folder = tmp_path_factory.mktemp("lens")
    box.photographed(folder, 4, "alpha")
    box.turned_mesh(folder / "box.obj", 0, 1)
    named = f"photos.path={folder}", f"photos.mesh={folder / 'box.obj'}"
    return [*named, f"photos.environment={folder / 'white.png'}"]


def problem(*settings: str):
    return built(*SMALL, *settings)


def seen(views, sensors, axes: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the pixels of ``views`` are, and where points on their rays are seen by lenses of
    ``values (V, 4)``, by the formula."""
    place = views.locate(dr.arange(mi.UInt32, views.total))
    ray, _ = rays.through(sensors, views, *place, mi.Point2f(0.25, 0.75), mi.Point2f(0.5))
    view, way = np.array(place[0]), np.array(ray.d).T
    inside = np.einsum("nij,nj->ni", axes[view], way)
    p = inside[:, :2] / inside[:, 2:]
    a, m, k = values[view, :1], values[view, 1:3], values[view, 3:]
    (width, height) = views.sizes[0]
    middle = np.array([width, height]) / 2
    found = middle + box.FOCAL * (m + (1 + a) * p * (1 + k * np.sum(p * p, axis=1)[:, None]))
    return np.array(place[1:]).T + [0.25, 0.75], found


def test_rays_go_where_the_lens_has_them(taken):
    """Of views to learn from and of those held out, which share the lens."""
    made = problem(*taken, ALL, "photos.test=[3]")
    lens = made.unknowns["lens"].kind
    assert made.unknowns["lens"].start.shape == (1, 4) and lens.glass.names == ("0.png",)
    pixels = np.float32([[4.0, -2.0, 3.0, 2.5]])
    made.unknowns.write(made.unknowns.starts() | made.unknowns.values_of({"lens": pixels}))
    axes = np.stack([place[:3, :3].T * [[1], [-1], [-1]] for place in box.cameras(4)])
    half = box.SIZE[0] / 2
    away = half / box.FOCAL
    size = np.array([1 / half, 1 / box.FOCAL, 1 / box.FOCAL, 1 / (box.FOCAL * away**3)])
    values = np.repeat(pixels * size, 4, axis=0)
    for each, part in ((made, slice(0, 3)), (made.held_out, slice(3, 4))):
        wanted, found = seen(each.views, each.sensors, axes[part], values[part])
        np.testing.assert_allclose(found, wanted, atol=2e-3)
    told = lens.told(pixels)["0.png"]
    assert told["focal"] == pytest.approx(box.FOCAL * (1 + 4 / half))
    assert (told["centre_x"], told["centre_y"]) == pytest.approx((-2, 3))
    assert told["radial"] == pytest.approx(values[0, 3])
    assert lens.numbers(pixels, None) == told


def test_outlines_are_seen_through_the_lens(taken):
    """Of focal length and principal point, which keep lines straight."""
    made = problem(*taken, "photos.lens=[focal,centre]")
    pixels = np.float32([[-3.0, 2.0, 1.0]])
    made.unknowns.write(made.unknowns.starts() | made.unknowns.values_of({"lens": pixels}))
    place = made.views.locate(dr.arange(mi.UInt32, made.views.total))
    ray, _ = rays.through(made.sensors, made.views, *place, mi.Point2f(0.25, 0.75), mi.Point2f(0.5))
    cameras = Cameras.of(made).through(made.views.lens, made.views.axes)
    found = np.array(cameras.project(place[0], ray.o + 2 * ray.d))
    np.testing.assert_allclose(found, np.array(place[1:]) + [[0.25], [0.75]], atol=0.02)


def test_lenses_are_shared_by_cameras_that_are_alike(taken, tmp_path):
    each = problem(*taken, "photos.lens=[radial]", "photos.lenses=each")
    assert each.unknowns["lens"].start.shape == (4, 1)
    assert list(each.unknowns["lens"].kind.glass.of) == [0, 1, 2, 3]
    assert each.unknowns["lens"].kind.numbers(np.zeros((4, 1)), None) == {"farthest": 0}
    box.photographed(tmp_path, 3, "alpha", focals=(1, 1.1, 1))
    two = problem(f"photos.path={tmp_path}", *taken[1:], "photos.lens=[focal]")
    assert list(two.unknowns["lens"].kind.glass.of) == [0, 1, 0]
    assert list(two.unknowns["lens"].kind.told(np.zeros((2, 1)))) == ["0.png", "1.png"]


def test_lenses_of_unlike_distortion_are_not_shared():
    """Although their pictures look alike once it is taken out."""
    cameras = [
        Camera(name, Path(name), 40, 30, 50.0, fy, 20.0, 15.0, np.eye(4), lens=lens)
        for name, fy, lens in (
            ("a", 50.0, Lens()),
            ("b", 50.0, Lens(radial=(0.1, 0.0, 0.0, 0.0))),
            ("c", 51.0, Lens()),
            ("d", 50.0, Lens()),
        )
    ]
    taken = SimpleNamespace(
        settings=PhotosConfig(lens=["focal"]),
        all=[SimpleNamespace(camera=each.pinhole()) for each in cameras],
        shown=cameras,
        capture=SimpleNamespace(cameras=cameras),
    )
    assert list(building.glass(taken).of) == [0, 1, 2, 0]


@pytest.mark.parametrize(
    "settings, told",
    [
        (["photos.lens=[zoom]"], "photos.lens=[zoom]: a list of what is unknown"),
        (["photos.lens=[focal,focal]"], "each once"),
        (["photos.lenses=both"], "photos.lenses=both: valid: shared, each"),
        ([ALL, "photos.pose=true", "photos.background=black"], "radial distortion bends"),
        ([ALL, "sampler=mitsuba"], "no other pose or lens of a view"),
    ],
)
def test_what_cannot_be_is_one_line(taken, settings, told):
    with pytest.raises(InputError, match="^[^\n]*$") as raised:
        problem(*taken, *settings)
    assert told in str(raised.value)


@pytest.mark.parametrize(
    "settings, told",
    [
        (["photos.lens=[focal]", "photos.pose=true", "photos.background=true"], "object's size"),
        (["photos.lens=[focal]", *POSED], None),
        (["photos.lens=[centre]", "photos.refine=true"], "turns of the cameras"),
        ([ALL], None),
    ],
)
def test_what_a_lens_trades_with_is_said(taken, settings, told):
    said = [each for each in problem(*taken, *settings).warnings if "can trade with" in each]
    assert len(said) == (told is not None) and all(told in each for each in said)


def test_the_export_has_the_lens(taken, tmp_path):
    """As Mitsuba's own camera has it, but for the distortion, which is said."""
    made = problem(*taken, ALL)
    scene = configured(*SMALL, *taken, ALL)[1].scene
    arrays = {unknown.key: unknown.start for unknown in made.unknowns}
    arrays["lens"] = np.float32([[5.0, 2.0, -3.0, 0.0]])
    path, told = export.write(scene, arrays, tmp_path / "flat")
    assert not any("distortion" in line for line in told)
    made.unknowns.write(made.unknowns.values_of(arrays))
    with backend.loading():
        sensor = mi.load_file(str(path)).sensors()[1]
    place = mi.Point2f(0.2, 0.7)
    theirs, _ = sensor.sample_ray(0.0, 0.0, place, 0.5)
    column, row = 0.2 * box.SIZE[0], 0.7 * box.SIZE[1]
    where = mi.UInt32(1), mi.UInt32(int(column)), mi.UInt32(int(row))
    within = mi.Point2f(column % 1, row % 1)
    ours, _ = rays.through(made.sensors, made.views, *where, within, mi.Point2f(0.5))
    np.testing.assert_allclose(np.array(theirs.d), np.array(ours.d), atol=1e-5)
    arrays["lens"][0, 3] = 1.0
    _, told = export.write(scene, arrays, tmp_path / "bent")
    assert any("radial distortions are not in the file: k = " in line for line in told)


FINE, STEP = 20, 0.4


def coverage(made, values: dict) -> float:
    """The coverage term at ``values``, by a grid of rays through each pixel."""
    made.unknowns.write(values)
    part = np.array(made.part, np.float64)
    return float(np.mean((covered(made, FINE) - part)[part >= 0] ** 2))


@pytest.fixture(scope="module")
def slopes() -> dict[tuple, float]:
    """By what they are of: differences, which need not be taken twice."""
    return {}


@pytest.mark.parametrize("freeze", [True, False])
def test_the_outline_says_what_cameras_have_to_do_with_it(taken, slopes, freeze):
    """Its derivative by lens and poses, against differences."""
    made = problem(*taken, "photos.lens=[focal,centre]", "photos.refine=true", *POSED)
    start = {each.key: each.start.copy() for each in made.unknowns}
    start["lens"][:] = -4.0, 3.0, 2.0
    start["cameras"][1] = 2.0, -3.0, 1.0, 2.0, 3.0, -2.0
    asked = [("lens", (0, n)) for n in range(3)] + [("cameras", (1, n)) for n in range(6)]
    for key, entry in asked if not slopes else []:
        ends = []
        for step in (STEP, -STEP):
            moved = {name: array.copy() for name, array in start.items()}
            moved[key][entry] += step
            ends.append(coverage(made, made.unknowns.values_of(moved)))
        slopes[key, entry] = (ends[0] - ends[1]) / (2 * STEP)
    exact = [slopes[each] for each in asked]
    chosen = Settings(batch=256, edges=1 << 15, freeze=freeze)
    (border,) = [b for b in chosen.on(made, losses.L2()).borders if isinstance(b[2], Contours)]
    rows = []
    for number in range(12):
        seeds = [dr.opaque(mi.UInt32, streams.seed(7, number, name)) for name in border[1]]
        made.unknowns.attach(made.unknowns.values_of(start))
        border[2].accumulate(made.unknowns.params[border[0]], seeds)
        taken_ = made.unknowns.taken()
        rows.append([float(np.array(taken_[key])[entry]) for key, entry in asked])
    made.unknowns.write(made.unknowns.starts())
    found, error = np.mean(rows, axis=0), np.std(rows, axis=0) / np.sqrt(len(rows))
    print(np.round(found / exact, 3), np.round(error / np.abs(exact), 3))
    assert np.all(np.abs(found - exact) < 4 * error + 0.03 * np.abs(exact).max())


def test_size_and_focal_length_step_together(taken):
    """By differences of what is a function of both, and so that the object looks as large."""
    made = problem(*taken, "photos.lens=[focal,centre]", "photos.lenses=each", *POSED)
    (both,) = made.unknowns.together
    rng = np.random.default_rng(1)
    lens = rng.normal(0, 3, (4, 3)).astype(np.float32)
    slope = {"lens": rng.normal(size=(4, 3)), "size": rng.normal(size=1)}
    values = {"lens": mi.TensorXf(lens), "size": mi.Float(0.1)}
    given = {"lens": mi.TensorXf(slope["lens"].astype(np.float32)), "size": mi.Float(slope["size"])}
    found = both.directed(given, values)
    for entry in ((0, 0), (2, 0), (1, 1)):
        ends = []
        for step in (0.1, -0.1):
            moved = lens.copy()
            moved[entry] += step
            size = both.follow(values["lens"], mi.TensorXf(moved), values["size"])
            ends.append(np.sum(slope["lens"] * moved) + slope["size"][0] * float(size[0]))
        assert np.array(found["lens"])[entry] == pytest.approx((ends[0] - ends[1]) / 0.2, rel=2e-3)
    assert float(found["size"][0]) == pytest.approx(slope["size"][0])
    # Lenses twice as long show an object of half the size as large.
    half = box.SIZE[0] / 2
    twice = both.follow(mi.TensorXf(0 * lens), mi.TensorXf(0 * lens + half), mi.Float(0.5))
    assert float(twice[0]) == pytest.approx(-0.5)


def test_focal_length_and_size_are_told_by_perspective(tmp_path):
    """Both a tenth off, with a pose and colours that are unknown. Seen: 0.3 to 1.8 % of both."""
    box.photographed(tmp_path, 8, "alpha", focals=1 / 1.1)
    corners = box.turned_mesh(tmp_path / "box.obj", 6, 1.08)
    run = isas_cli.run(
        *SMALL[:-1],
        *(f"photos.path={tmp_path}", f"photos.mesh={tmp_path / 'box.obj'}", "photos.lens=[focal]"),
        *(f"photos.environment={tmp_path / 'white.png'}", *POSED, "estimator.batch=2048"),
        *("estimator.edges=4096", "budget.iterations=300", f"hydra.run.dir={tmp_path / 'run'}"),
    )
    (found,) = run.summary["lens"].values()
    degrees, size, _ = box.off(run.parameters(), corners)
    assert found["focal"] == pytest.approx(box.FOCAL, rel=0.03)
    assert abs(size) < 0.03 and degrees < 0.2


# What the file does not tell; and it says a focal length that is too short by a twentieth.
LENS = 2.0, -1.5, 0.1


def test_a_lens_is_found(tmp_path, capsys):
    """From how a known box of unknown colours looks. Seen: 0.3 %, 0.03 pixels, 0.015."""
    box.photographed(tmp_path, 8, "alpha", lens=LENS, focals=1 / 1.05)
    box.turned_mesh(tmp_path / "box.obj", 0, 1)
    run = isas_cli.run(
        *SMALL[:-1],
        *(f"photos.path={tmp_path}", f"photos.mesh={tmp_path / 'box.obj'}", ALL),
        *(f"photos.environment={tmp_path / 'white.png'}", "photos.background=black"),
        *("estimator.batch=16384", "budget.iterations=300", f"hydra.run.dir={tmp_path / 'run'}"),
    )
    (found,) = run.summary["lens"].values()
    said = capsys.readouterr().err
    print(said)
    assert f"lens of 0.png: focal {found['focal']:.4g}, centre x {found['centre_x']:.4g}" in said
    assert found["focal"] == pytest.approx(box.FOCAL, rel=0.01)
    assert (found["centre_x"], found["centre_y"]) == pytest.approx(LENS[:2], abs=0.5)
    assert found["radial"] == pytest.approx(LENS[2], abs=0.05)


def test_paths_of_a_single_view_are_independent(taken, monkeypatch):
    """Its number is one entry, whatever is drawn in it."""
    made = problem(*taken, "photos.lens=[focal]", "photos.test=[0,1,2]")
    assert made.views.count == 1
    widths, honest = [], rays.stream
    monkeypatch.setattr(
        rays, "stream", lambda s, count: (widths.append(count), honest(s, count))[1]
    )
    estimator = TwoPath(made, losses.L2(), 256, freeze=False)
    drawn = PixelDistribution.uniform(Tiles.over(made.views))
    estimator.gradients(made.unknowns.starts(), drawn, 1, 0, 0.0)
    assert len(widths) == 4 and set(widths) == {256}  # two paths, and both ends of a difference
