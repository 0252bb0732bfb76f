"""Everything at once: the PBDR paper's tables on scenes that pose its problems.

On each of three scenes: the full method (`ours`, with smoothed gradients and the prior on
materials), the same without either part and without both, other samplers without both, and
Mitsuba's own loop (`sampler=mitsuba`), at four factors on the scene's rates each with the first
seed, and at one beyond where the best was the last or the first, then each at its best with three
others, which alone are reported. Where all unknowns are numbers there is nothing to smooth over,
and the methods that differ by it alone are left out. The paper's other rival, a mesh rasteriser, is
left out throughout.

Measures: RE, its Eq. (7), 3 x the squared image error; MPEA, Eq. (8), the mean over the unknown
materials of their squared error (of lights not); CS, iterations after which RE stays within a tenth
of where it ends; GN, Eq. (9), the mean over the run, in the gradients' own unit. And what the
result is good for: PSNR and SSIM of views between those given, and of these under another
light, which the run has not seen.

Writes results/pbdr.csv (a row per scene and method), pbdr_rates.csv, pbdr_<scene>.png (image error
against billed time) and the page pbdr.md.

With `--more`: the samplers that are left, and blurred parameters (`estimator.blurred`, of all
unknowns, whose width falls from 0.05 to a tenth of it: much for a colour, little for the lamp of
`room_joint`), beside `ours` anew, all without the paper's parts; and `ours` with the prior alone,
as it is and where the mean roughness of the scene is known to it. Writes results/pbdr_more.csv and
pbdr_more_rates.csv.

With `--shape`: `object_joint_shape`, whose vertices are unknown as well: silhouettes with drawn
pixels (`ours`), with both of the paper's parts, with either and with none, and with uniform ones,
and Mitsuba's projective loop, all in the stages of the scene's configuration; and `ours` with
everything moving from the start. Writes results/pbdr_shape.csv and pbdr_shape_rates.csv.

With `--photographs`: `materials_joint` from pictures that another renderer has made and a camera
taken (`_photographed_materials.py`), its base table with fewer samplers. RE holds their noise.
Writes results/pbdr_photographs.csv and pbdr_photographs_rates.csv.

    make reproduce SCENES=pbdr
    .venv/bin/python benchmarks/pbdr.py --more
    .venv/bin/python benchmarks/pbdr.py --shape
    .venv/bin/python benchmarks/pbdr.py --photographs
"""

from __future__ import annotations

import argparse
import importlib
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import _contest
import _photographed_materials
import numpy as np
import pages
import pandas
from omegaconf import OmegaConf

from isas_cli import records

RESULTS = Path(__file__).parent / "results"
ERROR, FULL, PLAIN, STOCK = "image_rmse", "full", "ours", "Mitsuba's loop"
SCENES = {"object_joint": 8.0, "room_joint": 8.0, "materials_joint": 6.0}  # billed seconds
LIGHTS = ("sky", "lamp")
SMOOTHING, WEIGHT = 0.02, 0.001
BLUR = {"start": 0.05, "end": 0.005}
FACTORS = (0.3, 1.0, 3.0, 10.0)  # of the scene's rates
SETTINGS = ["estimator.batch=16384", "target.noise=0.01", "evaluation.count=24", "effects=full"]
SETTINGS += ["optimizer.schedule=exponential", "evaluation.pixels=32768", *_contest.QUIET]
# Where an image's noise is larger than what runs leave of its error.
NOISY = ["evaluation.spp=16", "evaluation.count=12"]
# A lamp's fireflies: a noise of 0.01 would take ten minutes.
MORE = {"materials_joint": NOISY, "room_joint": [*NOISY, "target.noise=0.02"]}
SPP = 32  # of the pictures from elsewhere; result and truth with the same random numbers
# What a prior that knew would expect: the mean of the scene's true roughnesses.
EXPECTED = {"object_joint": 0.2, "room_joint": 0.2333, "materials_joint": 0.25}


# Where nothing is said of smoothing there is none; and the papers' estimator.
UNFILTERED = {"optimizer.filter": "none"}
PAPERS = {"estimator.crossed": "false"} | UNFILTERED


