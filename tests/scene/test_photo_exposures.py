"""Unknown exposures: which way steps go."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from isas_cli.scene.views import Views
from isas_cli.unknowns.exposure import Exposure
from isas_cli.unknowns.kind import Loaded

PIXELS = np.array([2.0, 1.0, 4.0, 0.5])
TRUTH = np.array([[1.0], [0.4], [1.0], [2.5]])


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
