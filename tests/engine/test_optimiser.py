"""Adam's step: finite, scaled, inside its ranges, at the rate that was asked for."""

from types import SimpleNamespace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scenes_for_tests import ROUGHNESS, TEXTURE, problem

from isas_cli.config.schema import BlurConfig, OptimizerConfig
from isas_cli.engine.optimiser import Stepper
from isas_cli.filters import Laplacian
from isas_cli.runtime.budget import Budget
from isas_cli.runtime.errors import InputError
from isas_cli.runtime.schedule import factor
from isas_cli.unknowns.parameters import as_numpy, flat, unflat


def settings(**changes) -> OptimizerConfig:
    return OptimizerConfig(**{"schedule": "constant", **changes})


def gradients(p, rng, size: float = 1.0) -> dict:
    return {
        key: unflat(value, mi.Float(size * rng.normal(size=dr.width(flat(value)))))
        for key, value in p.unknowns.starts().items()
    }


def run(p, rng, size: float, steps: int = 20, calibrated: bool = True) -> dict:
    stepper = Stepper(p.unknowns, settings())
    batches = [gradients(p, rng, size) for _ in range(steps)]
    if calibrated:
        stepper.calibrate(batches[:3])
    for batch in batches:
        stepper.step(batch, 0.0)
    return {k: as_numpy(v) for k, v in stepper.values.items()}


@pytest.mark.parametrize("size", [1e-6, 1e-12])
def test_scaling_the_loss_changes_nothing(size):
    """The same gradients times 1e-6 (and 1e-12: a mean over 64 M pixels seen by few) give the same
    trajectory. Without the scale, smaller ones do not: Adam's ε = 1e-8 takes over."""
    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.5})
    ours = run(p, np.random.default_rng(1), 1.0)
    small = run(p, np.random.default_rng(1), size)
    raw = run(p, np.random.default_rng(1), size * 1e-3, calibrated=False)
    for key in ours:
        assert np.allclose(ours[key], small[key], atol=1e-6), key
        assert not np.allclose(ours[key], raw[key], atol=1e-3), key


def test_what_the_rehearsal_did_not_reach_is_scaled_by_its_first_gradient():
    """An object that comes into view later: its steps are as long as any, however small its
    gradients are, and after a checkpoint too."""
    p, ends = problem({TEXTURE: 0.5, ROUGHNESS: 0.5}), []
    for size in (1.0, 1e-9):
        rng = np.random.default_rng(1)
        stepper, again = (Stepper(p.unknowns, settings()) for _ in range(2))
        nothing = gradients(p, rng, 0.0)
        stepper.calibrate([nothing])
        stepper.step(nothing, 0.0)
        assert set(stepper.scale.values()) == {1.0}
        again.restore(*stepper.export())
        batches = [gradients(p, rng, size) for _ in range(5)]
        for each in (stepper, again):
            for batch in batches:
                each.step(batch, 0.0)
        assert stepper.scales == again.scales and min(stepper.scale.values()) > 0.1 / size
        first, second = ({k: as_numpy(v) for k, v in e.values.items()} for e in (stepper, again))
        assert all(np.array_equal(first[key], second[key]) for key in first)
        ends.append(first)
    for key in ends[0]:
        assert np.allclose(ends[0][key], ends[1][key], atol=1e-6), key


def test_what_no_view_sees_is_not_asked_for_its_first_gradient(monkeypatch):
    """Each step would wait for it."""
    p, asked = problem({TEXTURE: 0.5, ROUGHNESS: 0.5}), []
    p.unknowns[TEXTURE].unseen = True
    stepper = Stepper(p.unknowns, settings())
    nothing = gradients(p, np.random.default_rng(1), 0.0)
    stepper.calibrate([nothing])
    monkeypatch.setattr(Stepper, "_scale", lambda self, key, gradients: asked.append(key))
    stepper.step(nothing, 0.0)
    assert asked == [ROUGHNESS]


def test_moments_of_small_gradients_keep_their_squares():
    p, found = problem({TEXTURE: 0.5, ROUGHNESS: 0.5}), []
    for size in (1.0, 1e-24):
        rng = np.random.default_rng(1)
        stepper = Stepper(p.unknowns, settings())
        batches = [gradients(p, rng, size) for _ in range(3)]
        stepper.calibrate(batches)
        for batch in batches:
            stepper.step(batch, 0.0)
        found.append(stepper.moments(0.0))
    assert found[1].unit / found[0].unit == pytest.approx(1e-24, rel=1e-5, abs=0)
    for name in ("first", "second", "noise"):
        for key in (TEXTURE, ROUGHNESS):
            one, other = (np.array(getattr(each, name)[key]) for each in found)
            assert np.all(one != 0) and np.allclose(one, other, rtol=1e-3, atol=1e-6)


