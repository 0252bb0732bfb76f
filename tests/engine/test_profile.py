"""The profile: what it leaves alone, that its phases add up, and that time lands where it is spent.

Nothing is asserted about how long anything takes, except that what was made slow shows.
"""

import contextlib
import csv
import time

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from runs_for_tests import ran
from samplers_for_tests import pixel_samplers
from scenes_for_tests import ROUGHNESS, TEXTURE, problem

import isas_cli
from isas_cli import losses, records
from isas_cli.config.compose import compose, instantiate
from isas_cli.config.schema import OptimizerConfig
from isas_cli.engine import profiling
from isas_cli.engine.evaluate import Evaluator
from isas_cli.engine.loop import Hooks, Loop
from isas_cli.engine.optimiser import Stepper
from isas_cli.estimators.two_path import TwoPath
from isas_cli.runtime.budget import Budget
from isas_cli.runtime.errors import InputError

BATCH = 128
NAMES = ["drawing", "primal", "adjoint", "scatter", "Adam", "update", "stage 1", "host"]


@pytest.fixture(autouse=True)
def few_rounds(monkeypatch):
    monkeypatch.setattr(profiling, "_ROUNDS", 3)


def rehearsed(p, name: str, freeze: bool = True, iterations: int = 8, steps=Stepper) -> Loop:
    sampler = instantiate(compose(["scene=pottery", f"sampler={name}"]).sampler, "sampler")
    loss = losses.L2()
    made = Loop(
        p,
        sampler.on(p, loss, BATCH, freeze),
        steps(p.unknowns, OptimizerConfig(lr=0.05)),
        Evaluator(p, loss, 50, 2, 1),
        Budget(iterations=iterations),
        TwoPath(p, loss, BATCH, freeze),
        1,
        1,
    )
    made.rehearse()
    return made


def profiled(loop: Loop, freeze: bool = True) -> dict[str, profiling.Phase]:
    found = profiling.measure(loop, freeze)
    assert [phase.phase for phase in found.phases] == NAMES
    return {phase.phase: phase for phase in found.phases}


@pytest.mark.slow  # every run profiles ours, below
@pytest.mark.parametrize(
    "name, freeze",
    [
        *((name, True) for name in pixel_samplers()),
        ("uniform", False),
        ("ours", False),
    ],
)
def test_every_sampler_can_be_profiled(name, freeze):
    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.6})
    loop = rehearsed(p, name, freeze)
    loop.run(Hooks())
    phases = profiled(loop, freeze)
    assert sum(phase.share for phase in phases.values()) == pytest.approx(1)
    for phase in phases.values():
        assert np.isfinite(phase.milliseconds) and phase.low <= phase.milliseconds <= phase.high
    for name in ("drawing", "primal", "Adam", "update", "stage 1"):
        assert phases[name].milliseconds > 0, name


@pytest.mark.slow
def test_long_paths_can_be_profiled():
    """Path replay, where the adjoint traces its paths twice."""
    p = problem({TEXTURE: 0.5}, depth=7)
    loop = rehearsed(p, "ours")
    loop.run(Hooks())
    assert profiled(loop)["adjoint"].milliseconds > 0


def test_a_profile_leaves_the_loop_as_it_was():
    """State and distribution to the bit; a run that goes on goes on as if nothing had been."""
    ends = []
    for stop in (False, True):
        p = problem({TEXTURE: 0.5})
        loop = rehearsed(p, "ours", iterations=12)
        loop.begin(Hooks())
        for _ in range(6):
            loop._iterate()
        if stop:
            arrays, state = loop.export()
            density, way = loop.density(), dict(loop.stepper.reach)
            profiled(loop)
            assert loop.stepper.reach == way != dict.fromkeys(way, 0.0)
            after, state_after = loop.export()
            assert {k: v for k, v in state_after.items() if k != "unbilled"} == {
                k: v for k, v in state.items() if k != "unbilled"
            }
            assert set(after) == set(arrays)
            for key, array in arrays.items():
                np.testing.assert_array_equal(array, after[key], key)
            np.testing.assert_array_equal(density, loop.density())
            leaf = p.unknowns.leaves[TEXTURE]
            assert not dr.grad_enabled(leaf), "what renders next must not differentiate"
        loop.advance(Hooks())
        assert loop.position.iteration == 12
        ends.append(loop.export()[0])
        p.unknowns.write(loop.stepper.values)
    for key, array in ends[0].items():
        np.testing.assert_allclose(array, ends[1][key], rtol=1e-4, atol=1e-6, err_msg=key)


def test_cut_down_steps_scatter_nothing():
    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.6})
    loop = rehearsed(p, "ours")
    loop.run(Hooks())
    timed, values = profiling._Pass(loop, True), loop.stepper.values

    def changed(estimator) -> bool:
        before = {key: np.array(g) for key, g in p.unknowns.gradients().items()}
        estimator.accumulate(loop._distribution, 1, 3)
        after = p.unknowns.gradients()
        return any(np.any(np.array(after[key]) != g) for key, g in before.items())

    p.unknowns.attach(values)
    assert not changed(timed._cut["primal"])
    assert changed(loop.estimator), "the whole step does"
    p.unknowns.push_tangent(values, values)
    assert not changed(timed._cut["adjoint"])
    p.unknowns.write(values)


