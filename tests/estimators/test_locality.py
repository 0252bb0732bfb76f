"""Gradients of parts by the pixels that they reach: the same mean as by all pixels, less noise."""

from __future__ import annotations

from functools import lru_cache

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from crosses import some
from isas_cli.scenes import meshes, stage
from scenes_for_tests import render_targets, without_targets
from scipy import stats

from isas_cli import losses
from isas_cli.config.schema import BlurConfig, PoseConfig, UnknownConfig
from isas_cli.estimators.locality import Locality
from isas_cli.estimators.plateau import Plateau
from isas_cli.rendering.pixels import PixelDistribution, Tiles
from isas_cli.runtime.errors import InputError
from isas_cli.unknowns.blur import Blur
from isas_cli.unknowns.parameters import as_numpy

KEY, SKY = "cards.place", "sky.radiance.value"
BATCH = 3 * 432
# Across and up, card after card. The second stands half before the first, so that what one shows
# depends on the other's place; the first may leave its range.
START = (0.35, 0.05, -0.1, -0.05, 0.15, 0.1)
RANGE = (-0.5, 0.4)
LEVEL = 1e-4


def cards(reach: float | None, pose: dict | None = None, objects: tuple = ("cards",)):
    """Three cards, one behind the other, before an even sky, which is all that is seen of light:
    what one reaches are the pixels that it covers. The truth has them side by side. Another unknown
    comes first, the sky, and another view, which shows the cards from the side."""
    middles = np.array([[-0.6, 0, 0], [0, 0, 0.1], [0.6, 0, 0.2]])
    surface = stage.boxes(middles, (0.2, 0.2, 0.005))
    cards = meshes.shape("cards", surface, {"type": "diffuse", "reflectance": 0.9})
    scene = {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 1},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.3}},
        "cards": cards,
        "other": {"type": "sphere", "center": [0, 5, 0], "radius": 0.1},
        "sensor_000": stage.camera([2, 0, 2.5], (0, 0, 0), 45.0, 8),
        "sensor_001": stage.camera([0, 0, 3], (0, 0, 0), 45.0, 24),
    }
    kind = {"kind": "translation", "directions": [[1, 0, 0], [0, 1, 0]], "parts": 3}
    kind["at"] = [0.01, -0.01]
    poses = {KEY: PoseConfig(objects=list(objects), **(kind if pose is None else pose))}
    blur = BlurConfig(start=0.1, end=0.1, reach=reach)
    moved = UnknownConfig(start=list(START), range=list(RANGE), blur=blur)
    if pose is not None:
        moved = UnknownConfig(start=0.0, blur=blur)
    sky = UnknownConfig(start=[0.25] * 3, blur=BlurConfig(start=0.02, end=0.02))
    p = without_targets(scene, {SKY: sky, KEY: moved}, poses)
    render_targets(p, 64)
    return p


def drawn(p) -> PixelDistribution:
    """Not uniform: twice as many in one half of the pixels."""
    tiles = Tiles.over(p.views)
    weights = 1 + mi.Float(dr.arange(mi.UInt32, tiles.count) & 1)
    return PixelDistribution.from_weights(weights, tiles)


def rows(reach: float | None, count: int = 700, base: int = 5, **settings) -> np.ndarray:
    """``count`` gradients by all places and the sky, ``(count, 9)``."""
    p = cards(reach)
    estimator = Plateau(p, losses.L2(), BATCH, **settings)
    values, pixels = p.unknowns.starts(), drawn(p)
    found = []
    for i in range(count):
        gradient = estimator.estimate(values, pixels, base, i, 0.0)
        found.append(np.concatenate([as_numpy(gradient[key]).ravel() for key in (KEY, SKY)]))
    return np.array(found)


def p_value(found: np.ndarray, reference: np.ndarray) -> float:
    test = stats.ttest_ind(found, reference, equal_var=False)
    print("found", found.mean(axis=0), "reference", reference.mean(axis=0), "p", test.pvalue)
    print("variance, of all pixels over near ones", reference.var(axis=0) / found.var(axis=0))
    return min(1.0, test.pvalue.size * test.pvalue.min())


@lru_cache(maxsize=None)
def whole(smooth: str) -> np.ndarray:
    """By all pixels, with the least variance that can be had: one unknown after the other."""
    return rows(None, 200, base=6, scheme="separate", smooth=smooth)


@pytest.mark.parametrize("smooth", some(("image", "loss"), ("loss",)))
def test_pixels_that_a_part_does_not_reach_add_nothing_in_the_mean(smooth):
    near = rows(0.4, smooth=smooth)
    assert p_value(near, whole(smooth)) > LEVEL
    # Of the places across at least one has a slope that is seen well.
    across = near[:, 0:6:2]
    assert np.abs(across.mean(axis=0) / (across.std(axis=0) / np.sqrt(len(near)))).max() > 8


def test_they_do_add_noise():
    near, everywhere = (rows(reach, 300)[:, :6].var(axis=0) for reach in (0.4, None))
    print(everywhere / near)
    assert everywhere.sum() > 1.5 * near.sum()


def test_a_reach_that_ends_inside_the_part_is_noticed():
    assert p_value(rows(0.1, smooth="loss"), whole("loss")) < LEVEL


def test_with_a_reach_as_wide_as_the_image_nothing_changes():
    wide, none = rows(50.0, 5), rows(None, 5)
    assert np.allclose(wide, none, rtol=1e-3, atol=1e-5 * np.abs(none).max())