def test_an_unknown_rests_until_its_stage_and_then_begins_as_if_nothing_had_been():
    """Resting costs no bias correction: the first steps are as long as they are at the start."""
    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.5})
    p.unknowns[TEXTURE].during = (0.5, 1.0)
    p.unknowns[ROUGHNESS].during = (0.0, 0.5)
    rng = np.random.default_rng(5)
    batches = [gradients(p, rng) for _ in range(3)]
    stepper, fresh = Stepper(p.unknowns, settings()), Stepper(p.unknowns, settings())
    for _ in range(40):
        stepper.step(batches[0], 0.2)
    assert np.all(as_numpy(stepper.values[TEXTURE]) == 0.5) and stepper.taken == 40
    moments = stepper.moments(0.2)
    assert moments.rate[TEXTURE] == 0 < moments.rate[ROUGHNESS]
    assert np.all(np.isfinite(moments.second[TEXTURE]))
    number = as_numpy(stepper.values[ROUGHNESS])
    assert number != 0.5
    for batch in batches:
        stepper.step(batch, 0.7)
        fresh.step(batch, 0.7)
    assert np.array_equal(as_numpy(stepper.values[TEXTURE]), as_numpy(fresh.values[TEXTURE]))
    assert not np.all(as_numpy(fresh.values[TEXTURE]) == 0.5)
    assert np.array_equal(as_numpy(stepper.values[ROUGHNESS]), number)


def test_rates_fall_as_each_unknown_says():
    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.5})
    p.unknowns[TEXTURE].schedule = "constant"
    p.unknowns[ROUGHNESS].schedule, p.unknowns[ROUGHNESS].final = "exponential", 0.25
    stepper = Stepper(p.unknowns, settings())
    batch = gradients(p, np.random.default_rng(5))
    for spent in (0.0, 0.5, 1.0):
        stepper.step(batch, spent)
        rate = stepper.moments(spent).rate
        assert rate[ROUGHNESS] == pytest.approx(rate[TEXTURE] * 0.25**spent)


def test_filters_are_told_what_the_rate_has_fallen_to(monkeypatch):
    p, told = problem({TEXTURE: 0.5}, size=16), []
    stepper = Stepper(p.unknowns, settings(schedule="exponential", final=0.25), Laplacian())
    made = stepper.filtered[TEXTURE]
    gradient, moved = made.gradient, made.moved
    shared = lambda entries, share: told.append(share) or gradient(entries, share)
    monkeypatch.setattr(made, "gradient", shared)
    monkeypatch.setattr(made, "moved", lambda step: told.append(step.share) or moved(step))
    batch = gradients(p, np.random.default_rng(5))
    for spent in (0.0, 0.5, 1.0):
        stepper.step(batch, spent)
    assert told == pytest.approx([1, 1, 0.5, 0.5, 0.25, 0.25])


def test_first_steps_follow_the_published_update():
    """Kingma & Ba, with bias correction, in NumPy."""
    p, rng = problem({TEXTURE: 0.5}), np.random.default_rng(2)
    stepper = Stepper(p.unknowns, settings(lr=0.01, mask_updates=False))
    x = as_numpy(stepper.values[TEXTURE]).reshape(-1).astype(np.float64)
    m, v = np.zeros_like(x), np.zeros_like(x)
    for t in range(1, 6):
        g = rng.normal(size=x.size)
        stepper.step({TEXTURE: unflat(stepper.values[TEXTURE], mi.Float(g))}, 0.0)
        m, v = 0.9 * m + 0.1 * g, 0.999 * v + 0.001 * g * g
        x = x - 0.01 * (m / (1 - 0.9**t)) / (np.sqrt(v / (1 - 0.999**t)) + 1e-8)
    assert np.allclose(as_numpy(stepper.values[TEXTURE]).reshape(-1), x, atol=1e-5)


def test_values_stay_inside_their_range():
    p = problem({ROUGHNESS: 0.5})
    for sign, end in ((1.0, 0.03), (-1.0, 1.0)):
        stepper = Stepper(p.unknowns, settings(lr=0.3))
        for _ in range(4):
            stepper.step({ROUGHNESS: mi.Float(sign)}, 0.0)
        assert as_numpy(stepper.values[ROUGHNESS])[0] == pytest.approx(end)


