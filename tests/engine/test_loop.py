"""The loop: what is billed, what is recorded, and that it recovers what it should."""

import time

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from crosses import some
from scenes_for_tests import ROUGHNESS, TEXTURE, problem

from isas_cli import losses
from isas_cli.config.schema import OptimizerConfig, UnknownConfig
from isas_cli.engine.evaluate import Evaluator
from isas_cli.engine.loop import Hooks, Loop
from isas_cli.engine.optimiser import Stepper
from isas_cli.estimators.two_path import TwoPath
from isas_cli.runtime.budget import Budget
from isas_cli.runtime.errors import NumericalError
from isas_cli.samplers.balanced import Balanced
from isas_cli.samplers.gradient import Gradient
from isas_cli.samplers.multiresolution import Multiresolution
from isas_cli.samplers.ours import Ours
from isas_cli.samplers.progress import Progress
from isas_cli.samplers.relevant import Relevant
from isas_cli.samplers.sampler import OnImages, Stage1Settings
from isas_cli.samplers.uniform import Uniform
from isas_cli.unknowns.parameters import as_numpy, unflat

STAGE1 = Stage1Settings(resolution=8, spp=2, denoise="none")
SAMPLERS = {
    "uniform": Uniform(),
    "relevant": Relevant(stage1=STAGE1),
    "gradient": Gradient(stage1=STAGE1),
    "ours": Ours(stage1=STAGE1),
    "balanced": Balanced(stage1=STAGE1),
}


def assembled(p, loss, stepper, evaluator, budget, sampler=None, batch=256, seed=1, count=5):
    sampler = sampler or Uniform()
    if not isinstance(sampler, OnImages):
        sampler = sampler.on(p, loss, batch)
    estimator = TwoPath(p, loss, batch)
    result = Loop(p, sampler, stepper, evaluator, budget, estimator, seed, count)
    result.rehearse()
    return result


def loop(
    p, sampler=None, budget=None, seed=1, batch=256, lr=0.05, evaluations=5, **changes
) -> Loop:
    loss = losses.L2()
    stepper = Stepper(p.unknowns, OptimizerConfig(lr=lr, **changes))
    evaluator = Evaluator(p, loss, 10_000, 16, seed)
    budget = budget or Budget(iterations=20)
    return assembled(p, loss, stepper, evaluator, budget, sampler, batch, seed, evaluations)


def run(loop_: Loop, stop=lambda: False) -> tuple[str, list[dict]]:
    rows: list[dict] = []
    status = loop_.run(Hooks(evaluated=rows.append, stop=stop))
    loop_.problem.unknowns.write(loop_.stepper.values)  # detach
    return status, rows


@pytest.mark.parametrize("name", some([*SAMPLERS], ("uniform", "ours")))
def test_every_sampler_recovers_texture_and_roughness(name):
    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.6}, constant_target=None, resolution=(24, 16))
    # A rate at which the noise of first steps does not drive the roughness to its bound.
    status, rows = run(loop(p, SAMPLERS[name], Budget(iterations=150), batch=1024, lr=0.03))
    assert status == "done"
    first, last = rows[0], rows[-1]
    assert last["image_rmse"] < 0.5 * first["image_rmse"]
    assert last[f"parameter_rmse/{TEXTURE}"] < 0.5 * first[f"parameter_rmse/{TEXTURE}"]
    assert last[f"parameter_rmse/{ROUGHNESS}"] < 0.5 * first[f"parameter_rmse/{ROUGHNESS}"]
    assert last["nonfinite"] == 0


def test_rows_say_what_was_spent():
    p = problem({TEXTURE: 0.5}, constant_target=None)
    ours = Ours(refresh=4, stage1=STAGE1)
    l = loop(p, ours, Budget(iterations=10), evaluations=3)
    status, rows = run(l)
    assert [r["iteration"] for r in rows][0] == 0 and rows[-1]["iteration"] == 10
    assert rows[0]["seconds"] == 0 and rows[0]["paths"] == 0, "the rehearsal is not billed"
    looks = 3  # before iterations 0, 4 and 8
    assert rows[-1]["paths"] == 10 * 2 * 256 + looks * l.sampler.paths_per_look
    assert l.sampler.paths_per_look == l.sampler.cells.count * 2 * 2
    assert all(a["seconds"] < b["seconds"] for a, b in zip(rows, rows[1:]))
    assert rows[-1]["seconds"] == pytest.approx(sum(l.clock.billed_seconds.values()))
    assert set(l.clock.billed_seconds) == {"stage1", "step"}
    assert l.clock.unbilled_seconds["evaluation"] > 0 and l.clock.unbilled_seconds["rehearsal"] > 0