def more(scene: str) -> tuple[list[str], dict[str, dict]]:
    """Settings of all, and of each by name."""
    names = (PLAIN, "gradient", "balanced", "joint", "preconditioned")
    each = {name: {"sampler": name} | PAPERS for name in names}
    each["blurred parameters"] = {"sampler": PLAIN, "estimator.blurred": "true"} | PAPERS
    each["prior"] = {"sampler": PLAIN} | PAPERS | PRIOR
    each["prior, known"] = each["prior"] | {"prior.expected": EXPECTED[scene]}
    return [f"scene.unknowns={json.dumps(specs(scene, blur=BLUR))}"], each


def specs(scene: str, **changed) -> dict[str, dict]:
    """The scene's unknowns as its configuration has them, but for what is ``changed`` of all."""
    from isas_cli.config.compose import compose

    found = OmegaConf.to_container(compose([f"scene={scene}"]).scene.unknowns, resolve=True)
    return {
        key: {k: v for k, v in (each | changed).items() if v is not None}
        for key, each in found.items()
    }


PRIOR = {"prior": "materials"} | {
    f"prior.{name}": WEIGHT for name in ("smooth", "metallic", "roughness")
}
SMOOTH = {"optimizer.filter": "gaussian", "optimizer.filter.width": SMOOTHING}


def methods(scene: str) -> dict[str, dict]:
    """Settings by name."""
    ours = {"sampler": "ours"} | PAPERS
    others = {name: {"sampler": name} | PAPERS for name in ("uniform", "relevant", "progress")}
    others[STOCK] = {"sampler": "mitsuba"} | UNFILTERED
    if scene != "object_joint":
        return {FULL: ours | PRIOR, PLAIN: ours, **others}
    parts = {
        FULL: ours | PRIOR | SMOOTH,
        "without smoothing": ours | PRIOR,
        "without the prior": ours | SMOOTH,
    }
    return {**parts, PLAIN: ours, **others}


def measured(run: records.Run) -> dict:
    history = run.history
    first, last = history.iloc[0], history.iloc[-1]
    errors = apart(run)
    materials = {k: v for k, v in errors.items() if ".bsdf" in k}
    colours = [k for k in materials if any(w in k for w in ("diffuse", "color", "reflectance"))]
    rough = [k for k in materials if any(w in k for w in ("roughness", "alpha"))]
    counted = history.assign(seconds=history["iteration"])
    return {
        "start": first[ERROR],
        ERROR: last[ERROR],
        "re": 3 * last[ERROR] ** 2,
        "mpea": np.mean(np.square(list(materials.values()))),
        "cs": _contest.reached(counted, np.sqrt(1.1) * last[ERROR], ERROR),
        "gn": history["gradient_noise"].mean(),
        "colour": np.mean([last.get(f"value/{k}/scaled", errors[k]) for k in colours]),
        "roughness": np.mean([errors[k] for k in rough]),
        "iterations": int(last["iteration"]),
    }


def apart(run: records.Run) -> dict[str, float]:
    """How far each unknown ends from its truth, root mean square; of photographs, which tell none,
    from that of the scene that they were taken of."""
    last, scene = run.history.iloc[-1], run.config["scene"]
    if not scene["targets"]:
        return {key: last[f"parameter_rmse/{key}"] for key in scene["unknowns"]}
    _, unknowns, values = _moved(run, relit=False)
    found = {key: np.array(values[key]) - np.array(x) for key, x in unknowns.truths().items()}
    return {key: float(np.sqrt(np.mean(np.square(each)))) for key, each in found.items()}


PHOTOGRAPHED = _photographed_materials.SCENE


def photographs(seeds: list[int], seconds: float) -> tuple[pandas.DataFrame, pandas.DataFrame]:
    """A row for each method on PHOTOGRAPHED: medians and ranges; and the search for its rates."""
    contestants = methods(PHOTOGRAPHED)
    contestants = {name: contestants[name] for name in (FULL, PLAIN, "uniform", "progress", STOCK)}
    with tempfile.TemporaryDirectory(prefix="isas-pbdr-") as root:
        folder = Path(root) / "pictures"
        subprocess.run([sys.executable, _photographed_materials.__file__, folder], check=True)
        pictures = ",".join(map(str, sorted(folder.glob("*.exr"))))
        settings = [each for each in SETTINGS if not each.startswith("target.")]
        settings += [*NOISY, f"scene.targets=[{pictures}]"]
        where = PHOTOGRAPHED, Path(root), settings, contestants, FACTORS
        first, found = _contest.judged(*where, seeds, seconds, measured, ERROR, 1)
        return table(found, seconds), first


SHAPE, SHAPE_SECONDS = "object_joint_shape", 12.0


