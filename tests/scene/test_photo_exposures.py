"""Unknown exposures: where they begin, and which way steps go."""

import dataclasses

import _drawn_box as box
import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from PIL import Image

from isas_cli.config.schema import PhotosConfig, UnknownConfig
from isas_cli.runtime.errors import InputError
from isas_cli.scene.photos import brightness, building, photographs
from isas_cli.scene.views import Views
from isas_cli.unknowns.exposure import Exposure
from isas_cli.unknowns.kind import Loaded
from isas_cli.unknowns.specs import parse

PIXELS = np.array([2.0, 1.0, 4.0, 0.5])
TRUTH = np.array([[1.0], [0.4], [1.0], [2.5]])


def loaded(folder, views: int, degrees: float, size: float, **more) -> photographs.Photographs:
    """Photographs of the box, and a mesh of it that is so far off."""
    box.photographed(folder, views, "alpha", **more)
    box.turned_mesh(folder / "box.obj", degrees, size)
    mesh = str(folder / "box.obj")
    return photographs.load(PhotosConfig(str(folder), mesh=mesh, exposure="scale"))


def kind(channels: int = 1) -> Exposure:
    params = mi.traverse(mi.load_dict({"type": "scene"}))
    found = Exposure("exposure", Loaded(params, views=Views.of([(4, 3)] * 4), channels=channels))
    found.compare(PIXELS)
    return found


def directed(unknown: Exposure, gradient: np.ndarray, value: np.ndarray) -> np.ndarray:
    found = unknown.directed(*(unknown.value(x.astype(np.float32)) for x in (gradient, value)))
    dr.eval(found)
    return np.array(found)


def gradient(exposures: np.ndarray, colour: float) -> np.ndarray:
    """Of Σ_v N_v (e_v c - t_v)², what is seen a colour c of which 1 is true."""
    return 2 * PIXELS[:, None] * (exposures * colour - TRUTH) * colour


@pytest.mark.parametrize("colour", [0.3, 1.0, 2.0])
@pytest.mark.parametrize("apart", [0.98, 1.0, 1.02])
def test_steps_go_to_the_truth_whatever_the_colour_is(colour, apart):
    """Of exposures that are right nothing moves, whatever the colour; of others that are off, all
    go back. Along the derivative itself they go where the colour sends them."""
    value = TRUTH * np.where(np.arange(4) > 0, apart, 1)[:, None]
    slope = gradient(value, colour)
    found = directed(kind(), slope, value)
    assert found[0, 0] == 0
    if apart == 1:
        np.testing.assert_allclose(found, 0, atol=1e-4 * np.abs(slope).max() + 1e-6)
    else:
        assert (np.sign(found[1:]) == np.sign(apart - 1)).all()
    if colour != 1:
        assert (np.sign(slope[1:]) == np.sign(colour - 1)).all()


def test_a_first_view_that_shows_nothing_tells_nothing():
    unknown = kind(3)
    unknown.compare(PIXELS * [0, 1, 1, 1])
    slope = np.random.default_rng(1).normal(size=(4, 3))
    found = directed(unknown, slope, np.ones((4, 3)))
    np.testing.assert_allclose(found[1:], slope[1:], rtol=1e-6)
    assert (found[0] == 0).all()


def test_the_first_view_is_the_unit():
    unknown = kind()
    np.testing.assert_allclose(
        unknown.normal(np.float32([[2], [4], [1], [6]])).ravel(), [1, 2, 0.5, 3]
    )


FACTORS = 1.0, 0.4, 1.2, 0.8, 0.6, 1.1


def test_a_start_is_of_every_view():
    """Of three views and three channels a plain list might mean either."""
    params = mi.traverse(mi.load_dict({"type": "scene"}))
    of_views = {"views": Views.of([(4, 3)] * 3), "channels": 3}

    def start(value) -> np.ndarray:
        asked = {"exposure": UnknownConfig(start=value)}
        return parse(params, asked, False, of_views=of_views)[0].start

    with pytest.raises(InputError, match=r"for every view, such as \[\[1\], \[1.2\]\]"):
        start([1.0, 1.2, 0.9])
    found = start([[1.0], [1.2], [0.9]])
    np.testing.assert_allclose(found, np.repeat([[1.0], [1.2], [0.9]], 3, axis=1))