@pytest.mark.parametrize("times, looked", [(4.5, True), (3.5, False)])
def test_a_first_look_is_left_out_where_it_costs_a_quarter_of_the_budget(times, looked):
    """Paths are counted as they are traced."""
    p = problem({TEXTURE: 0.5})
    progress = Progress(refresh=1000, stage1=STAGE1).on(p, losses.L2(), 256)
    own = progress.paths_before + progress.paths_per_look
    l = loop(p, progress, Budget(paths=times * own))
    look, when = progress.look, []
    progress.look = lambda *given: when.append(given[2]) or look(*given)
    _, rows = run(l)
    assert [i for i in when if i < 1000] == ([0] if looked else [])
    assert rows[-1]["paths"] == rows[-1]["iteration"] * 2 * 256 + looked * own
    assert bool(l.warnings) is not looked
    if not looked:
        assert "more than 25% of the budget" in l.warnings[0]
        assert np.allclose(l.density(), 1)
        again = loop(p, progress, Budget(paths=times * own))
        again.restore(*l.export())
        again.gradient(1)
        p.unknowns.write(again.stepper.values)
        assert np.allclose(again.density(), 1), "from the pixels that it had"
        longer = loop(p, progress, Budget(paths=9 * own))
        longer.restore(*l.export())
        done = longer.position.iteration
        run(longer)
        assert [i for i in when if i < 1000] == [done], "as a run's first look"


def levels(**settings) -> Multiresolution:
    return Multiresolution(base=Progress(**settings), levels=1)


@pytest.mark.parametrize("sampler, looks", [(Progress, [0, 10]), (levels, [0, 10]), (Ours, [0])])
def test_what_begins_to_move_is_looked_at(sampler, looks):
    """By a sampler whose weights are those of what moves."""
    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.6})
    p.unknowns[TEXTURE].during, p.unknowns[ROUGHNESS].during = (0.0, 0.5), (0.5, 1.0)
    own = sampler(refresh=1000, stage1=STAGE1).on(p, losses.L2(), 256)
    look, when = own.look, {}
    own.look = lambda *given: when.update({given[2]: given[3]}) or look(*given)
    run(loop(p, own, Budget(iterations=20)))
    assert [i for i in when if i < 1000] == looks
    if 10 in looks:  # and what rests from then on gets no mass
        assert when[10].rate[TEXTURE] == 0 and when[10].rate[ROUGHNESS] > 0


@pytest.mark.parametrize("during, uniform", [((0.9, 1.0), True), ((0.0, 0.9), False)])
def test_pixels_are_drawn_uniformly_where_what_begins_is_too_late_for_a_look(during, uniform):
    """What comes to rest leaves a density that still fits the others."""
    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.6})
    p.unknowns[ROUGHNESS].during = during
    own = Progress(refresh=1000, stage1=STAGE1).on(p, losses.L2(), 256)
    look, when = own.look, []
    own.look = lambda *given: when.append(given[2]) or look(*given)
    made = loop(p, own, Budget(paths=8 * (own.paths_per_look + own.paths_before)))
    run(made)
    assert [i for i in when if i < 1000] == [0]
    assert np.allclose(made.density(), 1) == uniform


def test_a_first_look_that_takes_long_is_left_out_of_a_short_time(monkeypatch):
    p = problem({TEXTURE: 0.5})
    progress = Progress(stage1=STAGE1).on(p, losses.L2(), 256)
    look, when = progress.look, []
    monkeypatch.setattr(
        progress, "look", lambda *given: when.append(given[2]) or time.sleep(0.1) or look(*given)
    )
    run(loop(p, progress, Budget(seconds=0.3)))
    assert not [i for i in when if i < 1000]


