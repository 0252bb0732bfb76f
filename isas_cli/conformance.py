"""What isas relies on of a part, as tests that its author can run:

    ISAS_CHOICE="sampler=dark" python -m pytest --pyargs isas_cli.conformance
    ISAS_CHOICE="loss=huber loss.width=0.2" python -m pytest --pyargs isas_cli.conformance

The first word of ``ISAS_CHOICE`` is the part, further ones are settings of a run; a scene among
them takes the place of `pottery`. Every part: settings that are refused by their names, a run whose
errors are numbers, and one that goes on with the same bits. A sampler also: that every pixel can be
drawn, that it bends no mean, and that a look depends on nothing that was looked at before. An
estimator that blurs nothing: that its gradient's mean is path replay's. A loss: that its derivative
is its own.
"""

from __future__ import annotations

import contextlib
import itertools
import os

import numpy as np
import pytest

CHOICE = os.environ.get("ISAS_CHOICE", "sampler=uniform").split()
GROUP, _, NAME = CHOICE[0].partition("=")
SMALL = ["size=tiny", "threads=1", "estimator.batch=2048", "frames.views=0", "report=false"]
SMALL += ["evaluation.pixels=512", "evaluation.count=2", "effects=full", "target.spp=16"]
# Estimates of a gradient with and without the part, and standard errors that tell a bias.
REPEATS, BEYOND = 96, 5.0


def of(group: str):
    """Of this group's parts alone."""
    return pytest.mark.skipif(GROUP != group, reason=f"asks about a {group}, not a {GROUP}")


def settings(*more: str) -> list[str]:
    scene = [] if any(word.startswith("scene=") for word in CHOICE) else ["scene=pottery"]
    return [*scene, *SMALL, *CHOICE, *more]


@pytest.fixture(scope="module", autouse=True)
def started():
    from isas_cli.runtime import backend

    return backend.start(threads=1)


@pytest.fixture(scope="module")
def problem():
    from isas_cli.config.compose import compose, translate
    from isas_cli.config.schema import typed
    from isas_cli.engine import assemble

    cfg = typed(compose(translate(settings())))
    return assemble.problem(cfg.scene, cfg.target, lambda done, total: None)


@pytest.fixture
def part():
    """Made anew from its configuration."""
    from isas_cli.config.compose import compose, instantiate, translate

    cfg = compose(translate(settings()))
    node = cfg.optimizer.filter if GROUP == "optimizer.filter" else cfg[GROUP]
    return instantiate(node, GROUP)


def test_a_setting_that_is_none_is_refused_by_its_name():
    from isas_cli.config.compose import compose, translate
    from isas_cli.runtime.errors import InputError

    with pytest.raises(InputError, match=rf"{GROUP}\.no_such_thing") as caught:
        compose(translate(settings(f"{GROUP}.no_such_thing=1")))
    assert "\n" not in str(caught.value)


def test_what_its_file_says_are_its_defaults(part):
    """A setting that the file leaves out cannot be given."""
    from dataclasses import fields

    from isas_cli.config.compose import compose, translate

    node = compose(translate(settings()))
    for name in GROUP.split("."):
        node = node[name]
    assert {f.name for f in fields(part)} - {"stage1", "base"} <= set(node) | _unused(part), (
        "settings that its YAML file does not name"
    )


def _unused(part) -> set[str]:
    """What samplers share and this one has no use for."""
    shared = {"floor", "refresh"}
    return shared - set(getattr(part, "uses", shared))


def test_a_run_s_errors_are_numbers(tmp_path):
    import isas_cli

    run = isas_cli.run(*settings("budget.iterations=3", f"hydra.run.dir={tmp_path / 'run'}"))
    assert run.summary is not None
    assert run.summary["status"] == "done" and run.summary["iterations"] == 3
    assert np.isfinite(run.history["image_rmse"]).all()
    assert all(np.isfinite(values).all() for values in run.parameters().values())


