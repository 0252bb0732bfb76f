"""A census of derivatives: every plugin of Mitsuba's, every key that isas offers as an unknown.

Of each plugin's small scenes (_plugins.py), the derivative of a picture by each key: by isas (short
paths unrolled, and replayed), by Mitsuba's prb and its attached path, and by central differences
of Mitsuba's path with common random numbers. At a generic value, and in a plugin's own scene at
both ends of the range. A process for each scene, so that one that dies takes nothing with it. Rows
that are there already stay, unless --again: it can be run in pieces, and --own measures isas's
columns alone, where isas has changed. Writes derivatives.csv in results/, the page derivatives.md,
and what isas shows (isas_cli/unknowns/verdicts.csv). One to two hours on two cores.

    python benchmarks/derivatives.py [--only NAME…] [--again | --own] [--inside]
        [--jobs N] [--seeds N] [--seconds S]

NAME is a plugin, with all its scenes, or one scene.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor, as_completed
from datetime import date
from pathlib import Path

import pages
import pandas
from _derivative_verdicts import of_keys, of_words, read
from _plugins import SCENES, subject

RESULTS = Path(__file__).parent / "results" / "derivatives.csv"
VERDICTS = Path(__file__).parent.parent / "isas_cli" / "unknowns" / "verdicts.csv"
LONGEST = 1800  # seconds of one scene


def measured(scene: str, file: Path, arguments: argparse.Namespace) -> None:
    """Rows of one scene into a CSV file, as they come: in a process of its own."""
    from isas_cli.runtime import backend

    backend.start(threads=1)
    import drjit as dr
    import mitsuba as mi
    from _derivative_trial import census
    from _plugins import write

    mi.set_log_level(mi.LogLevel.Error)
    known = None
    if arguments.own:
        known = read(RESULTS)
        known = known[(known["scene"] == scene) & known["reference"].notna()]
    with tempfile.TemporaryDirectory() as folder:
        with backend.loading():
            path = write(Path(folder))[scene]
        about = {"scene": scene, "mitsuba": mi.__version__, "drjit": dr.__version__}
        about["variant"] = mi.variant()
        about["date"] = date.today().isoformat()
        ends = "-" not in scene and not arguments.inside
        rows = []
        limits = arguments.seeds, arguments.seconds, known
        for row in census(path, subject(scene), ends, *limits):
            rows.append(about | row)
            pandas.DataFrame(rows).to_csv(file, index=False)


def run(scene: str, arguments: argparse.Namespace) -> pandas.DataFrame:
    """The rows of one scene; a last one without a key where its process died, or found no key."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "rows.csv"
        call = [sys.executable, __file__, "--child", scene, str(file)]
        call += ["--seeds", str(arguments.seeds), "--seconds", str(arguments.seconds)]
        call += [f"--{name}" for name in ("own", "inside") if getattr(arguments, name)]
        try:
            done = subprocess.run(call, capture_output=True, text=True, timeout=LONGEST)
            said = ""
            if done.returncode:
                said = (done.stderr.strip().splitlines() or [f"ended with {done.returncode}"])[-1]
        except subprocess.TimeoutExpired:
            said = f"took more than {LONGEST} s"
        found = read(file) if file.exists() else pandas.DataFrame()
        if said or found.empty:
            told = {"scene": scene, "isas_said": said[:160] or "offers no unknown"}
            found = pandas.concat([found, pandas.DataFrame([told])], ignore_index=True)
        return found


def joined(rows: pandas.DataFrame) -> pandas.DataFrame:
    """In the order of the scenes; plugins of classes that are on trial elsewhere are named."""
    for name in ("plugin", "class"):
        rows = rows if name in rows else rows.assign(**{name: None})
    known = rows.dropna(subset=["plugin"]).groupby("class")["plugin"].first()
    plugin = rows["plugin"].fillna(rows["class"].map(known))
    place = {name: number for number, name in enumerate(SCENES)}
    ordered = rows.assign(plugin=plugin, place=rows["scene"].map(place))
    return ordered.sort_values("place", kind="stable").drop(columns="place")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="*", default=[], metavar="NAME")
    parser.add_argument("--again", action="store_true", help="also what is in the table already")
    parser.add_argument("--own", action="store_true", help="only what isas gives, of what is there")
    parser.add_argument("--inside", action="store_true", help="no ends of ranges")
    parser.add_argument("--jobs", type=int, default=1, help="processes at a time")
    parser.add_argument("--seeds", type=int, default=32, help="estimates at most, of each")
    parser.add_argument("--seconds", type=float, default=90, help="of a point at most")
    parser.add_argument("--child", nargs=2, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        measured(arguments.child[0], Path(arguments.child[1]), arguments)
        return
    known = read(RESULTS) if RESULTS.exists() else pandas.DataFrame({"scene": []})
    names = set(arguments.only)
    wanted = [name for name in SCENES if not names or names & {name, subject(name)}]
    there = set(known["scene"])
    if arguments.own:
        wanted = [name for name in wanted if name in there]
    elif not arguments.again:
        wanted = [name for name in wanted if name not in there]
    with ThreadPoolExecutor(arguments.jobs) as pool:
        running = {pool.submit(run, name, arguments): name for name in wanted}
        for done in as_completed(running):
            name, rows = running[done], done.result()
            known = joined(pandas.concat([known[known["scene"] != name], rows], ignore_index=True))
            known.to_csv(RESULTS, index=False, float_format="%.6g")
            print(name, len(rows), "rows", flush=True)
    of_words(of_keys(read(RESULTS))).to_csv(VERDICTS, index=False)
    pages.write()


if __name__ == "__main__":
    main()
