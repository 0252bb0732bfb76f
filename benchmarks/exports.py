"""Does `isas export` write what was found? Every key of every plugin's scene (`_plugins.py`) gets
another value, the result is exported, rendered by Mitsuba alone in a process without isas, and
compared with the picture of isas's own scene at that value, with the same random numbers.

    python benchmarks/exports.py [NAME…]

writes results/exports.csv, a row a key, and exports.md; with names, the rows of these scenes anew.
Takes about half an hour; a scene that breaks its process leaves a row that says so.
"""

from __future__ import annotations

import datetime
import os
import subprocess
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path

import _page_exports
import _plugins
import _rows
import numpy as np
import pages
import pandas
from _plugin_scenes import SCENES

HERE = Path(__file__).parent
TABLE = HERE / "results" / "exports.csv"
SPP = 64
# Of the mean of the picture: how far two pictures of one scene lie apart by rounding, at most.
SAME = 1e-3
SECONDS = 900
COLUMNS = ["scene", "key", "kind", "verdict", "apart", "changed", "told", "mitsuba", "date"]


def other(kind) -> np.ndarray:
    """Another value of an unknown than the scene's, legal, and different entry by entry."""
    present, (low, high) = kind.present, kind.range
    random = np.random.default_rng(7).uniform(0.5, 1, present.shape)
    if np.isfinite(low) and np.isfinite(high):
        end = np.where(present < (low + high) / 2, high, low)
        found = present + 0.4 * random * (end - present)
    elif kind.moves_geometry:
        found = present + 0.1 * random
    else:
        found = present * (1 + 0.4 * random) + 0.05 * random
    return found.astype(np.float32)


def child(name: str, folder: Path) -> None:
    """Exports each key's other value into a folder of its number, with the picture that isas's
    scene shows at it."""
    from isas_cli.runtime import backend

    backend.start()
    import mitsuba as mi

    from isas_cli.config.schema import SceneConfig, UnknownConfig
    from isas_cli.runtime.errors import InputError
    from isas_cli.scene import export, instances, scene_file
    from isas_cli.unknowns import registry
    from isas_cli.unknowns.kind import Loaded

    with backend.loading():
        path = _plugins.write(folder / "files")[name]

    def loaded() -> tuple[mi.Scene, mi.SceneParameters]:
        """With the file's own integrator, as the export has it."""
        with backend.loading():
            scene, _ = instances.instantiate(*scene_file.parse(str(path)))
        return scene, mi.traverse(scene)

    scene, params = loaded()
    try:
        before = np.array(mi.render(scene, spp=SPP, seed=1))
    except RuntimeError as error:
        told = " ".join(str(error.__cause__ or error).split()).partition(". ")[0]
        _rows.emit({"scene": name, "key": None, "dark": told})
        return
    for number, (key, made) in enumerate(registry.offered(Loaded(params)).items()):
        kind = made(key, Loaded(params))
        value, own = other(kind), folder / str(number)
        row = {"scene": name, "key": key, "kind": made.name, "folder": str(own)}
        config = SceneConfig(name="file", path=str(path), unknowns={key: UnknownConfig(start=0)})
        try:
            written, _ = export.write(config, {key: value}, own)
        except InputError as error:
            _rows.emit({**row, "refused": str(error)})
            continue
        # Anew: a mesh that was moved and moved back has other normals.
        scene, params = loaded()
        parameters: dict = {}
        kind.write(kind.value(value), parameters)
        for each, new in parameters.items():
            params[each] = new
        params.update()
        picture = np.array(mi.render(scene, spp=SPP, seed=1))
        np.save(own / "wanted.npy", picture)
        apart = float(np.abs(picture - before).mean() / np.abs(before).mean())
        _rows.emit({**row, "written": str(written), "changed": apart})


def judged(row: dict) -> dict:
    """The row of the table for what a child told of a key."""
    found = {column: row.get(column) for column in COLUMNS}
    if "refused" in row:
        return {**found, "verdict": "refused", "told": row["refused"]}
    if "dark" in row:
        return {**found, "verdict": "Mitsuba cannot render the scene", "told": row["dark"]}
    picture = Path(f"{row['written']}.npy")
    if not picture.exists():
        reason = Path(f"{row['written']}.txt")
        told = reason.read_text(encoding="utf-8") if reason.exists() else "its process ended"
        return {**found, "verdict": "not rendered", "told": told.replace(row["folder"], "")}
    wanted, got = np.load(Path(row["folder"]) / "wanted.npy"), np.load(picture)
    apart = float(np.abs(got - wanted).mean() / max(np.abs(wanted).mean(), 1e-9))
    return {**found, "apart": apart, "verdict": "same" if apart < SAME else "differs"}


def measured(name: str) -> list[dict]:
    """The rows of one scene."""
    from isas_cli.runtime import llvm

    with tempfile.TemporaryDirectory(prefix="isas-exports-") as made:
        command = [sys.executable, __file__, "--child", name, made]
        try:
            done = subprocess.run(command, stdout=subprocess.PIPE, text=True, timeout=SECONDS)
        except subprocess.TimeoutExpired:
            return [{"scene": name, "key": None, "verdict": "its process hung"}]
        rows = _rows.read(done.stdout)
        files = [row["written"] for row in rows if "written" in row]
        env = {**os.environ, "DRJIT_LIBLLVM_PATH": str(llvm.find().path)}
        plain = [sys.executable, str(HERE / "_plain_mitsuba.py"), "llvm_ad_rgb", str(SPP), *files]
        subprocess.run(plain, env=env, stdout=subprocess.DEVNULL, check=False)
        found = [judged(row) for row in rows]
    if done.returncode:
        found.append(
            {"scene": name, "key": None, "verdict": "its process ended", "told": done.returncode}
        )
    return found


def main(names: list[str]) -> None:
    rows = pandas.DataFrame(columns=COLUMNS)
    if TABLE.exists():
        rows = _page_exports.read(TABLE)
    made = {"mitsuba": version("mitsuba"), "date": datetime.date.today().isoformat()}
    for name in names or SCENES:
        found = [{**row, **made} for row in measured(name)]
        kept = rows[rows["scene"] != name].to_dict("records")
        rows = pandas.DataFrame([*kept, *found], columns=COLUMNS)
        order = {scene: place for place, scene in enumerate(SCENES)}
        rows = rows.sort_values("scene", key=lambda column: column.map(order), kind="stable")
        rows.to_csv(TABLE, index=False, float_format="%.3g")
        told = [f"{row['key']}: {row['verdict']} {row.get('told') or ''}" for row in found]
        print(name, *(line for line in told if ": same" not in line), sep="\n  ", flush=True)
    pages.write()


if __name__ == "__main__":
    if sys.argv[1:2] == ["--child"]:
        child(sys.argv[2], Path(sys.argv[3]))
    else:
        main(sys.argv[1:])
