"""Adam's moments averaged over neighbours of like value."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from isas_cli.filters import Bilateral, Layout, Step
from isas_cli.unknowns.parameters import own

AXES, OPEN = ((0, True), (1, True)), ((0, False), (1, False))
H = np.array([1, 4, 6, 4, 1]) / 16


def moments(values, first, second, settings, axes=AXES, seen=None, share=1.0):
    """The moments that a step is taken with, by two steps: of rate m' / √v' all there is."""
    told = None if seen is None else own(mi.Float, seen.astype(np.float32).ravel())
    on = settings.on(Layout(values.shape, axes, told), (0.9, 0.999), False)
    entries = [mi.Float(x.ravel().astype(np.float32)) for x in (values, first, second)]
    zero, ones = mi.Float(0), dr.ones(mi.Float, values.size)
    step = Step(entries[0], zero, ones, *entries[1:], dr.opaque(mi.Float, 1.0), share)
    return values - np.array(on.moved(step)).reshape(values.shape)


def reference(values, first, second, edge, levels, axes, seen):
    """In NumPy, entry by entry."""
    height, width, _ = values.shape
    for level in range(levels):
        m, v = first.copy(), second.copy()
        for y, x in np.ndindex(height, width):
            total, above = np.zeros(values.shape[2]), np.zeros((2, values.shape[2]))
            for a, b in np.ndindex(5, 5):
                at = [y + (a - 2) * 2**level, x + (b - 2) * 2**level]
                if axes[0][1]:
                    at = [at[0] % height, at[1] % width]
                elif not (0 <= at[0] < height and 0 <= at[1] < width):
                    continue
                at = tuple(at)
                apart = np.linalg.norm(values[at] - values[y, x])
                weight = H[a] * H[b] * np.exp(-apart / edge) * seen[at]
                total += weight
                above += weight * np.stack([first[at], second[at]])
            told = (total > 0) & seen[y, x]
            m[y, x] = np.where(told, above[0] / np.maximum(total, 1e-30), first[y, x])
            v[y, x] = np.where(told, above[1] / np.maximum(total, 1e-30), second[y, x])
        first, second = m, v
    return first / np.sqrt(second)


@pytest.mark.parametrize("axes", (AXES, OPEN), ids=("around", "open"))
@pytest.mark.parametrize("all_seen", (True, False))
def test_it_is_the_published_filter(axes, all_seen):
    rng = np.random.default_rng(1)
    shape = 12, 10, 3
    values, first = rng.random(shape), rng.normal(size=shape)
    second = 0.1 + rng.random(shape)
    seen = np.ones(shape, bool) if all_seen else rng.random(shape) < 0.7
    found = moments(values, first, second, Bilateral(0.3, 2), axes, None if all_seen else seen)
    wanted = reference(values, first, second, 0.3, 2, axes, seen)
    assert np.allclose(found, wanted, atol=2e-5)


def test_constant_gradients_make_the_step_that_adam_makes():
    values = np.random.default_rng(2).random((16, 16, 3))
    first, second = np.full(values.shape, 0.2), np.full(values.shape, 0.16)
    assert np.allclose(moments(values, first, second, Bilateral()), 0.5, atol=1e-5)


def test_values_that_differ_keep_their_own_moments_apart():
    """Two halves of unlike value: what is in one does not reach the other; and with a share of
    nothing every entry of its own value is alone."""
    values = np.zeros((16, 16, 1))
    values[:, 8:] = 1
    first = np.where(values > 0, 1.0, -1.0)
    ones = np.ones(values.shape)
    assert np.allclose(moments(values, first, ones, Bilateral(0.02)), first, atol=1e-5)
    values = np.random.default_rng(3).random((16, 16, 1))
    first = np.random.default_rng(4).normal(size=values.shape)
    found = moments(values, first, ones, Bilateral(), share=1e-7)
    assert np.allclose(found, first, atol=1e-4)