@pytest.mark.parametrize("kind, channels", [("scale", 1), ("channels", 3)])
def test_they_begin_where_places_of_the_object_are_alike(tmp_path, kind, channels):
    """Of pictures of 8 bits, whose pixels show several colours at once, whichever way the triangles
    are turned. Seen: 0.3 %; with places that look away 4 %, of a channel 12 %."""
    box.photographed(tmp_path, len(FACTORS), "alpha", scale=2, exposures=FACTORS)
    box.turned_mesh(tmp_path / "box.obj", 0, 1)
    settings = PhotosConfig(str(tmp_path), mesh=str(tmp_path / "box.obj"), exposure=kind)
    taken = photographs.load(settings)
    found, near = brightness.told(taken.shown, taken.surface, channels)
    np.testing.assert_allclose(found, np.repeat(np.array([FACTORS]).T, channels, 1), rtol=0.006)
    assert near < 0.02
    turned = dataclasses.replace(taken.surface, faces=taken.surface.faces[:, ::-1])
    again, _ = brightness.told(taken.shown, turned, channels)
    np.testing.assert_allclose(again, found, rtol=0.006)
    spec = building.unknowns(taken, {}, {})["exposure"]
    assert spec.start == found.tolist() and spec.lr < UnknownConfig(lr=0.05).lr
    assert f"exposures between {found.min():.3g} and" in taken.capture.notes[-1]


def test_pictures_that_contradict_each_other_tell_it_vaguely(tmp_path):
    """Of a mesh that stands elsewhere, at true exposures of 1: which are within what is said."""
    taken = loaded(tmp_path, 8, 35, 0.8)
    found, near = taken.exposures
    assert near > 0.1 and (np.abs(found - 1) < near).all()
    spec = building.unknowns(taken, {}, {})["exposure"]
    assert spec.lr > 0.03 and spec.start == found.tolist()


def test_what_places_tell_is_kept():
    """Within what it may be off; what they do not tell moves freely."""
    params = mi.traverse(mi.load_dict({"type": "scene"}))
    told = np.float32([[1], [0.4], [2]]), 0.02
    for near, wanted in ((told, [[1], [0.408], [1.96]]), (None, [[1], [0.5], [1]])):
        views = Views.of([(4, 3)] * 3)
        found = Exposure("exposure", Loaded(params, views=views, channels=1, told=near))
        moved = found.projected(found.value(np.float32([[1], [0.5], [1]])))
        np.testing.assert_allclose(np.array(moved), wanted, rtol=1e-6)


def test_specs_of_ones_own_are_not_held(tmp_path):
    taken = loaded(tmp_path, 6, 0, 1, exposures=FACTORS)
    views = Views.of([box.SIZE] * 6)
    assert building.of_views(taken, views)["told"] is not None
    assert building.of_views(taken, views, ["exposure"])["told"] is None


@pytest.mark.parametrize("cast", [1.0, 1.3])
def test_another_white_balance_is_told(tmp_path, cast):
    box.photographed(tmp_path, 6, "alpha", scale=2)
    for path in sorted(tmp_path.rglob("*.png"))[:2]:
        picture = np.array(Image.open(path))
        picture[..., 0] = np.clip(picture[..., 0] * cast ** (1 / 2.2), 0, 255)
        picture[..., 2] = picture[..., 2] / cast ** (1 / 2.2)
        Image.fromarray(picture).save(path)
    box.turned_mesh(tmp_path / "box.obj", 0, 1)
    taken = photographs.load(PhotosConfig(str(tmp_path), mesh=str(tmp_path / "box.obj")))
    found = brightness.tinted(taken.shown, taken.surface)
    assert (found is not None) == (cast > 1)
    if found is not None:
        assert cast * 0.9 < found[0] < cast * 1.1


def test_few_views_do_not_check_each_other(tmp_path):
    """Of another place than the file's, which four views do not notice."""
    taken = loaded(tmp_path, 4, 35, 0.8)
    assert brightness.apart(taken.shown, taken.surface).doubt == np.inf
    assert taken.exposures is None


def test_exposures_that_are_alike_are_told_as_well(tmp_path):
    taken = loaded(tmp_path, 6, 0, 1)
    found, near = taken.exposures
    np.testing.assert_allclose(found, 1, rtol=0.006)
    assert near == 0.01 and brightness.unlike(taken.shown, taken.surface) is None


@pytest.mark.parametrize("falls", [0.0, 0.4])
def test_a_lens_that_darkens_the_corners_is_told(tmp_path, falls):
    box.photographed(tmp_path, 8, "alpha", scale=2)
    box.turned_mesh(tmp_path / "box.obj", 0, 1)
    taken = photographs.load(PhotosConfig(str(tmp_path), mesh=str(tmp_path / "box.obj")))
    for each in taken.shown:
        height, width = each.image.shape[:2]
        y, x = np.mgrid[:height, :width] + 0.5
        away = ((x - width / 2) ** 2 + (y - height / 2) ** 2) / (width**2 + height**2) * 4
        each.image *= np.float32(1 - falls * away)[..., None]
    found = brightness.fallen(taken.shown, taken.surface)
    assert found is None if not falls else 0.85 < found < 0.97
    assert brightness.moved(taken.shown, taken.surface) is None