def test_each_unknown_has_its_own_rate():
    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.5})
    p.unknowns.items[0].lr, p.unknowns.items[1].lr = 0.1, None
    stepper = Stepper(p.unknowns, settings(lr=0.01))
    stepper.step(
        {k: unflat(v, mi.Float(np.ones(dr.width(flat(v))))) for k, v in stepper.values.items()}, 0.0
    )
    moved = {k: 0.5 - as_numpy(v).mean() for k, v in stepper.values.items()}
    assert moved[TEXTURE] == pytest.approx(0.1, rel=1e-3)
    assert moved[ROUGHNESS] == pytest.approx(0.01, rel=1e-3)


def test_untouched_entries_keep_still():
    p = problem({TEXTURE: 0.5})
    stepper = Stepper(p.unknowns, settings())
    g = np.zeros(48, np.float32)
    g[7] = 1
    stepper.step({TEXTURE: unflat(stepper.values[TEXTURE], mi.Float(np.ones(48, np.float32)))}, 0.0)
    before = as_numpy(stepper.values[TEXTURE]).reshape(-1)
    stepper.step({TEXTURE: unflat(stepper.values[TEXTURE], mi.Float(g))}, 0.0)
    after = as_numpy(stepper.values[TEXTURE]).reshape(-1)
    assert np.flatnonzero(before != after).tolist() == [7]


def test_what_has_not_moved_yet_is_not_called_without_a_gradient():
    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.5})
    p.unknowns[ROUGHNESS].during = (0.5, 1.0)
    stepper = Stepper(p.unknowns, settings())
    nothing = {k: unflat(v, mi.Float(0) * flat(v)) for k, v in stepper.values.items()}
    stepper.step(nothing, 0.0)
    assert stepper.untouched == [TEXTURE]
    stepper.step(nothing, 0.7)
    assert stepper.untouched == [TEXTURE, ROUGHNESS]


def test_gradients_that_are_not_finite_are_counted_for_each_unknown():
    """And none of these is said to have had none."""
    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.5})
    stepper = Stepper(p.unknowns, settings())
    some = gradients(p, np.random.default_rng(1)) | {ROUGHNESS: mi.Float(np.nan)}
    for _ in range(2):
        stepper.step(some, 0.0)
    assert stepper.lost == {TEXTURE: 0, ROUGHNESS: 2} and stepper.untouched == []
    arrays, state = stepper.export()
    again = Stepper(p.unknowns, settings())
    again.restore(arrays, state)
    assert again.lost == stepper.lost


def test_a_size_goes_with_what_its_lens_keeps_of_a_step_and_in_its_own_stages():
    def follow(before, after, size):
        return type(size)(size.array + dr.sum((after - before).array), size.shape)

    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.5})
    p.unknowns[ROUGHNESS].low = 0.5  # it begins at an end of its range
    p.unknowns[TEXTURE].during = (0.0, 0.5)
    moves = SimpleNamespace(lens=ROUGHNESS, size=TEXTURE, follow=follow)
    moves.directed = lambda found, values: found | {ROUGHNESS: found[ROUGHNESS] * 2}
    p.unknowns.together = [moves]
    zero = unflat(p.unknowns.starts()[TEXTURE], mi.Float(0) * np.ones(48))

    def step(sign: float, spent: float) -> tuple[float, float]:
        stepper = Stepper(p.unknowns, settings(lr=0.1))
        stepper.step({TEXTURE: zero, ROUGHNESS: mi.Float(sign)}, spent)
        return tuple(float(as_numpy(v).mean()) - 0.5 for v in stepper.values.values())

    assert step(1.0, 0.0) == (0, 0)
    assert step(-1.0, 0.0) == pytest.approx((0.1, 0.1), rel=1e-3)
    assert step(-1.0, 0.7) == pytest.approx((0, 0.1), rel=1e-3)


@pytest.mark.parametrize(
    "schedule, at_start, half_way, at_end",
    [
        ("constant", 1, 1, 1),
        ("cosine", 1, 0.505, 0.01),
        ("exponential", 1, 0.1, 0.01),
    ],
)
def test_schedules_run_over_the_budget(schedule, at_start, half_way, at_end):
    rate = factor(schedule, 0.01, 5.0)
    rates = [rate(t, 10) for t in np.linspace(0, 1, 11)]
    assert rates[::5] == pytest.approx([at_start, half_way, at_end])
    assert np.all(np.diff(rates) <= 0)


