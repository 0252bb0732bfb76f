"""Unknown lenses of photographs: which way rays go, who shares one, and that they are found."""

import _drawn_box as box
import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import isas_cli
from isas_cli.config.compose import compose, translate
from isas_cli.engine import experiment
from isas_cli.engine.display import Display
from isas_cli.engine.experiment import Phases
from isas_cli.rendering import rays
from isas_cli.rendering.outline import Cameras
from isas_cli.runtime import backend
from isas_cli.runtime.errors import InputError
from isas_cli.scene import export

QUIET = ["scene=photos", "evaluation.count=2", "frames.views=0", "frames.snapshots=0"]
QUIET += ["report=false", "estimator.batch=4096"]
ALL = "photos.lens=[focal,centre,radial]"


@pytest.fixture(scope="module")
def taken(tmp_path_factory) -> list[str]:
    """Settings of four pictures of a box whose mesh and light are known."""
    folder = tmp_path_factory.mktemp("lens")
    box.photographed(folder, 4, "alpha")
    box.turned_mesh(folder / "box.obj", 0, 1)
    named = f"photos.path={folder}", f"photos.mesh={folder / 'box.obj'}"
    return [*named, f"photos.environment={folder / 'white.png'}"]


def problem(*settings: str):
    cfg = compose(translate([*QUIET, *settings]))
    typed, _ = experiment.checked(cfg)
    with Display(typed.budget) as display:
        return experiment.built(typed, Phases(display), [cfg])


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
        (["photos.lens=[focal]", "photos.pose=true", "photos.background=black"], "object's size"),
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
    scene = experiment.checked(compose(translate([*QUIET, *taken, ALL])))[0].scene
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


# What the file does not tell; and it says a focal length that is too short by a twentieth.
LENS = 2.0, -1.5, 0.1


def test_a_lens_is_found(tmp_path, capsys):
    """From how a known box of unknown colours looks. Seen: 0.3 %, 0.03 pixels, 0.015."""
    box.photographed(tmp_path, 8, "alpha", lens=LENS, focals=1 / 1.05)
    box.turned_mesh(tmp_path / "box.obj", 0, 1)
    run = isas_cli.run(
        *QUIET[:-1],
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