@pytest.mark.parametrize("sampler", [Ours, Progress])
@pytest.mark.parametrize("rest, looked", [(3.5, False), (4.5, True)])
def test_a_later_look_is_left_out_where_it_costs_a_quarter_of_what_is_left(rest, looked, sampler):
    """By its own price, which is less than a first one's where that looks at more."""
    p = problem({TEXTURE: 0.5})
    own = sampler(refresh=10, stage1=STAGE1).on(p, losses.L2(), 256)
    paths = own.paths_before + own.paths_per_look + 10 * 2 * 256 + rest * own.paths_per_look
    l = loop(p, own, Budget(paths=paths))
    look, when = own.look, []
    own.look = lambda *given: when.append(given[2]) or look(*given)
    run(l)
    assert [i for i in when if i < 20] == ([0, 10] if looked else [0])


def test_an_iteration_is_had_again_at_the_share_of_the_schedule_that_it_had():
    """Also where an estimator draws no pixels yet."""
    l = loop(problem({TEXTURE: 0.5}), budget=Budget(iterations=20))
    run(l, stop=lambda: l.position.iteration >= 4)
    estimate, shares = l.estimator.estimate, []
    l.estimator.estimate = lambda *given: shares.append(given[-1]) or estimate(*given)
    l.estimator.undrawn = 0.5
    l.gradient(3)
    l.problem.unknowns.write(l.stepper.values)
    assert shares == [l.scheduled] == [4 / 20]


def test_evaluating_more_often_changes_nothing():
    """Evaluation has streams of its own and touches neither parameters nor moments."""
    ends = []
    for evaluations in (1, 20):
        p = problem({TEXTURE: 0.5}, constant_target=None)
        l = loop(p, budget=Budget(iterations=20), evaluations=evaluations)
        run(l)
        ends.append(as_numpy(l.stepper.values[TEXTURE]))
    assert np.abs(ends[0] - ends[1]).max() < 1e-5


class Learns(TwoPath):
    """Counts its steps."""

    def __init__(self, *given):
        super().__init__(*given)
        self.memory = [mi.Float(0)]

    def estimate(self, *given):
        self.memory = [self.memory[0] + 1]
        return super().estimate(*given)


def test_what_an_estimator_learns_is_each_runs_own():
    p, loss = problem({TEXTURE: 0.5}), losses.L2()
    sampler = Uniform().on(p, loss, 256)
    estimator, evaluator = Learns(p, loss, 256), Evaluator(p, loss, 64, 2, 1)
    loops = []
    for iterations in (3, 5):
        stepper = Stepper(p.unknowns, OptimizerConfig(lr=0.05))
        budget = Budget(iterations=iterations)
        loops.append(Loop(p, sampler, stepper, evaluator, budget, estimator, 1, 2))
        loops[-1].rehearse()
    for each in loops:
        each.begin(Hooks())
    while not all([each.advance(Hooks(), 0.0) for each in loops]):
        pass
    saved = [each.export() for each in loops]
    p.unknowns.write(p.unknowns.starts())
    assert [arrays["met/0"][0] for arrays, _ in saved] == [3, 5]
    loops[0].restore(*saved[1])
    assert loops[0].export()[0]["met/0"][0] == 5


def test_same_seed_same_run_other_seed_other_run():
    ends = []
    for seed in (1, 1, 2):
        p = problem({TEXTURE: 0.5}, constant_target=None)
        l = loop(p, Ours(stage1=STAGE1), seed=seed)
        run(l)
        ends.append(as_numpy(l.stepper.values[TEXTURE]))
    assert np.abs(ends[0] - ends[1]).max() < 1e-5  # threads add in another order
    assert np.abs(ends[0] - ends[2]).max() > 1e-3


def test_stopping_leaves_a_complete_row():
    p = problem({TEXTURE: 0.5}, constant_target=None)
    l = loop(p, budget=Budget(iterations=1000))
    status, rows = run(l, stop=lambda: l.position.iteration >= 7)
    assert status == "interrupted"
    assert rows[-1]["iteration"] == 7


def test_budgets_of_every_kind_end_the_run():
    p = problem({TEXTURE: 0.5}, constant_target=None)
    l = loop(p, budget=Budget(paths=256 * 2 * 6))
    run(l)
    assert l.position.iteration == 6
    l = loop(p, budget=Budget(seconds=0.2))
    run(l)
    assert l.clock.seconds >= 0.2 and l.last["seconds"] == l.clock.seconds


