"""What directions drawn for the derivative buy on trashcan, at several roughnesses of the bin.

Estimates by BSDF sampling and by derivative sampling take turns. Of each pair of variances the
ratio, plain over drawn, with a 95 % bootstrap interval over estimates: of Σ_j dI_j/dθ over the
image (the derivative alone), and of dℒ/dθ from uniformly drawn pixels (what a step sees). Beside
them the ratio of times, drawn over plain, and both together: variance times time.

Writes results/derivative_sampling.csv.
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path

from isas_cli.runtime import backend

RESULTS = Path(__file__).parent / "results"
ROUGHNESSES = [0.8, 0.6, 0.4, 0.25, 0.15]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--estimates", type=int, default=400)
    parser.add_argument("--batch", type=int, default=16384)
    chosen = parser.parse_args()
    backend.start()
    import pages
    import pandas
    from _child import problem_of

    problem, _ = problem_of(["scene=trashcan"])
    rows = []
    for roughness in ROUGHNESSES:
        rows.append({"roughness": roughness, **measured(problem, roughness, chosen)})
        print(rows[-1], flush=True)
        table = pandas.DataFrame(rows)
        table.to_csv(RESULTS / "derivative_sampling.csv", index=False, float_format="%.4g")
        pages.write()


def measured(problem, roughness: float, chosen: argparse.Namespace) -> dict[str, float]:
    import numpy as np

    from isas_cli.estimators.two_path import TwoPath
    from isas_cli.losses import L2
    from isas_cli.rendering.derivative_sampling import sampled
    from isas_cli.rendering.pixels import PixelDistribution, Tiles

    class Ones(L2):
        """∂ℓ/∂I = 1: the estimate is the image's own derivative."""

        def derivative(self, image, target):
            return image * 0 + 1

    (unknown,) = problem.unknowns
    values = problem.unknowns.values_of({unknown.key: np.full(1, roughness, np.float32)})
    uniform = PixelDistribution.uniform(Tiles.over(problem.views))
    found = {}
    for name, loss in (("image", Ones()), ("loss", L2())):
        sides = [TwoPath(p, loss, chosen.batch) for p in (problem, sampled(problem))]
        taken, seconds = [[], []], [[], []]
        for i in range(-8, chosen.estimates):
            for side, estimator in enumerate(sides):
                problem.unknowns.attach(values)
                begun = time.perf_counter()
                estimator.accumulate(uniform, 1, i % (1 << 24))
                gradient = float(problem.unknowns.gradients()[unknown.key][0])
                if i >= 0:
                    seconds[side].append(time.perf_counter() - begun)
                    taken[side].append(gradient)
        problem.unknowns.write(values)
        ratio, low, high = _ratio(np.array(taken))
        slower = statistics.median(b / a for a, b in zip(*seconds))
        found |= {f"{name}_variance": ratio, f"{name}_low": low, f"{name}_high": high}
        found |= {f"{name}_time": slower, f"{name}_efficiency": ratio / slower}
    return found


def _ratio(taken) -> tuple[float, float, float]:
    from scipy import stats

    def ratio(plain, drawn, axis=-1):
        return plain.var(axis=axis) / drawn.var(axis=axis)

    interval = stats.bootstrap(
        tuple(taken), ratio, n_resamples=2000, method="percentile", random_state=1
    ).confidence_interval
    return float(ratio(*taken)), interval.low, interval.high


if __name__ == "__main__":
    main()
