"""Eq. 18: against NumPy, around any sampler, and what the command line makes of it."""

from dataclasses import fields

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scenes_for_tests import STAGE1, UNKNOWNS, problem

from isas_cli import losses
from isas_cli.config.compose import compose, instantiate, translate
from isas_cli.report.compare import labels
from isas_cli.runtime.errors import InputError
from isas_cli.samplers.gradient import Gradient
from isas_cli.samplers.multiresolution import Multiresolution, pyramid
from isas_cli.samplers.ours import Ours
from isas_cli.samplers.preconditioned import Preconditioned
from isas_cli.samplers.relevant import Relevant
from isas_cli.samplers.sampler import Moments, Stage1Settings
from isas_cli.samplers.stage1.cells import Cells
from isas_cli.samplers.uniform import Uniform
from isas_cli.unknowns.parameters import flat

COARSE = Multiresolution(base=Ours(stage1=Stage1Settings(resolution=12, spp=4, denoise="none")))


def split(values: np.ndarray, cells: Cells) -> list[np.ndarray]:
    """The cells of each view as an image."""
    ends = np.cumsum([columns * rows for columns, rows in cells.sizes])[:-1]
    return [v.reshape(r, c) for v, (c, r) in zip(np.split(values, ends), cells.sizes)]


def eq_18(p: list[np.ndarray], levels: int) -> list[np.ndarray]:
    """Literally, for views whose sides are multiples of 2^D: Σ_d 4^d p_{j_d,d}, each level's
    probabilities summing to one over its own pixels."""
    result = [np.zeros_like(v) for v in p]
    for d in range(levels + 1):
        side = 2**d
        for view, total in zip(p, result):
            rows, columns = np.arange(view.shape[0]) // side, np.arange(view.shape[1]) // side
            coarse = np.zeros((rows[-1] + 1, columns[-1] + 1))
            np.add.at(coarse, (rows[:, None], columns[None]), view)
            total += 4.0**d * coarse[rows[:, None], columns[None]]
    return result


@pytest.mark.parametrize("levels", [0, 1, 4])
def test_it_is_eq_18(levels, rng):
    """Two views whose sides 2^D divides: the formula as it is printed, to the digit."""
    cells = Cells.over([(64, 32), (16, 64)], 64)
    weights = rng.exponential(1, cells.count).astype(np.float32)
    found = np.array(pyramid(mi.Float(weights), cells, [16.0**d for d in range(levels + 1)]))
    pmf = split(weights.astype(np.float64) / weights.sum(dtype=np.float64), cells)
    wanted = np.concatenate([v.reshape(-1) for v in eq_18(pmf, levels)])
    assert wanted.sum() == pytest.approx(sum(16.0**d for d in range(levels + 1)))
    assert np.allclose(found / found.sum(dtype=np.float64), wanted / wanted.sum(), rtol=1e-5)


def blocks(view: np.ndarray, shares: list[float]) -> np.ndarray:
    """The mean over each cell's block at every level, blocks cut off at the border."""
    result = np.zeros_like(view)
    for d, share in enumerate(shares):
        for row in range(view.shape[0]):
            for column in range(view.shape[1]):
                top, left = row >> d << d, column >> d << d
                block = view[top : top + 2**d, left : left + 2**d]
                result[row, column] += share / sum(shares) * block.mean()
    return result


@pytest.mark.parametrize("freeze", [False, True])
def test_borders_are_exact(freeze, rng):
    """Views of odd sizes, one smaller than a block: against loops; no view's mass changes."""
    cells = Cells.over([(37, 21), (5, 3), (16, 40), (1, 1)], 40)
    shares = [1.0, 3.0, 0.5, 7.0, 16.0]

    def function(weights, cells):
        return pyramid(weights, cells, shares)

    if freeze:
        function = dr.freeze(function)
    for _ in range(3):
        weights = rng.exponential(1, cells.count).astype(np.float32)
        found = function(mi.Float(weights), cells)
        dr.eval(found)
        for got, view in zip(split(np.array(found), cells), split(weights.astype(float), cells)):
            assert np.allclose(got, blocks(view, shares), rtol=1e-5)
            assert got.sum(dtype=float) == pytest.approx(view.sum(), rel=1e-5)