def test_the_learning_rate_falls_from_the_first_step_on(monkeypatch):
    """A first look that takes a fifth of the budget must not cost a fifth of the schedule, nor a
    continued run go back to its beginning."""
    p = problem({TEXTURE: 0.5}, constant_target=None)
    ours = Ours(refresh=0, stage1=STAGE1).on(p, losses.L2(), 16)
    budget = Budget(paths=5 * ours.paths_per_look)
    same = {"budget": budget, "batch": 16}  # some dozen steps

    def recorded(loop_) -> list[float]:
        seen, step = [], loop_.stepper.step
        with monkeypatch.context() as patched:
            patched.setattr(loop_.stepper, "step", lambda g, t: (seen.append(t), step(g, t)))
            run(loop_)
        return seen

    whole = recorded(loop(p, ours, **same))
    assert whole[0] == 0 and 0.5 < whole[-1] < 1
    assert np.allclose(np.diff(whole), whole[1]), "evenly over what the look has left"

    stopped = loop(p, ours, **same)
    run(stopped, stop=lambda: stopped.position.iteration >= 1)
    continued = loop(p, ours, **same)
    continued.restore(*stopped.export())
    assert recorded(continued) == whole[1:]


def test_photographs_have_an_image_error_and_no_parameter_error():
    """Without a truth the error is against the pictures, less the noise of its own measurement."""
    p = problem({ROUGHNESS: 0.4}, constant_target=None, resolution=(48, 32))
    truths = p.unknowns.truths()
    for unknown in p.unknowns:
        unknown.truth = None
    evaluator = Evaluator(p, losses.L2(), 10_000, 2, 1)
    row = evaluator(truths)
    assert set(row) == {"loss", "image_rmse", f"value/{ROUGHNESS}"}
    wrong = evaluator(p.unknowns.values_of({ROUGHNESS: np.array([0.9], np.float32)}))
    assert wrong["image_rmse"] == pytest.approx(np.sqrt(wrong["loss"]), rel=1e-4)
    assert wrong["image_rmse"] > 2 * row["image_rmse"]


def test_parameter_error_leaves_out_what_no_view_sees():
    p = problem({TEXTURE: 0.5}, constant_target=None)
    unknown = p.unknowns.items[0]
    unknown.seen = np.zeros(unknown.start.shape, bool)
    unknown.seen[0, 0] = True
    values = {TEXTURE: unknown.truth.copy()}
    values[TEXTURE][1:] += 0.5
    errors = Evaluator(p, losses.L2(), 100, 2, 1).parameter_errors(p.unknowns.values_of(values))
    assert errors["parameter_rmse"] == 0


class Small(losses.L2):
    """L2 times 1e-6."""

    def derivative(self, image, target):
        return 1e-6 * super().derivative(image, target)


def test_a_loss_times_a_millionth_gives_the_same_run():
    """The whole loop, rehearsal and calibration included."""
    ends = []
    for loss in (losses.L2(), Small()):
        p = problem({TEXTURE: 0.5}, constant_target=None)
        stepper = Stepper(p.unknowns, OptimizerConfig())
        evaluator = Evaluator(p, losses.L2(), 100, 2, 1)
        l = assembled(p, loss, stepper, evaluator, Budget(iterations=20), count=2)
        run(l)
        ends.append(as_numpy(stepper.values[TEXTURE]))
    assert np.abs(ends[0] - 0.5).max() > 0.05
    assert np.abs(ends[0] - ends[1]).max() < 1e-4


class Broken(Stepper):
    """Feeds not-a-numbers from the fifth step on."""

    count = 0

    def step(self, gradients, progress):
        self.count += 1
        if self.count > 12:
            nan = float("nan")  # where the batch touched; the rest stays zero
            gradients = {k: dr.select(g != 0, nan, 0) for k, g in gradients.items()}
        super().step(gradients, progress)