def shape_methods() -> dict[str, dict]:
    """Settings by name."""
    own = {"estimator": "silhouettes", "estimator.batch": 16384} | UNFILTERED
    ours = own | {"sampler": PLAIN}
    found = {FULL: ours | PRIOR | SMOOTH}
    found |= {"without smoothing": ours | PRIOR, "without the prior": ours | SMOOTH}
    found |= {name: own | {"sampler": name} for name in (PLAIN, "uniform")}
    stock = {"sampler": "mitsuba", "sampler.silhouettes": "direct"} | UNFILTERED
    return found | {STOCK: stock}


def shape_measured(run: records.Run) -> dict:
    history = run.history
    first, last = history.iloc[0], history.iloc[-1]
    bsdf = "parameter_rmse/figure.bsdf"
    own = measured(run)
    return {name: own[name] for name in ("re", "mpea", "cs", "gn")} | {
        "start": first["parameter_rmse/figure.vertices"],
        "chamfer": last["parameter_rmse/figure.vertices"],
        "normals": last["value/figure.vertices/normals"],
        "specular": last[f"{bsdf}.specular.value"],
        "roughness": last[f"{bsdf}.roughness.value"],
        "sky": last["parameter_rmse/sky.data"],
        ERROR: last[ERROR],
        "iterations": int(last["iteration"]),
    }


def shapes(seeds: list[int], seconds: float) -> tuple[pandas.DataFrame, pandas.DataFrame]:
    """A row for each method on SHAPE: medians and ranges; and the search for its rates."""
    settings = ["evaluation.count=8", *_contest.QUIET, "~scene.method"]
    at_once = json.dumps(specs(SHAPE, during=None))
    found = []
    own = {"ours, all at once": shape_methods()[PLAIN]}
    sides = ((shape_methods(), settings), (own, [*settings, f"scene.unknowns={at_once}"]))
    for contestants, chosen in sides:
        with tempfile.TemporaryDirectory(prefix="isas-pbdr-") as root:
            where = SHAPE, Path(root), chosen, contestants, FACTORS[:3]
            found.append(_contest.judged(*where, seeds, seconds, shape_measured, ERROR, 1))
    first, found = (pandas.concat(each) for each in zip(*found))
    columns = ["start", *_contest.ranged("chamfer", ERROR, "re", "mpea", "cs"), "gn"]
    columns += ["normals", "specular", "roughness", "sky"]
    return _contest.told(found, seconds, [*columns, "iterations"]), first


MEASURES = ("re", "mpea", "cs", "gn", "colour", "roughness")


def table(found: pandas.DataFrame, seconds: float) -> pandas.DataFrame:
    """Medians; ``time_to_stock`` and ``time_to_plain``: shares of the budget to the median final
    image error of Mitsuba's loop and of `ours` without the paper's parts."""
    rivals = {"time_to_stock": STOCK, "time_to_plain": PLAIN}
    rivals = {column: name for column, name in rivals.items() if name in set(found["method"])}
    seen = pandas.DataFrame([elsewhere(each) for _, each in found.iterrows()])
    columns = ["start", ERROR, "iterations", *_contest.ranged(*MEASURES), *rivals, *seen]
    columns += [f"{name}_psnr_{end}" for name in ("novel", "relit") for end in ("low", "high")]
    return _contest.told(found.join(seen), seconds, columns, ERROR, rivals)


def elsewhere(row: pandas.Series) -> dict[str, float]:
    """Means over views that no run has seen: ``novel_psnr``, … and ``relit_psnr``, …"""
    import mitsuba as mi

    from isas_cli.runtime import likeness

    found = {}
    for kind in ("novel", "relit"):
        scene, unknowns, values = _moved(records.load(row["folder"]), kind == "relit")
        pictures = []
        for each in (unknowns.truths(), values):
            unknowns.write(each)
            views = range(len(scene.sensors()))
            pictures.append([np.array(mi.render(scene, sensor=v, spp=SPP, seed=v)) for v in views])
        each = [
            likeness.metrics(image, truth, np.ones(truth.shape[:2]))
            for truth, image in zip(*pictures)
        ]
        for name in each[0]:
            found[f"{kind}_{name}"] = np.mean([one[name] for one in each])
    return found


