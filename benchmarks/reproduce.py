"""Every scene's comparison: each sampler at its own best learning rate, at equal billed time.

The default configuration, but for textures 128 wide, a quarter of the batch, so that short budgets
hold hundreds of steps, and targets of less noise (``SCENES`` says what else). Races of a scene: all
samplers at every rate with the first seed, and those that did best at an end of the rates at the
next beyond it, up to three times; then each at its best rate, by the final parameter error, with
the other seeds, which alone are reported. Contestants take turns.

Writes for each scene results/<scene>.csv (a row per sampler), <scene>_rates.csv (the search for
rates), <scene>_errors.png (error against billed time and light paths) and <scene>_gallery.png
(target, start, result, density of `ours`); over all scenes measured so far reproduce.csv; and the
pages (`pages.py`). The whole takes hours; how many is said at the start. The same command goes on
where it was stopped, in runs/reproduce; to measure anew, name another folder (--folder) or remove
it. With a launcher the races of all scenes are handed out together.

    make reproduce SCENES="pottery bowl"
    make reproduce LAUNCHER=ray
    make reproduce LAUNCHER="submitit_slurm partition=NAME timeout_min=120"
    make reproduce SCENES="dodoco_b kirby"       shapes: see shapes.py
    make reproduce SCENES="smoke lego"           volumes: see volumes.py
    make reproduce SCENES=pbdr                   everything at once: see pbdr.py, whose other
                                                 parts are its --more, --shape and
                                                 --photographs
"""

from __future__ import annotations

import argparse
import datetime
import sys
from dataclasses import dataclass, field
from pathlib import Path

import _contest
import _gallery
import _plateau
import numpy as np
import pages
import pandas
from PIL import Image

from isas_cli import records
from isas_cli.cli.sweeps import races
from isas_cli.cli.sweeps.job import DONE
from isas_cli.runtime import images, interrupt
from isas_cli.runtime.errors import IsasError

RESULTS = Path(__file__).parent / "results"
MEASURE = "parameter_rmse"
COMMON = ["estimator.batch=16384", "target.noise=0.02", "evaluation.count=24"]
COMMON += ["evaluation.pixels=32768", "frames.views=1", "frames.snapshots=0"]
SAMPLERS = ("uniform", "relevant", "gradient", "ours", "progress")
_BEYOND = 3  # races at most with rates beyond a comparison's
_RATES = "final", "sampler", "rate"  # by which each sampler's best is told


@dataclass(frozen=True)
class Comparison:
    """``seconds``: the default budget of a run; ``settings``: beyond COMMON; ``more``: samplers
    beyond SAMPLERS; ``rates``: what each sampler's learning rate is chosen from; ``scene``: where
    a comparison is not named after its scene."""

    seconds: float
    settings: tuple[str, ...] = ("scene.arguments.texture=128",)
    more: tuple[str, ...] = field(default=())
    rates: tuple[float, ...] = (0.01, 0.02, 0.04)
    scene: str | None = None

    @property
    def samplers(self) -> list[str]:
        return [*SAMPLERS, *self.more]


SCENES = {
    "catcake": Comparison(15),
    # Where a number and a texture are unknown, what is the best resolution differs.
    "multires": Comparison(20, more=("multiresolution",)),
    "dodoco": Comparison(10),
    "pottery": Comparison(15, more=("balanced",)),
    "earth2mars": Comparison(15),
    "jumpydumpy": Comparison(15, more=("balanced",)),
    "jumpydumpy_relative": Comparison(
        12, ("scene.arguments.texture=128", "loss=relative_l2"), scene="jumpydumpy"
    ),
    # The paper's figure 6: derivative sampling throughout, a small budget.
    "trashcan": Comparison(5, ("estimator.derivative_sampling=true",)),
    "earth": Comparison(15),
    "dodoco_a": Comparison(12),
    "bowl": Comparison(15),
    "caustic_failure": Comparison(10),
}


def race(
    folder: Path, scene: str, contestants: list, seeds: list[int], seconds: float, spp: int
) -> races.Race:
    """A race of ``contestants``, (sampler, rate) each; ``spp`` of the pictures at the end."""
    own = SCENES[scene].scene or scene
    listed = ",".join(f"{{sampler:{s},optimizer.lr:{rate}}}" for s, rate in contestants)
    arguments = [f"scene={own}", *COMMON, *SCENES[scene].settings]
    arguments += [f"frames.spp={spp}", f"budget.seconds={seconds}"]
    arguments += [f"contestants=[{listed}]", f"seed=[{','.join(map(str, seeds))}]"]
    return races.planned([*arguments, f"hydra.run.dir={folder}"], f"{scene}/{folder.name}")