def test_what_is_no_weight_counts_as_zero():
    cells = Cells.over([(4, 4)], 4)
    weights = np.ones(16, np.float32)
    weights[[0, 5, 10]] = np.nan, np.inf, -1
    found = np.array(pyramid(mi.Float(weights), cells, [1.0, 16.0]))
    clean = np.where(np.isfinite(weights) & (weights > 0), weights, 0)
    assert np.allclose(found, blocks(clean.reshape(4, 4), [1.0, 16.0]).reshape(-1))


def looked(p, sampler, iteration: int = 0, moments=None) -> np.ndarray:
    sampler = sampler.on(p, losses.L2(), 512)
    starts = p.unknowns.starts()
    weights = np.array(sampler.look(starts, 3, iteration, moments))
    p.unknowns.write(starts)
    return weights


@pytest.mark.parametrize("kind", [Ours, Gradient, Relevant, Uniform])
def test_level_0_alone_is_the_base(kind):
    base = kind() if kind is Uniform else kind(stage1=STAGE1)
    p = problem(UNKNOWNS)
    assert np.allclose(looked(p, Multiresolution(base=base, levels=0)), looked(p, base), rtol=1e-6)


@pytest.mark.parametrize("factor, shares", [(4.0, [1, 16, 256]), (0.25, [1, 1, 1])])
def test_each_level_has_four_times_the_factor_of_the_mass_of_the_finer_one(factor, shares):
    p, base = problem(UNKNOWNS), Gradient(stage1=STAGE1)
    found = looked(p, Multiresolution(base=base, levels=2, factor=factor))
    cells = Cells.over(p.film_sizes, STAGE1.resolution)
    wanted = np.array(pyramid(mi.Float(looked(p, base)), cells, [float(s) for s in shares]))
    assert np.allclose(found, wanted, rtol=1e-5)


def test_base_gets_its_moments():
    p = problem(UNKNOWNS)
    sampler = Multiresolution(base=Preconditioned(stage1=STAGE1), levels=0)
    assert "moments" in sampler.needs and "moments" not in COARSE.needs
    v = {}
    for key, value in p.unknowns.starts().items():
        v[key] = mi.Float(np.logspace(-8, -4, dr.width(flat(value))).astype(np.float32))
    given = Moments(**{f.name: None for f in fields(Moments)} | {"second": v})
    with_moments = looked(p, sampler, 0, given)
    assert np.allclose(with_moments, looked(p, sampler.base, 0, given), rtol=1e-6)
    assert not np.allclose(with_moments, looked(p, sampler), rtol=1e-2)


def test_base_keeps_its_settings():
    base = Gradient(floor=0.3, refresh=7, stage1=Stage1Settings(resolution=6, spp=2, average=0.5))
    p = problem(UNKNOWNS)
    weights = looked(p, Multiresolution(base=base))
    base, sampler = (each.on(p, losses.L2(), 512) for each in (base, Multiresolution(base=base)))
    assert [i for i in range(20) if sampler.settings.due(i)] == [0, 7, 14]
    assert sampler.paths_per_look == base.paths_per_look > 0
    assert sampler.paths_before == base.paths_before
    assert sampler.cells.sizes == base.cells.sizes
    assert np.allclose(
        np.array(sampler.blended(mi.Float(weights), mi.Float(weights[::-1].copy()))),
        0.5 * (weights + weights[::-1]) / weights.sum(),
        rtol=1e-4,
    )


def test_floor_is_mixed_in_once():
    p = problem(UNKNOWNS)
    sampler = Multiresolution(base=Ours(floor=0.2, stage1=STAGE1)).on(p, losses.L2(), 512)
    weights = np.zeros(sampler.cells.count, np.float32)
    weights[-1] = 1
    distribution = sampler.distribution(mi.Float(weights))
    pixel = p.views.locate(dr.arange(mi.UInt32, p.views.total))
    share = np.array(distribution.probability(*pixel), np.float64) * p.views.total
    assert share.mean() == pytest.approx(1, rel=1e-5)
    assert share.min() == pytest.approx(0.2, rel=1e-4)


