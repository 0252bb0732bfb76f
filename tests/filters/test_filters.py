"""What all filters have in common: what they leave alone, resuming, runs, wrong settings."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from runs_for_tests import QUIET, ran
from scenes_for_tests import ROUGHNESS, TEXTURE, problem

from isas_cli.config.compose import compose, instantiate, translate
from isas_cli.config.schema import OptimizerConfig
from isas_cli.engine.optimiser import Stepper
from isas_cli.filters import Bilateral, Gaussian, JamesStein, Laplacian, Layout, Nothing
from isas_cli.runtime.errors import InputError
from isas_cli.unknowns.parameters import as_numpy, flat, unflat

FILTERS = {each.name: each for each in (Nothing, Gaussian, JamesStein, Bilateral, Laplacian)}
TINY = ["size=tiny", "threads=1", "estimator.batch=2048", "target.spp=4", "evaluation.pixels=512"]
TINY += ["effects=full", "budget.iterations=6", *QUIET]


def stepped(stepper: Stepper, seed: int, steps: int, noise: float = 1.0) -> dict[str, np.ndarray]:
    """Values after steps along (value - 0.7) + noise."""
    rng = np.random.default_rng(seed)
    for _ in range(steps):
        found = {}
        for key, value in stepper.values.items():
            drawn = mi.Float(noise * rng.normal(size=dr.width(flat(value))))
            found[key] = unflat(value, flat(value) - 0.7 + drawn)
        stepper.step(found, 0.0)
    return {key: as_numpy(value) for key, value in stepper.values.items()}


@pytest.mark.parametrize("name", FILTERS)
def test_a_stepper_goes_on_with_the_same_bits(name):
    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.5}, size=16)
    make = lambda: Stepper(p.unknowns, OptimizerConfig(), FILTERS[name]())
    first = make()
    stepped(first, 1, 5)
    arrays, state = first.export()
    whole = stepped(first, 2, 5)
    again = make()
    again.restore(arrays, state)
    rest = stepped(again, 2, 5)
    for key in whole:
        assert np.array_equal(whole[key], rest[key]), key
    fresh = stepped(make(), 2, 5)
    assert not np.array_equal(whole[TEXTURE], fresh[TEXTURE])


@pytest.mark.parametrize("name", FILTERS)
def test_a_restart_is_a_start(name):
    p = problem({TEXTURE: 0.5}, size=16)
    stepper = Stepper(p.unknowns, OptimizerConfig(), FILTERS[name]())
    begun = stepped(stepper, 1, 3)
    stepper.restart()
    assert np.array_equal(stepped(stepper, 1, 3)[TEXTURE], begun[TEXTURE])


@pytest.mark.parametrize("name", ("bilateral", "laplacian"))
def test_where_nothing_has_a_gradient_all_rests(name):
    p = problem({TEXTURE: 0.5}, size=16)
    stepper = Stepper(p.unknowns, OptimizerConfig(mask_updates=True), FILTERS[name]())
    stepped(stepper, 1, 1)
    before, value = stepper.export()[0], stepper.values[TEXTURE]
    stepper.step({TEXTURE: unflat(value, mi.Float(np.zeros(16 * 16 * 3, np.float32)))}, 0.0)
    after = stepper.export()[0]
    for array in before:
        assert np.array_equal(before[array], after[array]), array


@pytest.mark.parametrize("name", FILTERS)
def test_what_is_not_finite_reaches_no_neighbour_and_no_number_is_filtered(name):
    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.5}, size=16)
    steppers = [Stepper(p.unknowns, OptimizerConfig(), f()) for f in (FILTERS[name], Nothing)]
    for stepper in steppers:
        entries = np.ones(16 * 16 * 3, np.float32)
        entries[7] = np.nan
        found = {TEXTURE: unflat(stepper.values[TEXTURE], mi.Float(entries))}
        stepper.step(found | {ROUGHNESS: mi.Float(1)}, 0.0)
        assert sum(stepper.lost.values()) == 1
        assert all(np.isfinite(array).all() for array in stepper.export()[0].values())
    numbers = [as_numpy(stepper.values[ROUGHNESS]) for stepper in steppers]
    assert np.array_equal(*numbers)


def test_what_is_seen_counts_where_nothing_of_the_truth_tells_it():
    p = problem({TEXTURE: 0.5}, size=4)
    unknown = p.unknowns[TEXTURE]
    assert Layout.of(unknown, (4, 4, 3), False).seen is None
    unknown.seen = np.ones((4, 4, 3), bool)
    assert Layout.of(unknown, (4, 4, 3), False).seen is None, "no weights where all are seen"
    unknown.seen[1] = False
    seen = np.array(Layout.of(unknown, (4, 4, 3), False).seen).reshape(4, 4, 3)
    assert np.array_equal(seen, unknown.seen)
    assert Layout.of(unknown, (4, 4, 3), True).seen is None
    unknown.kind.hides = True
    assert Layout.of(unknown, (4, 4, 3), False).seen is None


def test_what_has_levels_of_its_own_takes_no_steps_of_all_resolutions():
    """Else coarse to fine would be done twice."""
    p = problem({TEXTURE: 0.5}, size=16)
    assert Stepper(p.unknowns, OptimizerConfig(), Laplacian()).filtered[TEXTURE].moves
    p.unknowns[TEXTURE].kind.levels = 2
    assert not Stepper(p.unknowns, OptimizerConfig(), Laplacian()).filtered[TEXTURE].moves
    assert compose(translate(["scene=pottery"])).optimizer.filter.name == Laplacian.name


@pytest.mark.parametrize("name", FILTERS)
def test_a_run_with_each(name, tmp_path):
    run = ran(tmp_path, "scene=dodoco_a", f"optimizer.filter={name}", *TINY)
    assert run.config["optimizer"]["filter"]["name"] == name
    start, end = run.history["parameter_rmse"].iloc[[0, -1]]
    assert end < start


@pytest.mark.parametrize("name", ("james_stein", "bilateral", "laplacian"))
def test_a_grid_that_becomes_finer_on_the_way(name, tmp_path):
    history = ran(tmp_path, "scene=smoke", f"optimizer.filter={name}", *TINY).history
    assert np.isfinite(history["parameter_rmse"]).all()


@pytest.mark.parametrize(
    "chosen, setting",
    [
        ("gaussian", "width=0"),
        ("gaussian", "width=0.25"),
        ("gaussian", "width=nan"),
        ("james_stein", "width=-1"),
        ("james_stein", "window=0"),
        ("james_stein", "memory=1"),
        ("bilateral", "edge=0"),
        ("bilateral", "levels=0"),
        ("bilateral", "levels=11"),
        ("laplacian", "coarsest=0"),
        ("laplacian", "rate=0"),
    ],
)
def test_wrong_settings_are_refused_by_their_name(chosen, setting):
    typed = ["scene=pottery", f"optimizer.filter={chosen}", f"optimizer.filter.{setting}"]
    node = compose(translate(typed)).optimizer.filter
    with pytest.raises(InputError, match=rf"^optimizer\.filter\.{setting}(\.0)?: ") as caught:
        instantiate(node, "optimizer.filter")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "typed, told",
    [
        (["optimizer.filter=gausian"], r"optimizer\.filter=gausian: no such filter.*gaussian"),
        (["optimizer.filter=[a]"], r"optimizer\.filter=\[a\]: give one name"),
        (["optimizer.filter.width=0.1"], r"optimizer\.filter\.width: no such setting"),
        (["optimizer.filter.name=gaussian"], r"say optimizer\.filter=NAME"),
    ],
)
def test_wrong_names_are_refused_in_one_line(typed, told):
    with pytest.raises(InputError, match=told) as caught:
        compose(translate(["scene=pottery", *typed]))
    assert "\n" not in str(caught.value)
