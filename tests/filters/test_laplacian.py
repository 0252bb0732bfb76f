"""Steps at all resolutions at once."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from isas_cli.filters import Laplacian, Layout, Step
from isas_cli.filters.axes import Table, applied, interpolation
from isas_cli.filters.laplacian import pyramid
from isas_cli.unknowns.parameters import own

AXES = ((0, False), (1, True))


def moved(gradients, shape, axes=AXES, seen=None, coarsest=2) -> np.ndarray:
    """What coarser levels add to the last of the steps along ``gradients``, at a rate of 1."""
    told = None if seen is None else own(mi.Float, seen.astype(np.float32).ravel())
    on = Laplacian(1.0, coarsest).on(Layout(shape, axes, told), (0.9, 0.999), True)
    zero = dr.zeros(mi.Float, int(np.prod(shape)))
    for t, gradient in enumerate(gradients, 1):
        entries = mi.Float(gradient.ravel().astype(np.float32))
        corrected = np.sqrt(1 - 0.999**t) / (1 - 0.9**t)
        step = Step(zero, zero, entries, zero, zero, dr.opaque(mi.Float, corrected), 1.0)
        found = on.moved(step)
        dr.eval(on.memory)
    return np.array(found).reshape(shape)


@pytest.mark.parametrize("wraps", (True, False))
@pytest.mark.parametrize("fine, coarse", [(16, 8), (15, 8), (5, 3), (2, 1)])
def test_the_way_up_keeps_constants_and_the_way_back_is_its_transpose(fine, coarse, wraps):
    up = interpolation(fine, coarse, wraps)
    assert np.allclose(up.sum(axis=1), 1) and (up >= 0).all()
    rng = np.random.default_rng(1)
    x, y = rng.normal(size=(3, coarse, 2)), rng.normal(size=(3, fine, 2))
    entries = [mi.Float(a.ravel().astype(np.float32)) for a in (x, y)]
    above = np.array(applied(entries[0], x.shape, 1, Table.of(up))).reshape(y.shape)
    below = np.array(applied(entries[1], y.shape, 1, Table.of(up.T))).reshape(x.shape)
    assert np.allclose(above, np.einsum("fc,acb->afb", up, x), atol=1e-5)
    assert np.vdot(above, y) == pytest.approx(np.vdot(x, below), rel=1e-4)


def test_a_table_of_many_entries_is_a_loop_of_the_same_sums():
    rng = np.random.default_rng(2)
    matrix, x = rng.normal(size=(7, 20)), rng.normal(size=(3, 20, 2))
    found = applied(mi.Float(x.ravel().astype(np.float32)), x.shape, 1, Table.of(matrix))
    assert np.allclose(
        np.array(found).reshape(3, 7, 2), np.einsum("fc,acb->afb", matrix, x), atol=1e-4
    )


def test_levels_halve_down_to_the_coarsest():
    layout = Layout((17, 32, 3), AXES)
    assert pyramid(layout, 4) == [(17, 32, 3), (9, 16, 3), (5, 8, 3)]
    assert pyramid(Layout((3, 3, 1), AXES), 4) == [(3, 3, 1)]
    assert pyramid(Layout((1, 2, 1), AXES), 1) == [(1, 2, 1), (1, 1, 1)]


def test_the_steps_are_adam_s_on_the_pyramid():
    """In NumPy, with Kingma and Ba's formulas for each level."""
    shape, rng = (8, 12, 1), np.random.default_rng(3)
    ups = [
        [interpolation(a, b, wraps) for a, b, wraps in ((n, n // 2, False), (m, m // 2, True))]
        for n, m in ((8, 12), (4, 6))
    ]
    gradients = [rng.normal(size=shape) for _ in range(3)]
    state = [np.zeros((2, 4, 6)), np.zeros((2, 2, 3))]
    for t, gradient in enumerate(gradients, 1):
        rest, wanted = gradient[..., 0], np.zeros((8, 12))
        for level, (rows, columns) in enumerate(ups):
            rest = rows.T @ rest @ columns
            m, v = state[level]
            m[:], v[:] = 0.9 * m + 0.1 * rest, 0.999 * v + 0.001 * rest**2
            step = m / (1 - 0.9**t) / np.sqrt(v / (1 - 0.999**t))
            for rows, columns in reversed(ups[: level + 1]):
                step = rows @ step @ columns.T
            wanted -= step
    assert np.allclose(moved(gradients, shape)[..., 0], wanted, atol=1e-4)


def test_it_leads_downhill_and_constants_stay_constants():
    rng = np.random.default_rng(4)
    gradient = rng.normal(size=(16, 16, 3))
    assert np.vdot(moved([gradient], gradient.shape), gradient) < 0
    level = np.full((16, 16, 3), 0.2)
    found = moved([level], level.shape, coarsest=4)
    assert np.allclose(found, -2, atol=1e-4)  # one from each of two coarser levels


def test_what_is_not_seen_tells_coarser_levels_nothing():
    rng = np.random.default_rng(5)
    gradient, seen = rng.normal(size=(16, 16, 3)), np.ones((16, 16, 3), bool)
    seen[:, 5:9] = False
    loud = np.where(seen, gradient, 1e5 * gradient)
    found = [moved([g], g.shape, seen=seen) for g in (gradient, loud)]
    assert np.array_equal(*found)
    assert not np.allclose(found[0], moved([gradient], gradient.shape))


def test_each_level_takes_its_share_of_the_rate():
    shape, zero = (8, 8, 1), dr.zeros(mi.Float, 64)
    found = []
    for rate in (1.0, 0.25):
        on = Laplacian(rate).on(Layout(shape, AXES), (0.9, 0.999), True)
        step = Step(zero + 0.5, zero + 0.4, zero + 1, zero, zero, dr.opaque(mi.Float, 0.03), 1.0)
        found.append(np.array(on.moved(step)) - 0.5)
    assert np.all(found[0] < -0.1) and np.allclose(found[1], 0.25 * found[0], atol=1e-6)


def test_a_map_of_few_texels_has_no_coarser_level_and_takes_the_whole_step():
    on = Laplacian().on(Layout((4, 4, 3), AXES), (0.9, 0.999), True)
    assert not on.memory
    zero = dr.zeros(mi.Float, 48)
    step = Step(zero, zero - 1, *[zero] * 3, dr.opaque(mi.Float, 0.1), 1.0)
    assert np.allclose(np.array(on.moved(step)), -1)
