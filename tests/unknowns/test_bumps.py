"""Normal maps as unknowns: texels that are directions."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from isas_cli.config.schema import UnknownConfig
from isas_cli.runtime.errors import InputError
from isas_cli.unknowns import registry
from isas_cli.unknowns.bumps import Bumps
from isas_cli.unknowns.kind import Loaded
from isas_cli.unknowns.specs import parse

KEY = "thing.bsdf.normalmap.data"


def loaded(texels: np.ndarray) -> Loaded:
    picture = {"type": "bitmap", "bitmap": mi.Bitmap(texels.astype(np.float32)), "raw": True}
    paint = {"type": "bitmap", "bitmap": mi.Bitmap(np.full((2, 2, 3), 0.4, np.float32))}
    inside = {"type": "diffuse", "reflectance": paint | {"raw": True}}
    material = {"type": "normalmap", "normalmap": picture, "bsdf": inside}
    scene = {"type": "scene", "thing": {"type": "rectangle", "id": "thing", "bsdf": material}}
    return Loaded(mi.traverse(mi.load_dict(scene, optimize=False)))


def lengths(texels: np.ndarray) -> np.ndarray:
    return np.linalg.norm(2 * texels - 1, axis=2)


@pytest.fixture
def bumps(rng) -> np.ndarray:
    """Of lengths that are none of a normal's."""
    return rng.uniform(0.3, 0.9, (4, 5, 3)) * [1, 1, 0.4] + [0, 0, 0.6]


def test_a_normal_map_is_of_its_own_kind_and_a_colour_is_not(bumps):
    offered = registry.offered(loaded(bumps))
    assert offered[KEY] is Bumps
    assert offered["thing.bsdf.nested_bsdf.reflectance.data"].name == "texture"


def test_a_range_would_not_be_kept(bumps):
    with pytest.raises(InputError, match="range: a normal map has length 1 after every step"):
        parse(loaded(bumps).params, {KEY: UnknownConfig(range=[0.2, 1.0])}, False)


def test_a_start_of_no_length_is_refused(bumps):
    """But not of the scene's own texels, which may lie where nothing shows them."""
    bumps[0, 0] = 0.5
    for truth_known in (False, True):
        params = loaded(bumps).params
        with pytest.raises(InputError, match=r"no length: give \[0.5, 0.5, 1\], which is flat"):
            parse(params, {KEY: UnknownConfig(start=0.5)}, truth_known)
        assert parse(params, {KEY: UnknownConfig(start=[0.5, 0.5, 1.0])}, truth_known)
    assert parse(params, {KEY: UnknownConfig()}, False)


def test_lengths_are_no_unknowns(bumps):
    """Of what the scene has, and after a step: directions stay, none is turned under."""
    kind = Bumps(KEY, loaded(bumps))
    np.testing.assert_allclose(lengths(kind.present), 1, atol=1e-5)
    normals, before = 2 * kind.present - 1, 2 * bumps - 1
    np.testing.assert_allclose(
        normals, before / np.linalg.norm(before, axis=2)[..., None], atol=1e-5
    )
    stepped = kind.present.copy()
    stepped[0, 0] = [0.9, 0.5, 0.2]  # under the surface
    stepped[1, 1] = [0.5, 0.5, 0.6]  # short
    found = kind.projected(kind.value(stepped))
    dr.eval(found)
    found = np.array(found)
    np.testing.assert_allclose(lengths(found), 1, atol=1e-5)
    assert found[..., 2].min() > 0.5 and found[0, 0, 0] > 0.99
    np.testing.assert_allclose(found[1, 1], [0.5, 0.5, 1], atol=1e-5)
    rest = np.ones((4, 5), bool)
    rest[0, 0] = rest[1, 1] = False
    np.testing.assert_allclose(found[rest], kind.present[rest], atol=1e-5)
    # A texel of no direction stays one, and is no NaN.
    assert np.isfinite(kind.normal(np.full((2, 2, 3), 0.5, np.float32))).all()