def _moved(run: records.Run, relit: bool):
    """The run's scene from elsewhere, its unknowns but for lights that were replaced, and their
    values where the run ended."""
    import mitsuba as mi

    from isas_cli.config.schema import UnknownConfig
    from isas_cli.scene import phong  # noqa: F401  (registers it)
    from isas_cli.unknowns.specs import parse
    from isas_cli.unknowns.unknowns import Unknowns

    scene = run.config["scene"]
    module, build = scene["builder"].rsplit(".", 1)
    made = getattr(importlib.import_module(module), build)(**scene["arguments"])
    made = {k: v for k, v in made.items() if not k.startswith("sensor_")} | _views(scene["name"])
    if relit:
        made |= _light(scene["name"], made)
    specs = {
        key: UnknownConfig(start=spec["start"], range=spec["range"])
        for key, spec in scene["unknowns"].items()
        if not (relit and key.partition(".")[0] in LIGHTS)
    }
    loaded = mi.load_dict(made, optimize=False)
    unknowns = Unknowns(mi.traverse(loaded), parse(mi.traverse(loaded), specs, True))
    return loaded, unknowns, unknowns.values_of({k: run.parameters()[k] for k in unknowns.keys})


def _views(scene: str) -> dict:
    from isas_cli.scenes.cameras import perspective, spiral
    from isas_cli.scenes.cornell import LOOK_AT

    if scene == "room_joint":
        at = [[-0.4, 1.2, 3.4], [0.1, 0.5, 3.6], [0.5, 1.5, 3.3]]
        return {
            f"sensor_{view:03d}": perspective(place, LOOK_AT, 34.0, 192)
            for view, place in enumerate(at)
        }
    if scene == "materials_joint":
        return spiral(3, 192, (0.0, 0.25, 0.0), 4.2, 28.0, (20.0, 45.0), azimuth=60.0)
    return spiral(3, 192, (0.0, 0.3, 0.0), 3.2, 30.0, (-10.0, 45.0), azimuth=60.0)


def _light(scene: str, made: dict) -> dict:
    import mitsuba as mi
    from isas_cli.scenes import library

    if scene != "room_joint":
        return {"sky": library.environment("hdri/forest.exr")}
    place = mi.ScalarTransform4f().translate([0.6, 1.995, 0.8]).rotate([1, 0, 0], 90)
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": [14.0, 14.0, 14.0]}}
    return {"lamp": made["lamp"] | {"to_world": place.scale([0.35, 0.35, 1]), "emitter": emitter}}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, help="budget of each run, instead of the scene's")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3, 4])
    parser.add_argument("--scenes", nargs="+", default=[*SCENES])
    parser.add_argument("--more", action="store_true", help="the samplers that are left")
    parser.add_argument("--shape", action="store_true", help=f"{SHAPE} alone")
    parser.add_argument("--photographs", action="store_true", help=f"{PHOTOGRAPHED} from pictures")
    chosen = parser.parse_args()
    suffix = "_more" if chosen.more else ""
    from isas_cli.runtime import backend

    backend.start()
    if chosen.shape or chosen.photographs:
        if chosen.shape:
            name, usual, measure = "pbdr_shape", SHAPE_SECONDS, shapes
        else:
            name, usual, measure = "pbdr_photographs", SCENES[PHOTOGRAPHED], photographs
        made, first = measure(chosen.seeds, chosen.seconds or usual)
        print(made.to_string(index=False), flush=True)
        _contest.write(RESULTS / f"{name}.csv", made)
        _contest.write(RESULTS / f"{name}_rates.csv", first)
        return pages.write()
    for scene in chosen.scenes:
        seconds = chosen.seconds or SCENES[scene]
        with tempfile.TemporaryDirectory(prefix="isas-pbdr-") as root:
            own, contestants = more(scene) if chosen.more else ([], methods(scene))
            settings = SETTINGS + MORE.get(scene, []) + own
            first, found = _contest.judged(
                *(scene, Path(root), settings, contestants, FACTORS),
                *(chosen.seeds, seconds, measured, ERROR, 1),
            )
            if not chosen.more:
                _contest.draw(found, RESULTS / f"pbdr_{scene}.png", ERROR, "image error")
            # After each scene: what is measured survives what follows.
            made = table(found, seconds)
        print(made.to_string(index=False), flush=True)
        _contest.write(RESULTS / f"pbdr{suffix}.csv", made)
        _contest.write(RESULTS / f"pbdr{suffix}_rates.csv", first)
        pages.write()


if __name__ == "__main__":
    main()
