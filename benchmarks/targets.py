"""Noise × time of targets as `isas` renders them, over that of independent paths.

Of the scenes with an unknown texture, at their truths, films of 128². Independent paths are those
of `Renderer`, one a pixel and pass, as targets were rendered before. Sides take turns, and each
turn's noise is measured: of independent paths by the difference of two renderings, of the others as
they tell it themselves (tests/rendering/test_stratified.py compares that with many renderings).
Over the 99 in 100 pixels with the least noise, and over all, whose noise rare bright paths rule.
Writes results/targets.csv, a row a scene and `target.noise`: the goal is an `of_time` of 1 / 6.

    .venv/bin/python benchmarks/targets.py [SCENE …] [--noise 0.03 0.01] [--turns 2]
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time

import _contest
import _rows
import pages
import pandas
from reproduce import RESULTS
from steps_or_paths import TEXTURES

SPP, SHARE = 16, 0.99  # paths of half an independent rendering; as in rendering/stratified.py


def measure(scene: str, wanted: list[float], turns: int) -> None:
    from isas_cli.runtime import backend

    backend.start()
    import numpy as np
    from _child import problem_of

    from isas_cli.rendering import stratified
    from isas_cli.rendering.renderer import Renderer
    from isas_cli.runtime import streams

    size = "scene.arguments.resolution=128"
    problem, _ = problem_of([f"scene={scene}", "target.spp=1", size])
    problem.unknowns.write(problem.unknowns.truths())
    pixels, renderer = problem.views.total, Renderer(problem)

    def both(variance: np.ndarray) -> np.ndarray:
        """Mean over all pixels, and over those that are not the noisiest."""
        ordered = np.sort(variance)
        return np.array([ordered.mean(), ordered[: int(SHARE * pixels)].mean()])

    def independent(turn: int) -> tuple[np.ndarray, float]:
        """Variance and seconds of one path a pixel."""
        begun, halves = time.perf_counter(), []
        for half in (0, 1):
            first = (2 * turn + half) * SPP
            seeds = lambda i, first=first: streams.seed(1, first + i, "target")  # noqa: E731
            halves.append(renderer.range(0, pixels, SPP, seeds))
        seconds = (time.perf_counter() - begun) / (2 * SPP)
        apart = (halves[0] - halves[1]).astype(np.float64)
        return both(SPP * (apart**2).mean(1) / 2), seconds

    def ours(noise: float, turn: int):
        begun = time.perf_counter()
        sums = stratified.render(problem, noise, None, turn, lambda done, total: None)
        return sums, both(sums.variance.astype(np.float64)), time.perf_counter() - begun

    independent(0), ours(1.0, 0)  # compiles
    for noise in wanted:
        ratios, told, spp, means = [], [], [], []
        for turn in range(1, turns + 1):
            variance, seconds = independent(turn)
            sums, own, taken = ours(noise, turn)
            ratios.append(own * taken / (variance * seconds))
            told.append(stratified.noise(sums.images, sums.variance))
            spp.append(sums.paths / pixels)
            means.append(float(np.sqrt(variance[1]) / sums.images.mean()))
        whole, most = (statistics.median(each) for each in zip(*ratios))
        _rows.emit(
            {
                "scene": scene,
                "target_noise": noise,
                "noise": statistics.median(told),
                "paths_a_pixel": statistics.median(spp),
                # Independent paths a pixel that have as little.
                "independent": (statistics.median(means) / statistics.median(told)) ** 2,
                "of_time": most,
                "of_time_all_pixels": whole,
            }
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", metavar="SCENE")
    parser.add_argument("--noise", nargs="+", type=float, default=[0.03])
    parser.add_argument("--turns", type=int, default=2)
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.child:
        measure(chosen.scenes[0], chosen.noise, chosen.turns)
        return
    path = RESULTS / "targets.csv"
    for scene in chosen.scenes or TEXTURES:
        more = ["--noise", *map(str, chosen.noise), "--turns", str(chosen.turns), "--child"]
        rows = pandas.DataFrame(_rows.collect([sys.executable, __file__, scene, *more]))
        _contest.write(path, rows)
        print(rows.to_string(index=False), flush=True)
    pages.write()
    of_noise = pandas.read_csv(path).groupby("target_noise")
    shown = of_noise[["of_time", "of_time_all_pixels"]].median()
    print("medians over scenes:", shown.to_string(), sep="\n")


if __name__ == "__main__":
    main()
