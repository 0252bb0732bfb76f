"""Priors: their value and gradient against NumPy, and what a run makes of them."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from gradient_estimates import Gradients
from scenes_for_tests import ROUGHNESS, TEXTURE, problem

from isas_cli import losses
from isas_cli.losses import priors
from isas_cli.losses.priors import Nothing, OnNeighbours, Smoothness, TotalVariation
from isas_cli.runtime.errors import InputError
from isas_cli.unknowns.parameters import as_numpy, flat

PLANE, MAP, BOX = (
    ((0, False), (1, False)),
    ((0, False), (1, True)),
    ((0, False), (1, False), (2, False)),
)
SHAPES = {"texture": ((5, 4, 3), PLANE), "map": ((4, 6, 3), MAP), "grid": ((3, 4, 2, 1), BOX)}
PRIORS = {"smoothness": Smoothness(0.7), "total_variation": TotalVariation(0.7, epsilon=0.05)}


def reference(prior, x: np.ndarray, axes) -> float:
    """weight R by loops over entries, in double precision."""
    total = 0.0
    for index in np.ndindex(x.shape):
        squares = 0.0
        for axis, wraps in axes:
            after = list(index)
            after[axis] += 1
            if after[axis] == x.shape[axis]:
                if not wraps:
                    continue
                after[axis] = 0
            squares += (x[tuple(after)] - x[index]) ** 2
        if isinstance(prior, TotalVariation):
            total += np.sqrt(squares + prior.epsilon**2) - prior.epsilon
        else:
            total += squares
    return prior.weight * total / x.size


def on(prior, x: np.ndarray, axes, whole: tuple | None = None) -> tuple[OnNeighbours, dict]:
    made = OnNeighbours(prior, {"x": (whole or x.shape, axes)}, {"x": 1.0})
    return made, {"x": mi.TensorXf(np.ascontiguousarray(x, np.float32))}


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("name", PRIORS)
def test_value_and_gradient_are_those_of_the_formula(name, shape, rng):
    prior, (size, axes) = PRIORS[name], SHAPES[shape]
    x = rng.uniform(0, 1, size)
    made, values = on(prior, x, axes)
    assert made.value(values) == pytest.approx(reference(prior, x, axes), rel=1e-5)
    zero = {"x": values["x"] * 0}
    found = np.array(made.add(values, zero)["x"])
    expected, h = np.zeros(size), 1e-5
    for index in np.ndindex(size):
        step = np.zeros(size)
        step[index] = h
        expected[index] = (reference(prior, x + step, axes) - reference(prior, x - step, axes)) / (
            2 * h
        )
    assert np.allclose(found, expected, rtol=1e-3, atol=1e-6 * np.abs(expected).max() + 1e-7)


def test_a_gradient_without_the_step_before_is_noticed(rng, monkeypatch):
    """The power of the test above."""

    def careless(self, x, following, preceding, closer, scale):
        slopes = self.prior.slopes(priors._steps(x, following, closer))
        return -sum(slopes, mi.Float(0)) * scale

    monkeypatch.setattr(OnNeighbours, "_traced_slope", careless)
    with pytest.raises(AssertionError):
        test_value_and_gradient_are_those_of_the_formula("smoothness", "map", rng)


def test_of_a_coarser_grid_the_weight_means_the_same(rng):
    """A ramp of eight points, or as four that are twice as far apart: the same slope everywhere,
    but for the open ends."""
    ramp = np.linspace(0, 1, 8).reshape(8, 1, 1, 1) * np.ones((1, 4, 4, 1))
    coarse = ramp.reshape(4, 2, 2, 2, 2, 2, 1).mean(axis=(1, 3, 5))
    for prior in PRIORS.values():
        (fine, values), (less, fewer) = on(prior, ramp, BOX), on(prior, coarse, BOX, ramp.shape)
        inside = fine.value(values) / (7 / 8), less.value(fewer) / (3 / 4)
        assert inside[0] == pytest.approx(inside[1], rel=1e-4) and inside[0] > 0
        x, h = rng.uniform(0, 1, coarse.shape), 1e-3
        made, at = on(prior, x, BOX, ramp.shape)
        direction = rng.normal(size=x.shape)
        along = np.array(made.add(at, {"x": at["x"] * 0})["x"]).ravel() @ direction.ravel()
        ends = [on(prior, x + s * h * direction, BOX, ramp.shape) for s in (1, -1)]
        quotient = (ends[0][0].value(ends[0][1]) - ends[1][0].value(ends[1][1])) / (2 * h)
        assert along == pytest.approx(quotient, rel=2e-2)


def test_a_constant_has_no_prior():
    for prior in PRIORS.values():
        made, values = on(prior, np.full((4, 4, 3), 0.3), MAP)
        assert made.value(values) == 0
        assert not np.array(made.add(values, {"x": values["x"] * 0})["x"]).any()


def test_a_frozen_gradient_sees_new_values(rng):
    x = rng.uniform(0, 1, (4, 4, 3))
    made, values = on(Smoothness(1.0), x, PLANE)
    for scale in (1.0, 2.0, 3.0, 4.0, 5.0):
        scaled = {"x": values["x"] * dr.opaque(mi.Float, scale)}
        found = np.array(made.add(scaled, {"x": values["x"] * 0})["x"])
        if scale == 1:
            first = found
        assert np.allclose(found, scale * first, rtol=1e-5)


def test_estimates_are_shifted_by_the_prior_s_gradient_and_nothing_else(seed):
    """Of the gradient of two paths: the same random numbers with and without."""
    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.5})
    made = Gradients(p, losses.L2(), 64)
    prior = Smoothness(0.5).on(p.unknowns)
    values = p.unknowns.truths()
    made.values = values
    (row,) = made.uniform(1, seed)
    entries = made.entries()
    plain = {k: mi.Float(row[entries[k]].astype(np.float32)) for k in p.unknowns.keys}
    gradients = {
        k: type(values[k])(g, values[k].shape) if k == TEXTURE else g for k, g in plain.items()
    }
    with_prior = prior.add(values, gradients)
    assert with_prior[ROUGHNESS] is gradients[ROUGHNESS]
    added = np.array(flat(with_prior[TEXTURE]), float) - np.array(plain[TEXTURE], float)
    alone = np.array(flat(prior.add(values, {**gradients, TEXTURE: values[TEXTURE] * 0})[TEXTURE]))
    assert np.abs(alone).max() > 0
    assert np.allclose(added, alone, atol=1e-6 * np.abs(row).max() + 1e-7)


def test_a_rough_start_becomes_smooth(rng):
    """Descending the prior alone: its value falls to nearly nothing, and the mean stays."""
    x = rng.uniform(0, 1, (8, 8, 3))
    made, values = on(Smoothness(1.0), x, PLANE)
    before = made.value(values)
    for _ in range(300):
        slope = made.add(values, {"x": values["x"] * 0})["x"]
        values = {"x": values["x"] - 20 * slope}
        dr.eval(values)
    assert made.value(values) < 1e-3 * before
    assert as_numpy(values["x"]).mean() == pytest.approx(x.mean(), abs=1e-3)


def test_what_makes_no_sense_is_refused_in_one_line():
    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.5})
    assert Nothing().on(p.unknowns) is None
    with pytest.raises(InputError, match="prior.weight=-1: must be a finite number"):
        Smoothness(-1)
    with pytest.raises(InputError, match="prior.epsilon=0"):
        TotalVariation(1, epsilon=0)
    with pytest.raises(InputError, match="prior.keys: 'wall.bsdf.roughness.value' is no unknown"):
        Smoothness(1, keys=[ROUGHNESS]).on(p.unknowns)
    with pytest.raises(InputError, match="no unknown has neighbouring entries"):
        Smoothness(1).on(problem({ROUGHNESS: 0.5}).unknowns)