def test_a_rate_that_falls_by_steps_knows_no_budget():
    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.5})
    stepper = Stepper(p.unknowns, settings(schedule=None, half=4.0))
    batch = gradients(p, np.random.default_rng(5))
    for _ in range(4):
        stepper.step(batch, 0.7)
    halved = {TEXTURE: pytest.approx(0.01), ROUGHNESS: pytest.approx(0.01)}
    assert stepper.moments(0.9).rate == halved and stepper.rate(0.9) == halved[TEXTURE]
    again = Stepper(p.unknowns, settings(schedule=None, half=4.0))
    again.restore(*stepper.export())
    assert again.moments(0.3).rate == halved
    assert not stepper.paced and not Stepper(p.unknowns, settings()).paced
    assert Stepper(p.unknowns, settings(schedule="cosine")).paced


@pytest.mark.parametrize(
    ("given", "own", "at_half"),
    [
        ({}, {}, 0.5),  # by steps
        ({}, {"lr": 0.02}, 0.5),
        ({}, {"during": (0.1, 1.0)}, 0.02**0.5),  # over the budget
        ({}, {"doubled": (0.2,)}, 0.02**0.5),
        ({}, {"blur": BlurConfig(start=0.1, end=0.01)}, 0.02**0.5),
        ({}, {"final": 0.04}, 0.2),
        ({"final": 0.04}, {}, 0.2),
        ({"final": 0.04}, {"final": 0.01}, 0.1),
        ({"final": 0.04}, {"schedule": "inverse"}, 0.5),
        ({"schedule": "inverse", "half": 80.0}, {"during": (0.1, 1.0)}, 2 / 3),
        ({"schedule": "cosine"}, {}, 0.51),
    ],
)
def test_what_falls_how_where_nothing_is_said(given, own, at_half):
    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.5})
    for name, value in own.items():
        setattr(p.unknowns[ROUGHNESS], name, value)
    stepper = Stepper(p.unknowns, OptimizerConfig(**given))
    stepper.steps = 40
    assert stepper.moments(0.5).rate[ROUGHNESS] == pytest.approx(0.02 * at_half)


def test_bad_settings_are_refused():
    p = problem({TEXTURE: 0.5})
    near = {"beta_1": 0.99999999}, {"beta_2": 0.99999999}  # of which float32 makes 1
    ends = {"lr": 0.0}, {"beta_1": 1.0}, {"schedule": "cosin"}, {"final": 0.0}, {"half": 0.0}
    for bad in (*ends, *near):
        with pytest.raises(InputError, match=f"optimizer.{next(iter(bad))}"):
            Stepper(p.unknowns, settings(**bad))


def test_budget_ends_at_the_first_limit():
    budget = Budget(seconds=10, iterations=100, paths=None)
    assert budget.spent(1, 50, 10**9) == 0.5
    assert budget.spent(9, 50, 0) == 0.9
    assert budget.spent(20, 0, 0) == 1.0
    of_all = [Budget(10, 100, 1e6).spent(seconds, 50, 7e5) for seconds in range(12)]
    assert of_all == [0.7] * 8 + [0.8, 0.9, 1, 1]
    assert Budget().seconds == 60
    assert Budget(iterations=3).seconds is None
    for bad in ({"seconds": 0}, {"iterations": -1}, {"paths": float("nan")}):
        with pytest.raises(InputError, match="budget"):
            Budget(**bad)


def test_moments_tell_what_noise_the_mean_keeps():
    """Gradients of noise alone, seen in 5 % of 3,000 steps (more than Adam's second moment
    remembers): over many entries the squared mean is the variance that ``noise`` says, and an
    entry's second moment is Adam's own."""
    p, rng = problem({TEXTURE: 0.5}, size=16), np.random.default_rng(4)
    stepper = Stepper(p.unknowns, settings(lr=1e-6))
    start = p.unknowns.starts()[TEXTURE]
    count, steps, share = dr.width(flat(start)), 3000, 0.05
    for _ in range(steps):
        g = rng.normal(size=count) * (rng.random(count) < share)
        stepper.step({TEXTURE: unflat(start, mi.Float(g))}, 0.0)
    moments = stepper.moments(0.0)
    first, noise = (np.array(m[TEXTURE], np.float64) for m in (moments.first, moments.noise))
    assert abs(np.mean(first**2) / np.mean(noise) - 1) < 0.3
    _, _, v, _ = stepper.adam.state[TEXTURE][3]
    assert np.allclose(np.array(moments.second[TEXTURE]), np.array(v) / (1 - 0.999**steps))
    assert moments.rate[TEXTURE] == pytest.approx(1e-6)
