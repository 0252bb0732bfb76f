"""How much of the gradient of `sort` lies beyond a cube's reach (`estimators.locality`).

Separate pairs, a cube's coordinate at a time: slopes from all pixels and, from the very same
renderings, from those near the cube. Per reach the root mean square over coordinates of what the
far pixels add, over that of the slopes; both squares less what noise adds to them, with the 95 %
interval of a bootstrap over pairs. At a run's scattered start, by the widths of its begin and of
six tenths of its budget. Sums, no times. Writes results/sort_reach.csv.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pandas

from isas_cli.runtime import backend

RESULTS = Path(__file__).parent / "results"
REACHES = (0.15, 0.2, 0.3, 0.4)
PROGRESS = (0.0, 0.6)


def slopes(loop, progress: float, count: int, entries: int, base: int) -> np.ndarray:
    """``(count, entries, 1 + reaches)``: estimates from all pixels, then from near ones."""
    from isas_cli.estimators.locality import Locality
    from isas_cli.unknowns import smoothing

    estimator, problem = loop.estimator, loop.problem
    (unknown,) = problem.unknowns
    localities = []
    for reach in REACHES:
        unknown.blur.reach = reach
        localities.append(Locality(problem, estimator.blur, estimator.batch))
    found = []

    def both(θ, pair, place, terms):
        whole = np.full(θ.size, float(np.sum(np.array(terms, np.float64))))
        near = [locality.differences(θ, pair, place, terms) for locality in localities]
        k = int(np.flatnonzero(pair.weight)[0])
        found.append(pair.weight[k] * np.array([side[k] for side in (whole, *near)]))
        return np.zeros(θ.size)

    estimator._renderings._locality.differences = both
    θ = estimator.blur.vector(problem.unknowns.starts())
    σ = estimator.blur.widths(θ, progress)
    rng = np.random.default_rng(base)
    for _ in range(count):
        # All colours and both coordinates: an odd stride.
        for pair in smoothing.separate(σ, 1, rng)[:: θ.size // entries | 1][:entries]:
            estimator._differences(θ, σ, [pair], loop._distribution, rng)
    return np.array(found).reshape(count, entries, -1)


def square(values: np.ndarray) -> float:
    """The mean square of what ``values (count, entries)`` estimate: without their noise's part."""
    return np.mean(values.mean(axis=0) ** 2 - values.var(axis=0, ddof=1) / len(values))


def far_share(found: np.ndarray, reach: int) -> float:
    far = found[:, :, 1 + reach] - found[:, :, 0]
    return float(np.sqrt(max(0.0, square(far)) / max(square(found[:, :, 0]), 1e-300)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=60, help="pairs of each coordinate")
    parser.add_argument("--entries", type=int, default=40, help="coordinates, of 150")
    parser.add_argument("--quick", action="store_true", help="few pairs, a tiny film")
    chosen = parser.parse_args()
    count, entries = (3, 4) if chosen.quick else (chosen.count, chosen.entries)
    backend.start()
    from _plateau_cost import loops

    overrides = ["scene=sort", "sampler=plateau", "sampler.scheme=separate", "budget.seconds=1"]
    # Each pair by itself, with a residual of its own.
    overrides += ["sampler.residual_spp=2", "~scene.method"]
    overrides += ["target.spp=256", f"estimator.batch={1024 if chosen.quick else 65536}"]
    loop = loops({"separate": [*overrides, *(["size=tiny"] if chosen.quick else [])]})["separate"]
    loop._look(0)
    rows = []
    for progress in PROGRESS:
        found = slopes(loop, progress, count, entries, base=1)
        rng = np.random.default_rng(0)
        resampled = [found[rng.integers(count, size=count)] for _ in range(400)]
        for number, reach in enumerate(REACHES):
            many = [far_share(again, number) for again in resampled]
            low, high = np.quantile(many, (0.025, 0.975))
            share = far_share(found, number)
            rows.append({"progress": progress, "reach": reach, "far_share": share})
            rows[-1] |= {"low": low, "high": high}
            print(f"progress {progress}, reach {reach}: {share:.4f} ({low:.4f} … {high:.4f})")
    if not chosen.quick:
        pandas.DataFrame(rows).to_csv(RESULTS / "sort_reach.csv", index=False, float_format="%.4g")


if __name__ == "__main__":
    main()
