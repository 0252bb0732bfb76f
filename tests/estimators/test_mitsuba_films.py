"""Mitsuba's own derivative whatever the films of the scene are: the same as with the films of
isas's own scenes, whose pixels are means over their squares."""

from __future__ import annotations

import functools

import mitsuba as mi
import numpy as np
import pytest
from blurred_gradients import uniform
from poses_for_tests import PLACE, description
from scenes_for_tests import TEXTURE, UNKNOWNS, dictionary, without_targets

from isas_cli import losses
from isas_cli.config.schema import BlurConfig, PoseConfig, UnknownConfig
from isas_cli.estimators.mitsuba import WholeImages
from isas_cli.rendering.own_film import OwnFilm
from isas_cli.runtime.errors import InputError

FILMS = {
    "stock": {"type": "hdrfilm"},
    "gaussian": {"type": "hdrfilm", "rfilter": {"type": "gaussian"}, "pixel_format": "rgba"},
    "lanczos": {"type": "hdrfilm", "rfilter": {"type": "lanczos"}, "sample_border": True},
    "luminance": {"type": "hdrfilm", "rfilter": {"type": "box"}, "pixel_format": "luminance"},
}
CROP = {"crop_width": 5, "crop_height": 3, "crop_offset_x": 2, "crop_offset_y": 4}
SENSORS = "sensor_000", "sensor_001"


def problem(film: dict | None, crop: dict, sensor: dict | None = None):
    """The textured floor; ``film`` instead of the first sensor's, which keeps its size."""
    scene = dictionary()
    own = scene[SENSORS[0]]
    size = {name: own["film"][name] for name in ("width", "height")}
    own["film"] = {**(film or own["film"]), **size, **crop}
    own |= sensor or {}
    return grey(without_targets(scene, UNKNOWNS))


def grey(p):
    """``p`` with targets of one grey."""
    p.set_targets(mi.Float(np.full(3 * p.views.total, 0.4, np.float32)), None, "grey")
    p.unknowns.write(p.unknowns.starts())
    return p


def gradient(p, batch: int = 4096, **settings) -> dict[str, np.ndarray]:
    found = WholeImages(p, losses.L2(), batch, **settings).estimate(
        p.unknowns.starts(), uniform(p), 7, 0, 0.0
    )
    return {key: np.array(value) for key, value in found.items()}


@functools.cache
def plain(cropped: bool) -> tuple[list, dict[str, np.ndarray]]:
    """The sizes of films and the gradient of a box."""
    p = problem(None, CROP if cropped else {})
    return p.film_sizes, gradient(p)


@pytest.mark.parametrize("cropped", (False, True), ids=("whole", "cropped"))
@pytest.mark.parametrize("film", FILMS)
def test_any_film_gives_the_gradient_of_a_box(film, cropped):
    # First, as a scene that nobody needs any more is not to be collected within a trace.
    sizes, expected = plain(cropped)
    p = problem(FILMS[film], CROP if cropped else {})
    assert p.film_sizes == sizes
    found = gradient(p)
    assert np.abs(expected[TEXTURE]).max() > 1e-5
    for key in found:
        np.testing.assert_allclose(found[key], expected[key], rtol=1e-4, atol=1e-8)


def test_the_scene_keeps_its_film():
    p = problem(FILMS["gaussian"], CROP)

    def stands() -> tuple:
        sensor = p.scene.sensors()[0]
        return str(sensor.film()), mi.traverse(p.scene).keys(), sensor.id()

    before = stands()
    gradient(p)
    assert stands() == before and "Gaussian" in before[0]


def test_a_thin_lens_where_nothing_moves():
    """A sensor of another kind, sharp: the pinhole's gradient."""
    lens = {"type": "thinlens", "aperture_radius": 1e-6, "focus_distance": 3.0}
    found = gradient(problem(FILMS["stock"], {}, lens), 1 << 17)[TEXTURE]
    expected = gradient(problem(None, {}), 1 << 17)[TEXTURE]
    assert np.corrcoef(found.ravel(), expected.ravel())[0, 1] > 0.99


def moving(film: dict | None = None, **sensor):
    scene = description()
    own = scene["sensor_000"]
    size = {name: own["film"][name] for name in ("width", "height")}
    own["film"] = own["film"] if film is None else {**film, **size}
    own |= sensor
    pose = PoseConfig(kind="translation", objects=["ball"], directions=[[1, 0, 0]], at=[0.2])
    unknown = UnknownConfig(start=-0.2, blur=BlurConfig(start=0.3, end=0.1))
    return grey(without_targets(scene, {PLACE: unknown}, {PLACE: pose}))


class Sum(losses.L2):
    """The images themselves."""

    def derivative(self, image, target):
        return mi.Color3f(1) + 0 * image


def slopes(crop: dict, weights: np.ndarray) -> np.ndarray:
    """Of the images' mean by the ball's place."""
    p = moving(FILMS["stock"] | crop)
    p.set_targets(p.targets, mi.Float(np.float32(weights.ravel())), "weighed")
    found = WholeImages(p, Sum(), 1 << 16, silhouettes="direct")
    values = p.unknowns.starts()
    return np.array([found.estimate(values, uniform(p), 7, i, 0.0)[PLACE][0] for i in range(12)])


def test_silhouettes_lie_where_a_crop_window_shows_them():
    """The right half alone, and the whole image of which nothing else counts."""
    crop = {"crop_width": 4, "crop_height": 6, "crop_offset_x": 4, "crop_offset_y": 0}
    found = slopes(crop, np.ones((6, 4)))
    expected = slopes({}, np.repeat([[0.0] * 4 + [1.0] * 4], 6, axis=0))
    error = np.sqrt((found.var(ddof=1) + expected.var(ddof=1)) / len(found))
    print(found.mean(), expected.mean(), "±", error)
    assert abs(found.mean() - expected.mean()) < 4 * error < 0.2 * abs(expected.mean())


@functools.cache
def still(smooth: str | None) -> np.ndarray:
    return gradient(moving(), smooth=smooth, silhouettes="direct")[PLACE]


@pytest.mark.parametrize("smooth", (None, "image"))
@pytest.mark.parametrize("film", ("stock", "lanczos"))
def test_what_moves_is_differentiated_through_any_film(film, smooth):
    settings = {"smooth": smooth, "silhouettes": "direct"}
    found = gradient(moving(FILMS[film]), **settings)[PLACE]
    expected = still(smooth)
    assert abs(expected[0]) > 1e-4
    np.testing.assert_allclose(found, expected, rtol=1e-3)


def test_cameras_whose_silhouettes_mitsuba_does_not_sample_are_refused():
    with pytest.raises(InputError, match="sensor 0 is no perspective camera.*estimator=plateau"):
        gradient(moving(type="thinlens", aperture_radius=0.1, focus_distance=3.0))


def test_it_passes_for_the_sensor_that_it_is():
    sensor = problem(None, {}).scene.sensors()[0]
    own = OwnFilm(sensor)
    assert isinstance(own, mi.Sensor) and repr(own) == repr(sensor)
    assert own.film() is not sensor.film() and own.needs_aperture_sample() is False