def test_kernels_are_counted_in_their_phase(monkeypatch):
    """By their sizes: what is as wide as the batch traces or draws, all else serves the unknowns.
    The step cut short has the whole one's kernels, but for what it leaves out."""
    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.6})
    loop = rehearsed(p, "ours")
    loop.run(Hooks())
    timed, found = profiling._Pass(loop, True), {}
    for i in range(4):
        timed.step(profiling._BASE + i)

    @contextlib.contextmanager
    def listed(spent, name):
        dr.kernel_history_clear()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            yield
            kernels = dr.kernel_history([dr.KernelType.JIT])
        found[name] = [(kernel["size"], kernel["operation_count"]) for kernel in kernels]

    with monkeypatch.context() as patched:
        patched.setattr(profiling, "_count", listed)
        timed._kernels(profiling._BASE)
    p.unknowns.write(loop.stepper.values)
    # Lost paths are counted by a few instructions, in a kernel of their own or not.
    wide = {
        name: [ops for size, ops in of if size == BATCH and ops > 9] for name, of in found.items()
    }
    for name in ("drawing", "primal", "adjoint"):
        others = [size for size, _ in found[name] if size not in (1, BATCH)]
        assert not others, f"{name} holds what belongs to update"
    assert not wide["update"] and not wide["Adam"] and found["update"] and found["Adam"]
    assert wide["drawing"] == wide["primal"][:1] == wide["estimate"][:1]
    assert len(wide["adjoint"]) == len(wide["estimate"]), "fused as in the whole step"
    assert wide["primal"][-1] < wide["adjoint"][-1]


class Sluggish(Stepper):
    """Waits on the host, and launches a kernel that takes long."""

    wait, work = 0.0, 0

    def step(self, gradients, progress):
        time.sleep(self.wait)
        if self.work:
            numbers = dr.arange(mi.Float, self.work)
            for _ in range(40):
                numbers = dr.sin(numbers)
            dr.eval(numbers)
        super().step(gradients, progress)


def test_time_lands_in_the_phase_that_spends_it(monkeypatch):
    p = problem({TEXTURE: 0.5})
    loop = rehearsed(p, "ours", steps=Sluggish)
    look = loop.sampler.look
    # Undone at once: it is a reference cycle, which must not be collected while Dr.Jit records.
    with monkeypatch.context() as patched:
        patched.setattr(loop.sampler, "look", lambda *a: (time.sleep(0.4), look(*a))[1])
        loop.run(Hooks())
    before = profiled(loop)
    assert before["stage 1"].milliseconds > 400 / 8, "one look in eight iterations"
    loop.stepper.wait = 0.1
    waiting = profiled(loop)
    assert waiting["host"].milliseconds > 90 > waiting["Adam"].milliseconds
    loop.stepper.wait, loop.stepper.work = 0.0, 1 << 23
    busy = profiled(loop)
    assert busy["Adam"].milliseconds > 2 * before["Adam"].milliseconds


def test_the_table_and_the_file_say_the_same(tmp_path):
    phases = [profiling.Phase(name, 2.0, 1.5, 2.5, 0.125, "wall") for name in NAMES]
    profile = profiling.Profile(phases, 5, 15.0)
    profiling.write(profile, tmp_path)
    rows = list(csv.DictReader((tmp_path / profiling.FILE).open()))
    assert [row["phase"] for row in rows] == NAMES
    assert all(float(row["milliseconds"]) == 2 and row["how"] == "wall" for row in rows)
    shown = profiling.table(profile)
    assert list(shown.columns[0].cells) == NAMES and list(shown.columns[3].cells)[0] == "12.5%"
    assert "16.00 ms in all" in shown.caption and "billed 15.00 ms" in shown.caption


def test_an_overwritten_run_takes_its_profile_with_it(tmp_path):
    (tmp_path / "manifest.json").write_text("{}")
    (tmp_path / profiling.FILE).write_text("old")
    records.RunWriter(tmp_path, overwrite=True)
    assert not (tmp_path / profiling.FILE).exists()


def test_the_command_prints_it_and_the_record_stays_the_same(tmp_path, capfd):
    """profile=true adds a file and a table; the run's values are the same, to the rounding that
    the threads' order leaves."""
    common = ["scene=pottery", "size=tiny", "sampler=gradient", "target.spp=4", "frames.views=0"]
    common += ["budget.iterations=10", "estimator.batch=256", "evaluation.count=3"]
    common += ["effects=full", "report=false"]
    runs = []
    for wanted in ("false", "true"):
        runs.append(ran(tmp_path / wanted, *common, f"profile={wanted}"))
        told, file = capfd.readouterr().err, tmp_path / wanted / profiling.FILE
        assert ("stage 1" in told) == file.exists() == (wanted == "true")
    plain, measured = runs
    assert "profile" in measured.summary["seconds_unbilled"]
    assert set(measured.summary["seconds_by_phase"]) == {"step", "stage1"}, "not billed"
    same = [c for c in plain.history.columns if "seconds" not in c]
    np.testing.assert_allclose(
        plain.history[same].to_numpy(), measured.history[same].to_numpy(), rtol=1e-3, atol=1e-9
    )
    values = [np.load(run.folder / "checkpoint" / "state.npz") for run in runs]
    for name in values[0].files:
        if name.startswith("array/value"):
            np.testing.assert_allclose(values[0][name], values[1][name], atol=1e-5)


@pytest.mark.parametrize(
    "more, told",
    [
        ("prior=smoothness", "a prior"),
        ("estimator.blurred=true", "estimator.blurred"),
        ("loss=structure", "a loss of windows"),
    ],
)
def test_what_a_step_does_besides_is_refused(tmp_path, more, told):
    settings = ["scene=pottery", "size=tiny", "profile=true", f"hydra.run.dir={tmp_path}"]
    if "blurred" in more:
        settings.append(
            "scene.unknowns={jar.bsdf.base_color.data: {blur: {start: 0.1, end: 0.05}}}"
        )
    with pytest.raises(InputError, match=f"profile=true takes .* and {told} is no part of it"):
        isas_cli.run(*settings, more)
