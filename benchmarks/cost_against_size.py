"""What a gradient step costs, against the size of the problem in five directions.

The jar of pottery at a base of 4 views of 512², a texture of 256² texels, paths of depth 3 and
65,536 pixels a step; one of these changes along each axis. Theory, where a step draws N pixels:

    pixels in all images   flat: nothing but stage 1's table of tiles, bounded, knows the films
    views                  flat
    N                      affine: launches, then a fixed cost per path
    texels T               affine: Adam visits every entry of value, gradient and moments
    path depth             affine in the edges, from 2 on as long as paths are unrolled (up to 8);
                           1 sees emitters only, with nothing to shade or differentiate; paths
                           deeper than 8 are replayed, which traces the second one twice

Flat lines go through the first point, the others are fitted (least squares of relative errors;
depth: from 2 to 8). Points further than 20 % from their line are named. A process per
point, all of one axis alive at once, measured in turns; a point is the median over the rounds with
its range. The look of stage 1 is timed beside: its share is that in a run of 1,000 iterations.
Writes results/cost_against_size.csv and .png.
"""

from __future__ import annotations

import argparse
import datetime
import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas

from isas_cli.report.figures import COLOURS, figure, log_values, save, styled

HERE = Path(__file__).parent
SAMPLERS = ("uniform", "ours")
BASE = {"views": 4, "resolution": 512, "texture": 256, "depth": 3, "batch": 65536}
SECONDS = 0.4  # for each sampler, point and round
FAR = 0.2


@dataclass(frozen=True)
class Axis:
    """``points``: the settings that change; ``size`` of a point is what theory counts; ``fitted``:
    the sizes, first and last, that an affine line is fitted to. It says nothing of smaller ones."""

    name: str
    points: list[dict]
    size: object
    label: str
    theory: str  # flat or affine
    fitted: tuple[float, float] = (0, np.inf)


def axes(quick: bool) -> list[Axis]:
    def each(name: str, values: list[int], **more) -> list[dict]:
        return [{name: value, **more} for value in (values[:3] if quick else values)]

    return [
        Axis(
            "pixels",
            each("resolution", [256, 512, 1024, 2048, 4096], views=1),
            lambda p: p["views"] * p["resolution"] ** 2,
            "pixels in one view",
            "flat",
        ),
        Axis(
            "views",
            each("views", [1, 2, 4, 8, 16, 32, 64], resolution=256),
            lambda p: p["views"],
            "views of 256²",
            "flat",
        ),
        Axis(
            "batch",
            each("batch", [1 << 10, 1 << 12, 1 << 14, 1 << 16, 1 << 18, 1 << 20]),
            lambda p: p["batch"],
            "pixels a step",
            "affine",
        ),
        Axis(
            "texels",
            each("texture", [64, 128, 256, 512, 1024, 2048, 4096]),
            lambda p: p["texture"] ** 2,
            "texels",
            "affine",
        ),
        Axis(
            "depth",
            each("depth", [1, 2, 3, 4, 6, 8, 10]),
            lambda p: p["depth"],
            "path depth",
            "affine",
            (2, 8),
        ),
    ]


class Child:
    """One point, alive for as long as its axis."""

    def __init__(self, setting: dict):
        self.setting = BASE | setting
        names = ("views", "resolution", "texture", "depth", "batch")
        sizes = [str(self.setting[name]) for name in names]
        command = [sys.executable, str(HERE / "_sized.py"), *sizes, ",".join(SAMPLERS)]
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True)

    def line(self) -> str:
        text = self.process.stdout.readline()
        if not text:
            raise SystemExit(f"{self.setting}: its process ended")
        return text

    def measure(self, seconds: float) -> list[dict]:
        print(seconds, file=self.process.stdin, flush=True)
        return [json.loads(self.line()) for _ in SAMPLERS]

    def end(self) -> None:
        self.process.stdin.close()
        self.process.wait()


