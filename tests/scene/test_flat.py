"""Pictures of one colour are held as few texels, and nothing else changes."""

import mitsuba as mi
import numpy as np
import pytest

from isas_cli.scene import flat

WALL, FLOOR, SKY = "wall.bsdf.reflectance.data", "floor.bsdf.reflectance.data", "sky.data"


def picture(array: np.ndarray) -> dict:
    return {"type": "bitmap", "data": mi.TensorXf(array.astype(np.float32)), "raw": True}


def scene(sky: np.ndarray) -> mi.Scene:
    to = mi.ScalarTransform4f()
    board = np.indices((32, 32)).sum(axis=0)[..., None] % 2 * np.ones(3)
    bsdf = {"type": "diffuse", "reflectance": picture(np.full((64, 32, 3), (0.2, 0.5, 0.7)))}
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 3},
            "sky": {"type": "envmap", "bitmap": mi.Bitmap(sky.astype(np.float32))},
            "wall": {"type": "sphere", "radius": 0.7, "bsdf": bsdf},
            "floor": {
                "type": "rectangle",
                "to_world": to.translate([0, -0.7, 0]).rotate([1, 0, 0], -90).scale(3),
                "bsdf": {"type": "diffuse", "reflectance": picture(board)},
            },
            "sensor": {
                "type": "perspective",
                "to_world": to.look_at([0, 1, 4], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 16, "height": 16},
            },
        },
        optimize=False,
    )


def image(loaded: mi.Scene, spp: int = 1024) -> np.ndarray:
    return np.array(mi.render(loaded, spp=spp, seed=3))


def test_renderings_stay_what_they_are():
    loaded = scene(np.full((64, 128, 3), 1.5))
    before = image(loaded)
    assert set(flat.reduce(mi.traverse(loaded), set())) == {WALL, SKY}
    params = mi.traverse(loaded)
    assert params[WALL].shape == (1, 1, 3) and params[SKY].shape == (16, 34, 3)
    after = image(loaded)
    # The map's directions are drawn a little differently: the same light, another noise.
    assert np.abs(after / before - 1).mean() < 0.02 and abs(after.mean() / before.mean() - 1) < 2e-3


def test_what_has_detail_or_is_unknown_stays():
    sky = np.full((64, 128, 3), 1.5)
    sky[3, 7] = 2
    loaded = scene(sky)
    before = image(loaded, 4)
    assert flat.reduce(mi.traverse(loaded), {WALL}) == []
    # Sums on a film have no order of their own.
    assert np.allclose(image(loaded, 4), before, rtol=1e-5)


@pytest.mark.parametrize("unknown", [WALL, SKY])
def test_an_unknown_of_one_colour_keeps_its_texels(unknown):
    loaded = scene(np.full((64, 128, 3), 1.5))
    shape = mi.traverse(loaded)[unknown].shape
    assert unknown not in flat.reduce(mi.traverse(loaded), {unknown})
    assert mi.traverse(loaded)[unknown].shape == shape


def test_a_picture_of_a_single_row_keeps_it():
    """Mitsuba takes no update of one."""
    row = {"type": "diffuse", "reflectance": picture(np.full((1, 8, 3), 0.5))}
    described = {"type": "scene", "wall": {"type": "sphere", "bsdf": row}}
    loaded = mi.load_dict(described, optimize=False)
    assert flat.reduce(mi.traverse(loaded), set()) == []
    assert mi.traverse(loaded)[WALL].shape == (1, 8, 3)


def test_a_projector_keeps_the_sides_of_its_picture():
    white = mi.TensorXf(np.ones((16, 64, 3), np.float32))
    described = {
        "type": "scene",
        "lamp": {"type": "projector", "irradiance": {"type": "bitmap", "data": white, "raw": True}},
    }
    loaded = mi.load_dict(described, optimize=False)
    assert flat.reduce(mi.traverse(loaded), set()) == []