def test_numerical_failure_keeps_the_last_good_values():
    p = problem({TEXTURE: 0.5}, constant_target=None)
    loss = losses.L2()
    stepper = Broken(p.unknowns, OptimizerConfig())
    evaluator = Evaluator(p, loss, 100, 2, 1)
    l = assembled(p, loss, stepper, evaluator, Budget(iterations=50), count=10)
    rows: list[dict] = []
    with pytest.raises(NumericalError, match="not finite"):
        l.run(Hooks(evaluated=rows.append))
    p.unknowns.write(stepper.values)
    assert rows[-1]["nonfinite"] > 0
    assert np.all(np.isfinite(as_numpy(stepper.values[TEXTURE])))
    assert rows[-1]["image_rmse"] < rows[0]["image_rmse"]


def test_gradient_noise_is_the_distance_from_adams_mean():
    """PBDR Eq. (9) over the touched entries, against NumPy's own running mean."""
    p, rng = problem({TEXTURE: 0.5}, constant_target=None), np.random.default_rng(4)
    stepper = Stepper(p.unknowns, OptimizerConfig(mask_updates=False))
    stepper.scales = [{TEXTURE: 1e3}]
    mean, size = 0.0, as_numpy(stepper.values[TEXTURE]).size
    zero = {TEXTURE: unflat(stepper.values[TEXTURE], dr.zeros(mi.Float, size))}
    assert np.isnan(stepper.noise(zero)), "before the first step there is no mean"
    for t in range(1, 5):
        g = rng.normal(size=size).astype(np.float32)
        gradients = {TEXTURE: unflat(stepper.values[TEXTURE], mi.Float(g))}
        stepper.step(gradients, 0.0)
        mean = 0.9 * mean + 0.1 * g.astype(np.float64)
        expected = np.mean((mean / (1 - 0.9**t) - g) ** 2)
        if t == 1:
            assert np.isnan(stepper.noise(gradients)), "the mean is the gradient itself"
            continue
        assert stepper.noise(gradients) == pytest.approx(expected, rel=1e-4, abs=1e-9)
    stepper = Stepper(p.unknowns, OptimizerConfig(mask_updates=True))
    for step in range(30):  # entries touched all the time, late, and now and then
        often = (np.arange(size) % 3 == 0) | ((np.arange(size) % 3 == 1) & (step > 20))
        often |= (np.arange(size) % 3 == 2) & (step % 10 == 9)
        entries = mi.Float(np.where(often, 2e-3, 0).astype(np.float32))
        gradients = {TEXTURE: unflat(stepper.values[TEXTURE], entries)}
        stepper.step(gradients, 0.0)
    assert stepper.noise(gradients) < 1e-6 * 2e-3**2, "a gradient that never changes"


def test_gradient_noise_counts_what_the_batch_touched():
    p, rng = problem({TEXTURE: 0.5}, constant_target=None), np.random.default_rng(5)
    stepper = Stepper(p.unknowns, OptimizerConfig(mask_updates=False))
    size, mean = as_numpy(stepper.values[TEXTURE]).size, 0.0
    for _ in range(4):
        g = rng.normal(size=size).astype(np.float32)
        stepper.step({TEXTURE: unflat(stepper.values[TEXTURE], mi.Float(g))}, 0.0)
        mean = 0.9 * mean + 0.1 * g.astype(np.float64)
    half = np.where(np.arange(size) % 2, g, 0).astype(np.float32)
    touched = np.mean(((mean / (1 - 0.9**4) - half) ** 2)[half != 0])
    gradients = {TEXTURE: unflat(stepper.values[TEXTURE], mi.Float(half))}
    assert stepper.noise(gradients) == pytest.approx(touched, rel=1e-4)


def test_gradient_noise_is_of_what_moves():
    """What rests has a mean that stands still, and an estimate all the same."""
    resting = UnknownConfig(start=0.5, during=[0.0, 0.5])
    p = problem({TEXTURE: resting, ROUGHNESS: 0.5}, constant_target=None)
    stepper = Stepper(p.unknowns, OptimizerConfig())
    ones = {
        k: dr.full(type(v), 1, v.shape) if k == TEXTURE else type(v)(1)
        for k, v in stepper.values.items()
    }
    for _ in range(3):
        stepper.step(ones, 0.0)
    late = {**ones, TEXTURE: ones[TEXTURE] * 100}
    stepper.step(late, 0.7)
    assert stepper.noise(late, 0.7) < 1e-9 < stepper.noise(late, 0.2)