def runs(folder: Path) -> pandas.DataFrame:
    """One row per finished run below ``folder``: what it was, and its history
    (``_contest.counted``)."""
    rows = []
    for path in sorted(folder.rglob("summary.json")):
        run = _contest.counted(records.load(path.parent))
        history = run.history[["seconds", MEASURE, "image_rmse", "stage1_seconds", "iteration"]]
        rows.append(
            {
                "sampler": run.config["sampler"]["name"],
                "rate": float(run.config["optimizer"]["lr"]),
                "seed": int(run.config["seed"]),
                "folder": path.parent,
                "history": history,
                "final": float(history[MEASURE].iloc[-1]),
                "image": float(history["image_rmse"].iloc[-1]),
                "target_noise": run.config["target"].get("noise"),
                **{
                    key: float(run.history[key].iloc[-1])
                    for key in run.history.columns
                    if key.startswith(f"{MEASURE}/")
                },
            }
        )
    return pandas.DataFrame(rows)


def worst_twentieth(folder: Path) -> float:
    """Share of a texture's squared error that its worst 5 % of texels hold, of those that the run
    has touched; NaN without a texture."""
    shares = []
    for path in sorted((folder / "frames").glob("truth_*.exr")):
        truth, start, result = (
            images.read(path.with_name(path.name.replace("truth_", f"{name}_", 1)))
            for name in ("truth", "start", "result")
        )
        touched = np.any(result != start, axis=-1)
        error = np.sort(np.mean((result - truth) ** 2, axis=-1)[touched])[::-1]
        shares.append(error[: error.size // 20].sum() / error.sum())
    return float(np.mean(shares)) if shares else float("nan")


def table(scene: str, found: pandas.DataFrame, budget: float) -> pandas.DataFrame:
    """One row per sampler: medians over seeds, and the seeds' range as low and high."""
    first, last = (
        pandas.DataFrame([history.iloc[end] for history in found["history"]], index=found.index)
        for end in (0, -1)
    )
    found = found.join(last[[MEASURE, "image_rmse"]]).assign(
        scene=scene,
        share_of_start=last[MEASURE] / first[MEASURE],
        iterations=last["iteration"],
        stage1_share=last["stage1_seconds"] / budget,
        worst_twentieth=found["folder"].map(worst_twentieth),
    )
    found = found.sort_values("sampler", key=lambda each: each.map(SCENES[scene].samplers.index))
    keys = [name for name in found if name.startswith(f"{MEASURE}/")]
    rivals = {f"time_to_{name}": name for name in ("uniform", "relevant")}
    columns = ["target_noise", *_contest.ranged(MEASURE), "share_of_start"]
    columns += [*_contest.ranged("image_rmse"), "iterations", "stage1_share", "worst_twentieth"]
    columns += _contest.ranged(*(keys if len(keys) > 1 else ()), *rivals)
    same = ("scene", "sampler", "rate")
    return _contest.told(found, budget, columns, MEASURE, rivals, same, by="sampler")


def _every(scene: str) -> list:
    """(sampler, rate) pairs: each sampler at every rate."""
    return [(s, rate) for rate in SCENES[scene].rates for s in SCENES[scene].samplers]


def _tried(folder: Path, races: int = _BEYOND + 1) -> pandas.DataFrame:
    """The runs of a scene's first ``races`` that are for rates."""
    found = [folder / "rates", *(folder / f"rates-{n}" for n in range(1, races))]
    return pandas.concat([runs(each) for each in found if each.exists()], ignore_index=True)


def kept(scene: str, folder: Path, seed: int, seconds: float) -> pandas.DataFrame:
    """What is kept of the second race of a scene; the pictures are of ``seed``."""
    found = runs(folder)
    (errors,) = (folder / "comparison" / "plots").glob("*_errors.png")
    with Image.open(errors) as plot:
        # Few colours: a plot needs no more, and the file is a quarter as large.
        small = plot.convert("RGB").quantize(64)
        small.save(RESULTS / f"{scene}_errors.png", optimize=True)
    if SCENES[scene].scene is None:  # of a scene one is shown
        ours = found[(found["sampler"] == "ours") & (found["seed"] == seed)]
        _gallery.write(ours["folder"].iloc[0], RESULTS / f"{scene}_gallery.png")
    made = table(scene, found, seconds)
    made.to_csv(RESULTS / f"{scene}.csv", index=False, float_format="%.4g")
    return made


def raced(scenes: list[str], root: Path, chosen: argparse.Namespace) -> bool:
    """All races of each scene, and what is kept of them; whether all were held."""
    seconds = {scene: chosen.seconds or SCENES[scene].seconds for scene in scenes}

    def held(name: str, contestants: dict[str, list], seeds: list[int], spp: int) -> list[str]:
        """The scenes whose races of this ``name`` have been held."""
        jobs = {
            scene: race(root / scene / name, scene, each, seeds, seconds[scene], spp)
            for scene, each in contestants.items()
        }
        if jobs:
            races.launch(root, list(jobs.values()), chosen.launcher)
        return [scene for scene, job in jobs.items() if job.found() == DONE]

    going = held("rates", {scene: _every(scene) for scene in scenes}, chosen.seeds[:1], spp=1)
    for number in range(1, _BEYOND + 1):
        tried = {scene: _tried(root / scene, number) for scene in going}
        beyond = {scene: sorted(_contest.further(each, *_RATES)) for scene, each in tried.items()}
        there = held(f"rates-{number}", {s: b for s, b in beyond.items() if b}, chosen.seeds[:1], 1)
        going = [scene for scene in going if scene in there or not beyond[scene]]
    tried = {scene: _tried(root / scene) for scene in going}
    for scene, each in tried.items():
        shown = each.drop(columns=["folder", "history"]).sort_values(["rate", "sampler"])
        shown.to_csv(RESULTS / f"{scene}_rates.csv", index=False, float_format="%.4g")
    best = {scene: sorted(_contest.best(each, *_RATES)) for scene, each in tried.items()}
    done = held("seeds", best, chosen.seeds[1:], spp=16)
    for scene in done:
        made = kept(scene, root / scene / "seeds", chosen.seeds[1], seconds[scene])
        print(made.to_string(index=False), flush=True)
    # After each scene: what is measured survives what follows.
    found = [RESULTS / f"{name}.csv" for name in SCENES]
    tables = [pandas.read_csv(path) for path in found if path.exists()]
    if done:
        pandas.concat(tables).to_csv(RESULTS / "reproduce.csv", index=False)
        pages.write()
    return done == scenes


def forecast(scenes: list[str], chosen: argparse.Namespace) -> str:
    """What all races are billed together, those that are done included."""
    each = {s: len(_every(s)) + len(SCENES[s].samplers) * (len(chosen.seeds) - 1) for s in scenes}
    billed = sum(count * (chosen.seconds or SCENES[s].seconds) for s, count in each.items())
    together = datetime.timedelta(seconds=round(billed))
    return (
        f"scenes: {len(scenes)}, with {2 * len(scenes)} races of {sum(each.values())} runs: "
        f"{together} billed, plus targets, compiling and pictures"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "scenes", nargs="*", metavar="SCENE", help=f"of {', '.join(SCENES)}, or plateau: its tasks"
    )
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3, 4])
    parser.add_argument("--seconds", type=float, help="budget of each run, instead of the scene's")
    parser.add_argument(
        "--folder", type=Path, help="where the runs go (default: runs/reproduce); done ones stay"
    )
    parser.add_argument(
        "--launcher",
        nargs="+",
        default=[],
        metavar=("NAME", "KEY=VALUE"),
        help="what does the races, such as ray, and its settings, such as ray.remote.num_cpus=8",
    )
    chosen = parser.parse_args()
    if chosen.launcher and not set(chosen.scenes) <= set(SCENES):
        parser.error(f"--launcher: is for {', '.join(SCENES)}")
    if "plateau" in chosen.scenes:
        if chosen.scenes != ["plateau"] or chosen.seeds != parser.get_default("seeds"):
            parser.error("plateau: by itself, and its starts are not seeds: see _plateau.py --help")
        sys.argv = [sys.argv[0]]
        sys.argv += ["--seconds", str(chosen.seconds)] if chosen.seconds else []
        sys.argv += ["--folder", str(chosen.folder)] if chosen.folder else []
        _plateau.main()
        return
    import pbdr  # which look at a history as this module does
    import shapes
    import volumes

    if chosen.scenes == ["pbdr"]:
        chosen.scenes = [*pbdr.SCENES]
    for script in (shapes, volumes, pbdr):
        if chosen.scenes and set(chosen.scenes) <= set(script.SCENES):
            sys.argv = [sys.argv[0], "--scenes", *chosen.scenes]
            sys.argv += ["--seeds", *map(str, chosen.seeds)]
            sys.argv += ["--seconds", str(chosen.seconds)] if chosen.seconds else []
            script.main()
            return
    strange = [scene for scene in chosen.scenes if scene not in SCENES]
    if strange:
        others = "; or, by themselves, ".join(", ".join(s.SCENES) for s in (shapes, volumes, pbdr))
        valid = f"{', '.join(SCENES)}; or, by themselves, {others}"
        parser.error(f"{strange[0]}: no such scene; valid: {valid}")
    if len(chosen.seeds) < 2:
        parser.error("--seeds: at least two; the first is for the rates")
    name, *settings = chosen.launcher or ["basic"]
    chosen.launcher = [f"hydra/launcher={name}", *(f"hydra.launcher.{each}" for each in settings)]
    scenes = chosen.scenes or list(SCENES)
    root = chosen.folder or Path("runs/reproduce")
    RESULTS.mkdir(exist_ok=True)
    print(forecast(scenes, chosen), flush=True)
    try:
        # In turn, so that there is something to be seen; or whatever can be done side by side.
        together = [[scene] for scene in scenes] if name == "basic" else [scenes]
        held = [raced(some, root, chosen) for some in together]
    except IsasError as error:
        sys.exit(f"reproduce.py: {error}\n(here another folder is given by --folder DIR)")
    except KeyboardInterrupt:
        print("interrupted: the same command goes on", file=sys.stderr)
        sys.exit(interrupt.STATUS)
    sys.exit(not all(held))


if __name__ == "__main__":
    main()
