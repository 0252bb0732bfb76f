"""Many pixels with a path each, or few with several? And where? Noise of plateau-reduced gradients.

Per task of PRDPT, all sides with 16,384 paths a rendering of a pair: estimates of the gradient
beside the truth (half a width more in every entry), at the widths of a run at 0.35 and 0.9 of its
budget. Sides in turn, the order rotating; of one scheme with the same offsets. Drawn pixels
(`sampler.base=differences`) from the mean of three looks, on 128 cells, whose time is shared out
over the steps until the next. `--of residual`: instead, 8 paths for uniform pixels, and the
residual from one rendering (the paper's) or from two on both sides, of as many paths together;
where there are several unknowns, but on sort, with its 150, from two with separate pairs, of 8
paths together or as many as the pairs have on one side. `--of offsets`, not on sort: separate pairs
whose offset along the entry is drawn in proportion to the kernel's derivative, the other of a pair
opposite (ours and the paper's), or by itself on its side, or uniform within four widths and
opposite; one path in each of 16,384 uniform pixels.

Variance: that of the first side (uniform pixels, a path each; one) over the side's, the geometric
mean over the entries, with the 95 % interval of a bootstrap over the steps. Gain: the same of
variance × time; the time is the median over the rounds. It says nothing of other numbers of paths a
step. The residual has paths of its own: 2 a pixel where the pair's renderings have one, as many as
one of these otherwise.
Writes results/plateau_variance.csv, plateau_residual.csv or plateau_offsets.csv.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import _contest
import _rows
import numpy as np
import pages
import pandas
from _plateau_table import TASKS, asked

from isas_cli.unknowns import smoothing

RESULTS = Path(__file__).parent / "results"
OUTPUTS = {
    "pixels": RESULTS / "plateau_variance.csv",
    "residual": RESULTS / "plateau_residual.csv",
    "offsets": RESULTS / "plateau_offsets.csv",
}
PATHS = 16384  # a rendering
SPP = (1, 4, 16)
PROGRESS = (0.35, 0.9)
RESAMPLED = 400
WIDEST = 4.0  # in widths: beyond is 1 / 3000 of the kernel's derivative


def residuals(task: str, paths: int) -> dict[str, list[str]]:
    """Overrides by name."""
    common = ["sampler.spp=8", f"estimator.batch={paths // 8}"]
    found = {name: [*common, f"sampler.residual={name}"] for name in ("one", "pair")}
    if task not in ("cup", "occlusion", "sort"):
        separate = [*common, "sampler.scheme=separate"]
        found["separate, 8 paths"] = [*separate, "sampler.residual_spp=8"]
        found["separate"] = separate
    return found


def pixels(task: str, paths: int) -> dict[str, list[str]]:
    """Overrides by name."""
    found = {}
    for base in ("uniform", "differences"):
        for spp in SPP:
            settings = [f"sampler.base={base}", f"sampler.spp={spp}"]
            if base == "differences":
                settings += ["sampler.base.stage1.resolution=128"]
            found[f"{base} {spp}"] = [*settings, f"estimator.batch={paths // spp}"]
    return found


def offsets(task: str, paths: int) -> dict[str, list[str]]:
    """Overrides by name."""
    common = [f"estimator.batch={paths}", "sampler.residual_spp=2"]
    return {name: [*common, f"sampler.scheme={name}"] for name in ("separate", *SCHEMES)}


def independent(σ: np.ndarray, count: int, rng: np.random.Generator) -> list:
    """As `smoothing.separate`, but the two of a pair have offsets of their own, one on each side,
    along the entry."""
    found = smoothing.separate(σ, count, rng)
    for pair, other in zip(found, smoothing.separate(σ, count, rng)):
        along = pair.weight > 0
        pair.minus[along] = other.minus[along]
    return found


def uniform(σ: np.ndarray, count: int, rng: np.random.Generator) -> list:
    """As `smoothing.separate`, but the offset τ along the entry is uniform within `WIDEST` widths,
    and weighs |∂κ/∂τ| over that density; stratified as there."""
    found = []
    for pair, u in zip(smoothing.separate(σ, count, rng), _strata(σ.size, count, rng)):
        along, r = pair.weight > 0, WIDEST * u
        pair.plus[along], pair.minus[along] = r * σ[along], -r * σ[along]
        weight = pair.weight * WIDEST * r * np.exp(-(r**2) / 2)
        found.append(smoothing.Pair(pair.plus, pair.minus, weight))
    return found


def _strata(entries: int, count: int, rng: np.random.Generator) -> np.ndarray:
    return np.concatenate(
        [(rng.permutation(count) + rng.random(count)) / count for _ in range(entries)]
    )


SCHEMES = {"independent": independent, "uniform": uniform}
SIDES = {"pixels": pixels, "residual": residuals, "offsets": offsets}


def look(loop, values: dict, progress: float, base: int) -> float:
    """A new distribution for ``progress``. Returns a look's seconds, for each step until the
    next."""
    sampler, refresh = loop.sampler, loop.sampler.settings.refresh
    loop._weights = None
    begun = time.perf_counter()
    for number in range(3):
        found = sampler.look(values, base, number, None, progress)
        loop._weights = sampler.blended(loop._weights, found)
    loop._spread(loop._weights)
    return (time.perf_counter() - begun) / 3 / refresh if refresh else 0.0


def estimates(every: dict, progress: float, rounds: int, steps: int) -> tuple[dict, dict]:
    """By side: the gradients ``(rounds steps, D)``, and seconds of a step, ``(rounds)``."""
    rows: dict = {name: [] for name in every}
    seconds: dict = {name: [] for name in every}
    for number in range(-1, rounds):  # the first warms up
        turn = number % len(every)
        order = list(every.items())
        for name, loop in order[turn:] + order[:turn]:
            blur = loop.estimator.blur
            truth = blur.vector(loop.problem.unknowns.truths())
            at = blur.values(truth + 0.5 * blur.widths(truth, progress))
            looks = look(loop, at, progress, 100 + number)
            found, begun = [], time.perf_counter()
            for step in range(max(0, number) * steps, (max(0, number) + 1) * steps):
                gradient = loop.estimator.estimate(at, loop._distribution, 1, step, progress)
                found.append(blur.vector(gradient))
            if number >= 0:
                seconds[name].append((time.perf_counter() - begun) / steps + looks)
                rows[name] += found
    return {name: np.array(found) for name, found in rows.items()}, seconds


def ratios(first: np.ndarray, side: np.ndarray) -> np.ndarray:
    """Variance of ``first`` over that of ``side``, both ``(steps, D)``: the geometric mean over the
    entries; of all steps, then of ``RESAMPLED`` resamples of them."""
    rng = np.random.default_rng(0)
    chosen = [np.arange(len(first))]
    chosen += [rng.integers(len(first), size=len(first)) for _ in range(RESAMPLED)]
    found = []
    for steps in chosen:
        a, b = first[steps].var(axis=0), side[steps].var(axis=0)
        moved = (a > 0) & (b > 0)  # of a part that no drawn pixel sees there is none
        found.append(np.exp(np.mean(np.log(a[moved] / b[moved]))))
    return np.array(found)


def child(task: str, chosen: argparse.Namespace) -> None:
    """Prints one row per progress and side."""
    from isas_cli.runtime import backend

    backend.start()
    from _plateau_cost import loops

    from isas_cli.estimators import plateau

    plateau.SCHEMES |= SCHEMES

    common = [f"scene={task}", "sampler=plateau", "target.spp=256", "budget.seconds=1"]
    common += ["~scene.method"]
    common += ["size=tiny"] if chosen.quick else []
    paths, rounds, steps = PATHS, chosen.rounds, chosen.steps
    if chosen.quick:
        paths, rounds, steps = 1024, 1, 8
    every = loops({name: [*common, *own] for name, own in SIDES[chosen.of](task, paths).items()})
    for progress in PROGRESS:
        rows, seconds = estimates(every, progress, rounds, steps)
        first = next(iter(rows))
        for name in rows:
            found = ratios(rows[first], rows[name])
            low, high = np.quantile(found[1:], (0.025, 0.975))
            cost = float(np.median(np.divide(seconds[name], seconds[first])))
            row = {"task": task, "progress": progress, "side": name, "variance": found[0]}
            row |= {"variance_low": low, "variance_high": high, "time": cost}
            row |= {"gain": found[0] / cost, "gain_low": low / cost, "gain_high": high / cost}
            _rows.emit(row)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--of", choices=SIDES, default="pixels", help="default: pixels")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--steps", type=int, default=150, help="estimates per side and round")
    parser.add_argument("--quick", action="store_true", help="tiny scenes, one short round")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    chosen = asked(parser)
    if chosen.child:
        return child(chosen.tasks[0], chosen)
    output = OUTPUTS[chosen.of]
    for task in chosen.tasks:
        if task == "sort" and chosen.of == "offsets":
            continue  # 150 entries: as many pairs a step
        # A process each: several scenes in one slow each other.
        command = [sys.executable, __file__, *sys.argv[1:], "--child"]
        command = [word for word in command if word not in TASKS] + [task]
        rows = pandas.DataFrame(_rows.collect(command))
        print(rows.to_string(index=False, float_format="%.2f"), flush=True)
        if not chosen.quick:
            _contest.write(output, rows, ("task",))
            pages.write()


if __name__ == "__main__":
    main()
