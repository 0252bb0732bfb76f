"""Hard cases, by isas and by Mitsuba's own derivative of whole images with the same Adam.

Runs every case of tests/support/hard_*.py both ways, a process each, and writes
results/hard_cases.csv and results/hard_cases.md. Named cases alone: the others keep their rows.

    .venv/bin/python benchmarks/hard_cases.py [CASE …]
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import pandas

RESULTS = Path(__file__).parent / "results"
SUPPORT = Path(__file__).parents[1] / "tests" / "support"
WAYS = {"isas": (), "Mitsuba": ("sampler=mitsuba",)}


def cases() -> list:
    from isas_cli.runtime import backend

    backend.start()
    sys.path.insert(0, str(SUPPORT))
    import hard_cases

    return hard_cases.everywhere()


PHOTOGRAPHS = (
    "What is said, mostly before anything is spent. Not measured: tests/scene/test_photo_*.py and "
    "tests/engine/test_photo_runs.py break sets of photographs so."
)
OF_PHOTOGRAPHS = {
    "a view of another size than its camera's": "refused: both sizes are named",
    "a mask of zeros": "refused: no pixel counts, and why",
    "a saturated view": "refused: no pixel counts, how many are saturated",
    "pixels that are NaN": "refused: how many",
    "mirrored poses, or stretched ones": "refused: the view, and which of both",
    "axes of another format": "warned: the object lies behind so many cameras",
    "a frame whose file is missing": "refused: the frame, the file",
    "NaN in a camera": "refused: the frame",
    "cameras inside the mesh": "warned: how many",
    "one view only": "ends with a smaller loss; an unknown exposure or pose is refused",
}


def one(name: str, way: str) -> dict:
    """What became of a case, in this process."""
    from isas_cli.runtime.errors import IsasError

    (case,) = (case for case in cases() if case.name == name)
    row = {"case": name, "provokes": case.provokes, "way": way, "within": case.within}
    with tempfile.TemporaryDirectory() as folder:
        try:
            run = case.run(Path(folder), *WAYS[way])
        except IsasError as error:
            words = {2: "refused", 3: "stopped: not finite"}
            return row | {"status": words[error.status]}
    last, first = run.history.iloc[-1], run.history.iloc[0]
    return row | {
        "status": run.summary["status"],
        "start": float(first["parameter_rmse"]),
        "error": float(last["parameter_rmse"]),
        "loss": float(last["loss"] / first["loss"]) if first["loss"] else 0.0,
        "nonfinite": int(last["nonfinite"]),
    }


def page(table: pandas.DataFrame) -> str:
    rows = [
        "# Hard cases",
        "",
        "<!-- Written by benchmarks/hard_cases.py from tests/support/hard_*.py. -->",
        "Each case is a run of 120 steps on a tiny scene. `error`: of the parameters, in their own "
        "unit, and the most that the tests allow. `loss`: at the end over that at the start; an "
        "estimate without bias, which noise may bring below 0. "
        "`non-finite`: entries of gradients, counted and left out. *Mitsuba*: its derivative of "
        "whole images (`sampler=mitsuba`), with the same Adam and as many steps.",
        "",
        "| case | provokes | error at the start | allowed | error | loss | non-finite | Mitsuba: "
        "error | loss | non-finite |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name, own in table.groupby("case", sort=False):
        of = {row["way"]: row for row in own.to_dict("records")}
        cells = [name, of["isas"]["provokes"]]
        start = of["isas"]["start"]
        cells += ["–" if pandas.isna(start) else f"{start:.2g}", f"{of['isas']['within']:g}"]
        for way in WAYS:
            row = of[way]
            if pandas.isna(row["error"]):
                cells += [row["status"], "–", "–"]
            else:
                cells += [f"{row['error']:.2g}", f"{row['loss']:.2g}", f"{row['nonfinite']:g}"]
        rows.append("| " + " | ".join(cells) + " |")
    rows += ["", "## Photographs", "", PHOTOGRAPHS, "", "| case | what happens |", "|---|---|"]
    rows += [f"| {case} | {told} |" for case, told in OF_PHOTOGRAPHS.items()]
    return "\n".join(rows) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", metavar="CASE")
    parser.add_argument("--one", nargs=2, metavar=("CASE", "WAY"), help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.one:
        print(json.dumps(one(*chosen.one)))
        return
    order = [case.name for case in cases()]
    unknown = set(chosen.cases) - set(order)
    if unknown:
        parser.error(f"no such case: {', '.join(sorted(unknown))}; there are: {', '.join(order)}")
    path = RESULTS / "hard_cases.csv"
    rows = pandas.read_csv(path).to_dict("records") if chosen.cases and path.exists() else []
    for name in chosen.cases or order:
        rows = [row for row in rows if row["case"] != name]
        for way in WAYS:
            command = [sys.executable, __file__, "--one", name, way]
            done = subprocess.run(command, capture_output=True, text=True, check=True)
            rows.append(json.loads(done.stdout.splitlines()[-1]))
            print(rows[-1], flush=True)
        # After each case: what is measured survives what follows.
        rows = sorted((r for r in rows if r["case"] in order), key=lambda r: order.index(r["case"]))
        table = pandas.DataFrame(rows)
        table.to_csv(path, index=False, float_format="%.4g")
        (RESULTS / "hard_cases.md").write_text(page(table), encoding="utf-8")


if __name__ == "__main__":
    main()