def test_a_run_goes_on_with_the_same_bits(tmp_path, monkeypatch):
    """After it was stopped: what follows the budget would follow a shorter one otherwise."""
    import isas_cli
    from isas_cli.cli.app import main
    from isas_cli.runtime import interrupt

    @contextlib.contextmanager
    def early(*_):
        asked = itertools.count()
        yield lambda: next(asked) >= 3

    words = settings("evaluation.count=1", "budget.iterations=6")
    whole = isas_cli.run(*words, f"hydra.run.dir={tmp_path / 'whole'}")
    folder = tmp_path / "parts"
    with monkeypatch.context() as changed:
        changed.setattr(interrupt, "graceful", early)
        stopped = isas_cli.run(*words, f"hydra.run.dir={folder}")
    assert stopped.summary is not None and 0 < stopped.summary["iterations"] < 6
    assert main(["run", f"resume={folder}"]) == 0
    parts = isas_cli.load(folder)
    for key, values in whole.parameters().items():
        assert np.array_equal(values, parts.parameters()[key]), key


@of("sampler")
def test_every_pixel_can_be_drawn_and_probabilities_sum_to_one(problem, part):
    import drjit as dr
    import mitsuba as mi

    distribution = _looked(problem, part)
    place = problem.views.locate(dr.arange(mi.UInt32, problem.views.total))
    found = np.array(distribution.probability(*place), np.float64)
    assert found.min() > 0, "a pixel that is never drawn: keep sampler.floor above 0"
    assert abs(found.sum() - 1) < 1e-3


@of("sampler")
def test_it_bends_no_mean(problem, part):
    """Gradients with its pixels and with uniform ones."""
    _alike(
        _gradients(problem, _estimates(problem, _looked(problem, part), 1, REPEATS)),
        _gradients(problem, _estimates(problem, _uniform(problem), 2, REPEATS)),
    )


@of("sampler")
def test_a_look_depends_on_no_earlier_one(problem, part):
    """Runs of a race that have the same settings share it, whatever their seeds."""
    sampler, values, moments = _at_work(problem, part)
    first, _, again = (
        np.array(sampler.look(values, seed, number, moments))
        for seed, number in ((5, 0), (9, 7), (5, 0))
    )
    assert np.array_equal(first, again)


@of("estimator")
def test_its_mean_is_that_of_path_replay(problem, part):
    from isas_cli.losses import L2

    estimator, values = part.on(problem, L2()), problem.unknowns.starts()
    if estimator.heeds_blurs:
        pytest.skip("blurs: another loss than path replay's")
    found = (
        estimator.estimate(values, _uniform(problem), 1, number, 0.0) for number in range(REPEATS)
    )
    _alike(
        _gradients(problem, found),
        _gradients(problem, _estimates(problem, _uniform(problem), 2, REPEATS)),
    )


def _alike(own: np.ndarray, other: np.ndarray) -> None:
    """Whether gradients ``(REPEATS, m)`` have one mean, along random directions and alone."""
    directions = np.random.default_rng(3).normal(size=(own.shape[1], 32))
    directions[:, 0] = 1  # what all entries share
    apart = [rows @ directions for rows in (own, other)]
    error = np.sqrt(sum(rows.var(axis=0, ddof=1) / len(rows) for rows in apart))
    scores = (apart[0].mean(axis=0) - apart[1].mean(axis=0)) / np.maximum(error, 1e-30)
    assert np.abs(scores).max() < BEYOND, f"standard scores {np.round(scores, 1)}"


def _looked(problem, sampler):
    """Its distribution at the start values."""
    sampler, values, moments = _at_work(problem, sampler)
    weights = sampler.look(values, 5, 0, moments)
    return sampler.distribution(sampler.blended(None, weights))


