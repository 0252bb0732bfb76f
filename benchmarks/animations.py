"""Start to result of one seed, methods side by side at equal billed time, each at its best rate.

A texture, a mug that turns, a shape and a volume: methods, settings and rates of the tables
(`reproduce.py`, `_plateau.py`, `shapes.py`, `volumes.py`). Writes results/<scene>_animation.webp,
pictures of view 0. Nothing is judged by them.

    .venv/bin/python benchmarks/animations.py pottery cup
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import _contest
import _plateau
import pandas
import reproduce
import shapes
import volumes
from PIL import Image, ImageSequence

from isas_cli.report.compare.animation import encoded

RESULTS = Path(__file__).parent / "results"
SEED, SNAPSHOTS = 1, 24
PICTURES = [f"frames.snapshots={SNAPSHOTS}", "frames.views=1", "report=false"]
LARGEST = 400_000  # bytes of a file


def _pottery() -> tuple[float, list[str], list[dict]]:
    own, table = reproduce.SCENES["pottery"], pandas.read_csv(RESULTS / "pottery.csv")
    rates = table.set_index("sampler")["rate"]
    methods = [{"sampler": s, "optimizer.lr": rates[s]} for s in ("uniform", "ours", "progress")]
    return own.seconds, [*reproduce.COMMON, *own.settings], methods


def _cup() -> tuple[float, list[str], list[dict]]:
    own, table = _plateau.TASKS["cup"], pandas.read_csv(RESULTS / "plateau_cup.csv")
    factors = table.set_index("method")["factor"]
    drawn = {"estimator.batch": own.pixels, "sampler.spp": own.spp}
    whole = {"estimator.batch": own.pixels * own.spp}
    ways = {"plateau": drawn | {"sampler.scheme": own.scheme}, "mitsuba": whole}
    ways["finite_differences"] = drawn
    settings = [*_plateau.COMMON, f"target.spp={own.target_spp}", "frames.spp=64"]
    settings += [f"optimizer.schedule={own.schedule}", f"optimizer.final={own.final}"]
    named = [{"sampler": n, "optimizer.factor": factors[n]} | way for n, way in ways.items()]
    return own.seconds, settings, named


def _kirby() -> tuple[float, list[str], list[dict]]:
    table, methods = pandas.read_csv(RESULTS / "shapes.csv"), shapes.methods("kirby")
    factors = table[table["scene"] == "kirby"].set_index("method")["factor"]
    shown = [f"{shapes.OURS}, uniform", f"{shapes.OURS}, ours", shapes.STOCK]
    named = [methods[name] | {"optimizer.factor": factors[name]} for name in shown]
    return float(table["seconds"].iloc[0]), shapes.SETTINGS, named


def _lego() -> tuple[float, list[str], list[dict]]:
    table, methods = pandas.read_csv(RESULTS / "volumes.csv"), volumes.methods()
    factors = table[table["scene"] == "lego"].set_index("method")["factor"]
    named = [methods[s] | {"optimizer.factor": factors[s]} for s in ("uniform", "ours", "progress")]
    seconds, _, more = volumes.SCENES["lego"]
    return seconds, [*volumes.SETTINGS, *more], named


SCENES = {"pottery": _pottery, "cup": _cup, "kirby": _kirby, "lego": _lego}


def raced(scene: str, folder: Path) -> Path:
    """The animation of the race's comparison."""
    seconds, settings, methods = SCENES[scene]()
    settings = [s for s in settings if not s.startswith(("frames.views", "frames.snap", "report"))]
    named = [(str(own["sampler"]), own) for own in methods]
    _contest.race(scene, folder, [*settings, *PICTURES], named, [SEED], seconds, lambda run: {})
    (found,) = (folder / "comparison").rglob(f"{scene}_optimisation.webp")
    return found


def smaller(animation: Path) -> bytes:
    """Of the best quality that stays below LARGEST, or the least."""
    with Image.open(animation) as opened:
        frames = [frame.convert("RGB") for frame in ImageSequence.Iterator(opened)]
    return encoded(frames, LARGEST)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", default=[*SCENES], help=f"of {', '.join(SCENES)}")
    for scene in parser.parse_args().scenes:
        with tempfile.TemporaryDirectory(prefix="isas-animations-") as root:
            made = smaller(raced(scene, Path(root) / scene))
        (RESULTS / f"{scene}_animation.webp").write_bytes(made)
        print(f"{scene}: {len(made):,} bytes", flush=True)


if __name__ == "__main__":
    main()