@pytest.mark.parametrize(
    "pose, objects, words",
    [
        ({"kind": "rotation", "axis": [0, 1, 0]}, ("cards",), "only for a translation"),
        (
            {"kind": "translation", "directions": [[1, 0, 0]]},
            ("cards", "other"),
            "only for a pose of one object",
        ),
    ],
)
def test_a_reach_without_a_middle_is_refused(pose, objects, words):
    with pytest.raises(InputError, match=rf"scene.unknowns\['{KEY}'\].blur.reach=0.4: .*{words}"):
        Plateau(cards(0.4, pose, objects), losses.L2(), BATCH)


def test_a_reach_of_what_no_pose_moves_is_refused():
    p = cards(None)
    p.unknowns.items[0].blur.reach = 0.4
    with pytest.raises(InputError, match=rf"\['{SKY}'\].*only for what a pose moves"):
        Plateau(p, losses.L2(), BATCH)


def test_a_reach_with_a_camera_that_moves_is_refused():
    pose = {"kind": "translation", "directions": [[1, 0, 0]]}
    with pytest.raises(InputError, match="only where no pose moves a camera"):
        Plateau(cards(0.4, pose, ("sensor_000",)), losses.L2(), BATCH)


THIN = {"type": "thinlens", "aperture_radius": 0.3, "focus_distance": 3.0}


@pytest.mark.parametrize(
    "sensor, sharp",
    [
        (THIN, False),
        ({"type": "batch", "a": {"type": "orthographic"}, "b": THIN}, False),
        ({"type": "distant"}, False),
        ({"type": "radiancemeter"}, True),
        ({"type": "batch", "a": {"type": "orthographic"}, "b": {"type": "perspective"}}, True),
    ],
    ids=["thinlens", "batch of one", "distant", "radiancemeter", "sharp batch"],
)
def test_a_reach_where_pixels_see_along_many_rays_is_refused(sensor, sharp):
    film = {"type": "hdrfilm", "width": 2, "height": 1, "rfilter": {"type": "box"}}
    if sensor["type"] in ("distant", "radiancemeter"):
        film["width"] = 1
    scene = {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 2},
        "sky": {"type": "constant"},
        "ball": {"type": "sphere", "radius": 0.1},
        "eye": stage.camera([0, 0, 3], (0, 0, 0), 45.0, 8),
        "other": sensor | {"film": film},
    }
    pose = PoseConfig(kind="translation", objects=["ball"], directions=[[0, 1, 0]])
    unknown = UnknownConfig(start=0.0, blur=BlurConfig(start=1, end=1, reach=1))
    p = without_targets(scene, {KEY: unknown}, {KEY: pose})
    if sharp:
        Locality(p, Blur(p, "test"), 8)
        return
    with pytest.raises(InputError, match="reach=1: .* pixel of sensor 1 sees: leave reach out"):
        Locality(p, Blur(p, "test"), 8)


def test_a_reach_with_a_camera_of_a_batch_that_moves_is_refused():
    film = {"type": "hdrfilm", "width": 4, "height": 2, "rfilter": {"type": "box"}}
    cameras = {"a": {"type": "perspective"}, "b": {"type": "perspective"}}
    scene = {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 2},
        "sky": {"type": "constant"},
        "ball": {"type": "sphere", "center": [0, 0, 3], "radius": 0.1},
        "pair": {"type": "batch", "film": film} | cameras,
    }
    kind = {"kind": "translation", "directions": [[0, 1, 0]]}
    poses = {KEY: PoseConfig(objects=["ball"], **kind)}
    poses["eye.place"] = PoseConfig(objects=["pair.a"], **kind)
    moved = {key: UnknownConfig(start=0.0, blur=BlurConfig(start=1, end=1)) for key in poses}
    moved[KEY].blur.reach = 1
    p = without_targets(scene, moved, poses)
    with pytest.raises(InputError, match="only where no pose moves a camera"):
        Locality(p, Blur(p, "test"), 8)


def test_a_reach_of_more_sums_than_fit_is_refused():
    with pytest.raises(InputError, match="3 parts times estimator.batch=1000000000 .* smaller"):
        p = cards(0.4)
        Locality(p, Blur(p, "test"), 1_000_000_000)


def test_a_reach_must_be_a_length():
    with pytest.raises(InputError, match="blur.reach=0: must be above 0"):
        BlurConfig(start=1, end=1, reach=0)


@pytest.mark.parametrize("moved", ("sphere", "point"))
def test_the_middle_of_objects_that_are_no_meshes(moved):
    """A sphere's and a point light's are where their transforms put them."""
    kinds = {
        "sphere": {"type": "sphere", "center": [0.5, 0.25, -1], "radius": 0.1},
        "point": {"type": "point", "position": [0.5, 0.25, -1]},
    }
    scene = {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 2},
        "sky": {"type": "constant"},
        "sensor_000": stage.camera([0, 0, 3], (0, 0, 0), 45.0, 8),
        "ball": kinds[moved],
    }
    pose = PoseConfig(kind="translation", objects=["ball"], directions=[[0, 1, 0]])
    unknown = UnknownConfig(start=0.0, blur=BlurConfig(start=1, end=1, reach=1))
    p = without_targets(scene, {KEY: unknown}, {KEY: pose})
    found, middles = p.unknowns.place(KEY, "test")
    assert found.parts == 1 and np.allclose(middles, [[0.5, 0.25, -1]])