def _at_work(problem, sampler):
    """On the problem, with the start values and, where it needs them, Adam's moments."""
    from isas_cli.config.schema import OptimizerConfig
    from isas_cli.engine.optimiser import Stepper
    from isas_cli.losses import L2

    if "blur" in sampler.needs:
        pytest.skip("draws no pixels for path replay")
    moments, values = None, problem.unknowns.starts()
    if "moments" in sampler.needs:  # as after some steps
        stepper = Stepper(problem.unknowns, OptimizerConfig())
        for found in _estimates(problem, _uniform(problem), 7, 32):
            stepper.step(found, 0.0)
        moments = stepper.moments(0.5)
    return sampler.on(problem, L2(), 2048), values, moments


def _uniform(problem):
    from isas_cli.rendering.pixels import PixelDistribution, Tiles

    return PixelDistribution.uniform(Tiles.over(problem.views))


def _estimates(problem, distribution, seed: int, count: int):
    """Gradients at the start values, by key, one after another."""
    from isas_cli.estimators.two_path import TwoPath
    from isas_cli.losses import L2

    estimator, values = TwoPath(problem, L2(), 2048), problem.unknowns.starts()
    for number in range(count):
        problem.unknowns.attach(values)
        estimator.accumulate(distribution, seed, number)
        yield problem.unknowns.gradients()
    problem.unknowns.write(values)


def _gradients(problem, every) -> np.ndarray:
    """``every`` gradient, by key, as rows ``(REPEATS, m)``."""
    from isas_cli.unknowns.parameters import flat

    keys = problem.unknowns.keys
    rows = (np.concatenate([np.array(flat(found[key])) for key in keys]) for found in every)
    return np.array(list(rows), np.float64)


@of("loss")
def test_its_derivative_is_that_of_its_value(part):
    import mitsuba as mi

    rng, step, lanes = np.random.default_rng(1), 1e-3, _lanes(part)
    image, target, along = (rng.uniform(low, 4, (3, 500 * lanes)) for low in (0, 0, -4))
    up, down = (
        np.array(part.value(mi.Color3f(image + s * along), mi.Color3f(target)), np.float64)
        for s in (step, -step)
    )
    found = np.array(part.derivative(mi.Color3f(image), mi.Color3f(target)), np.float64)
    found = (found * along).reshape(3, 500, lanes).sum(axis=2)
    off = np.abs(found - (up - down) / (2 * step)) > 0.02 + 0.02 * np.abs(found)
    assert off.mean() < 0.01, "beyond its kinks"


@of("loss")
def test_linear_says_whether_its_derivative_is(part):
    import mitsuba as mi

    rng, lanes = np.random.default_rng(2), _lanes(part)
    samples, target = rng.exponential(1, (3, 10_000, lanes)), rng.uniform(0.5, 1, (3, lanes))

    def derivative(images: np.ndarray) -> np.ndarray:
        targets = np.broadcast_to(target[:, None], images.shape)
        given = (mi.Color3f(np.ascontiguousarray(x.reshape(3, -1))) for x in (images, targets))
        return np.array(part.derivative(*given), np.float64).reshape(images.shape)

    mean, at_mean = derivative(samples).mean(axis=1), derivative(samples.mean(axis=1)[:, None])
    assert np.allclose(mean, at_mean[:, 0], rtol=1e-3, atol=1e-4) == part.linear


@of("loss")
def test_it_measures_what_it_is(part):
    import mitsuba as mi

    rng, lanes = np.random.default_rng(3), _lanes(part)
    image, target = (mi.Color3f(rng.uniform(0, 3, (3, lanes))) for _ in range(2))
    found, own = (
        np.array(x) for x in (part.measured(image, image, target), part.value(image, target))
    )
    assert np.allclose(found, own, rtol=1e-4)
    assert np.all(np.array(part.pixelwise.curvature(target)) > 0)


def _lanes(loss) -> int:
    """Pixels of a window, or 1."""
    return loss.windows.count if loss.windows else 1