@pytest.mark.parametrize(
    "settings, words",
    [
        ({"base": Multiresolution()}, "sampler.base=multiresolution"),
        ({"levels": -1}, "sampler.levels=-1"),
        ({"levels": 17}, "sampler.levels=17"),
        ({"factor": 0.0}, "sampler.factor=0.0"),
        ({"floor": 0.2}, "sampler.floor=0.2"),
        ({"stage1": Stage1Settings(spp=3)}, "sampler.stage1.spp=3"),
    ],
)
def test_bad_settings_are_refused(settings, words):
    with pytest.raises(InputError, match=words):
        Multiresolution(**settings)


def made(*overrides: str):
    cfg = compose(translate(["scene=pottery", "sampler=multiresolution", *overrides]))
    return instantiate(cfg.sampler, "sampler")


def test_the_base_is_chosen_by_name():
    assert made() == Multiresolution()
    assert made("sampler.base=balanced").base.power == 0.5
    sampler = made("sampler.base=relevant", "sampler.base.floor=0.3", "sampler.levels=2")
    assert sampler == Multiresolution(base=Relevant(floor=0.3), levels=2)
    assert sampler.floor == 0.3
    # A contestant of a race, or a job of a sweep, says it in the same words.
    assert made("sampler.base.refresh=5", "sampler.base=gradient") == Multiresolution(
        base=Gradient(refresh=5)
    )


@pytest.mark.parametrize(
    "typed, words",
    [
        ("sampler.base=our", ["sampler.base=our", "did you mean 'ours'?"]),
        ("sampler.base=", ["sampler.base=: give one name", "uniform"]),
        ("sampler.base=[ours,uniform]", ["give one name"]),
        ("sampler.base=ours,uniform", ["sampler.base=ours,uniform: several values"]),
        ("sampler.base=multiresolution", ["sampler.base=multiresolution", "another"]),
        ("sampler.base.name=ours", ["say sampler.base=NAME"]),
        ("sampler.base.flor=1", ["did you mean 'sampler.base.floor'?"]),
        ("sampler.base.floor=2", ["sampler.base.floor=2.0: must lie in [0, 1]"]),
        ("sampler.base.stage1.spp=x", ["sampler.base.stage1.spp", "'x'"]),
        ("sampler.base=uniform sampler.base.refresh=3", ["sampler.base.refresh: no such setting"]),
        ("sampler.floor=0.1", ["sampler.floor: no such setting"]),
        ("sampler.levels=-1", ["sampler.levels=-1"]),
        ("sampler=ours sampler.base=uniform", ["sampler.base: no such setting", "sampler.floor"]),
    ],
)
def test_the_command_line_refuses_in_one_line(typed, words, refused):
    typed = typed.split()
    chosen = [] if typed[0].startswith("sampler=") else ["sampler=multiresolution"]
    assert "@" not in refused(["run", "scene=pottery", *chosen, *typed], *words)


def test_comparisons_name_the_base():
    """A label tells bases apart, and settings only among those that have them."""

    def settings(sampler: str, base: str = "", floor: str = "0.05") -> dict[str, str]:
        own = {"sampler.name": sampler, "sampler._target_": sampler}
        below = {"sampler.base.name": base, "sampler.base._target_": base}
        return own | ({**below, "sampler.base.floor": floor} if base else {})

    found = labels.methods(
        [
            settings("ours"),
            settings("multiresolution", "ours"),
            settings("multiresolution", "gradient"),
            settings("multiresolution", "gradient", "0.2"),
        ]
    )
    assert found == [
        "ours",
        "multiresolution sampler.base=ours",
        "multiresolution sampler.base.floor=0.05 sampler.base=gradient",
        "multiresolution sampler.base.floor=0.2 sampler.base=gradient",
    ]
    assert labels.methods([settings("ours"), settings("multiresolution", "ours")]) == [
        "ours",
        "multiresolution",
    ]