def measured(axis: Axis, rounds: int, seconds: float) -> pandas.DataFrame:
    children = [Child(point) for point in axis.points]
    try:
        for child in children:
            child.line()
        rows = []
        for round_ in range(rounds):
            for child in children if round_ % 2 else reversed(children):
                size = axis.size(child.setting)
                for found in child.measure(seconds):
                    rows.append({"axis": axis.name, "size": size, "round": round_, **found})
    finally:
        for child in children:
            child.end()
    return pandas.DataFrame(rows)


def summary(axis: Axis, rows: pandas.DataFrame) -> pandas.DataFrame:
    """One row per sampler and size: median and range, ratio to the first point, theory, share of
    stage 1."""
    tables = []
    for sampler, group in rows.groupby("sampler", sort=False):
        step = group.groupby("size")["step"].agg(["median", "min", "max"])
        look = (group["look"] * group["looks"]).groupby(group["size"]).median()
        sizes, times = step.index.to_numpy(float), step["median"].to_numpy()
        if axis.theory == "flat":
            step["theory"] = times[0]
        else:
            first, last = axis.fitted
            used = (sizes >= first) & (sizes <= last)
            line = np.polyfit(sizes[used], times[used], 1, w=1 / times[used])
            step["theory"] = np.where(sizes >= first, np.polyval(line, sizes), np.nan)
        step["ratio_to_first"] = times / times[0]
        step["stage1_share"] = look / (look + step["median"])
        step.insert(0, "sampler", sampler)
        tables.append(step.reset_index())
    return pandas.concat(tables, ignore_index=True)


def report(axis: Axis, table: pandas.DataFrame) -> None:
    """The figures, and where they are not what theory says."""
    print(f"{axis.label} ({axis.theory} in theory)")
    for row in table.itertuples():
        off = row.median / row.theory - 1
        far = f"  {off:+.0%} off theory" if abs(off) > FAR else ""
        print(
            f"  {row.sampler:8s} {row.size:9d}: {1e3 * row.median:8.2f} ms "
            f"({1e3 * row.min:.2f} … {1e3 * row.max:.2f}), {row.ratio_to_first:6.2f} of the first, "
            f"stage 1 {row.stage1_share:.1%}{far}"
        )


def draw(all_axes: list[Axis], tables: list[pandas.DataFrame], path: Path) -> None:
    """Five panels: points with their range, and theory's lines."""
    with styled():
        canvas = figure(17, 3.6)
        panels = canvas.subplots(1, len(all_axes))
        for axis, table, panel in zip(all_axes, tables, panels):
            for colour, (sampler, group) in zip(COLOURS, table.groupby("sampler", sort=False)):
                middle = 1e3 * group["median"]
                span = [middle - 1e3 * group["min"], 1e3 * group["max"] - middle]
                panel.errorbar(group["size"], middle, span, fmt="o", color=colour, label=sampler)
                panel.plot(group["size"], 1e3 * group["theory"], color=colour, linewidth=1)
            if axis.name != "depth":
                panel.set_xscale("log", base=2)
            if axis.name in ("batch", "texels"):
                log_values(panel, 1e3 * table[["min", "max"]].to_numpy())
            else:
                panel.set_ylim(bottom=0)
            panel.set_xlabel(axis.label)
        panels[0].set_ylabel("milliseconds per step")
        panels[0].legend(title="lines: theory")
        save(canvas, path)


def main() -> None:
    import pages  # knows this module

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--quick", action="store_true", help="three points an axis, two rounds")
    parser.add_argument("--folder", type=Path, help="default: results, if not quick")
    chosen = parser.parse_args()
    rounds, seconds, folder = chosen.rounds, SECONDS, chosen.folder
    if chosen.quick:
        rounds, seconds = 2, 0.1
    elif folder is None:
        folder = HERE / "results"
    rows, tables = [], []
    for axis in axes(chosen.quick):
        rows.append(measured(axis, rounds, seconds))
        tables.append(summary(axis, rows[-1]))
        report(axis, tables[-1])
    if folder is not None:
        folder.mkdir(exist_ok=True)
        table = pandas.concat(rows).assign(day=datetime.date.today().isoformat())
        table.to_csv(folder / "cost_against_size.csv", index=False, float_format="%.6f")
        pages.write()
        draw(axes(chosen.quick), tables, folder / "cost_against_size.png")


if __name__ == "__main__":
    main()
