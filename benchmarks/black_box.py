"""A renderer that is not Mitsuba: how near to its parameters each estimator gets.

The disc behind a board of `examples/black_box.py`, whose pictures have hard edges and noise, from
its starts: plateau-reduced gradients (of blurred pictures, and of the blurred loss) and finite
differences, as wide as the last blur and as the first. Equal billed time; each at the best of
several factors on its rates, found with a seed of its own; the others are reported. Ways take
turns. Writes results/black_box.csv, a row a run.

    .venv/bin/python benchmarks/black_box.py
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import pages
import pandas

RESULTS = Path(__file__).parent / "results"
EXAMPLES = Path(__file__).parents[1] / "examples"
CHOOSING, SEEDS, FACTORS = 1, (2, 3, 4), (0.3, 1.0, 3.0)
QUIET = ["report=false", "frames.views=0", "frames.snapshots=0", "evaluation.count=24"]
PLAIN = "estimator=finite_differences"
WAYS = {
    "plateau": [],
    "plateau, loss blurred": ["estimator.smooth=loss"],
    "finite differences": [PLAIN],
    "finite differences, wide": [PLAIN, "estimator.step=40"],
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=15)
    chosen = parser.parse_args()
    sys.path.insert(0, str(EXAMPLES))
    import black_box

    rows = []
    with tempfile.TemporaryDirectory(prefix="isas-black-box-") as made:

        def run(way: str, factor: float, seed: int) -> None:
            found = black_box.main(
                *(f"budget.seconds={chosen.seconds}", "budget.iterations=null", *QUIET),
                *(*WAYS[way], f"optimizer.factor={factor}", f"seed={seed}"),
                f"hydra.run.dir={made}/{len(rows)}",
            )
            first, last = (float(found.history.parameter_rmse.iloc[i]) for i in (0, -1))
            row = {"way": way, "factor": factor, "seed": seed, "start": first, "end": last}
            rows.append(row | {"iterations": found.summary["iterations"]})
            print(rows[-1], flush=True)

        for way in WAYS:
            for factor in FACTORS:
                run(way, factor, CHOOSING)
        table = pandas.DataFrame(rows)
        best = table.loc[table.groupby("way")["end"].idxmin()].set_index("way")["factor"]
        for seed in SEEDS:
            for way in WAYS:
                run(way, best[way], seed)
    pandas.DataFrame(rows).to_csv(RESULTS / "black_box.csv", index=False, float_format="%.4g")
    pages.write()


if __name__ == "__main__":
    main()
