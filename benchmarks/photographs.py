"""What photographs tell, of pictures that nothing of isas has made (`_drawn_box.py`), colours
unknown: poses and shapes; lenses, exposures, poses of views, and colours against Mitsuba's loop.

Of poses and shapes: each case with what its outline says by itself, by alpha, masks or edges, and
by the colours alone (`estimator.outline=0`, everything unknown from the start); three seeds, of
edges over clutter eight other walls and turns. Both sides have the rates of the defaults. Writes
results/photographs.csv, a row a run: degrees, share of the size, and shift by which a pose is off,
or the chamfer distance over that of the start.

Of pictures alone, twelve with alpha of which three are held out: shape, colours and light from a
hull, beside Mitsuba's loop. Writes results/photographs_hull.csv, a row a run: the chamfer distance
over that of the start, and of the views held out PSNR, SSIM and FLIP.

Of views: twelve pictures, of which three are held out, at the object's true pose; with what is
unknown of them, and as the file says. Writes results/photographs_views.csv, a row a run: PSNR, SSIM
and FLIP of the views held out, and by how much focal length (a share), principal point (pixels), k
and exposures (the largest share) are off.

    .venv/bin/python benchmarks/photographs.py [poses] [hull] [views]
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import _drawn_box as box
import numpy as np
import pages
import pandas
import trimesh

import isas_cli
from isas_cli.scene.shape_error import Sampled, apart

RESULTS = Path(__file__).parent / "results"
SECONDS = 20
QUIET = ["frames.views=0", "frames.snapshots=0", "report=false", "evaluation.count=4"]
COLOUR = "object.bsdf.brdf_0.base_color.data: {start: 0.5, during: [0.0, 1.0]}"
# By case: how the object ends, whether its pose is unknown (else its shape), the seeds.
CASES = {
    "pose, alpha": ("alpha", True, (1, 2, 3)),
    "pose, masks of whole pixels": ("masks", True, (1, 2, 3)),
    "pose, one picture over clutter": ("none", True, tuple(range(1, 9))),
    "shape from a sphere, alpha": ("alpha", False, (1, 2, 3)),
}
HULL = "pictures alone"
WAYS = "its outline", "colours alone"

AS_TOLD = "as the file says"
LENS, SHORT = (2.0, -1.5, 0.1), 1 / 1.05
EXPOSURES = (1.0, 0.4, 1.2, 0.8, 0.6, 1.1, 0.5, 0.9, 1.2, 0.7, 0.45, 1.0)
# By case: what the pictures have that their file does not say; ways, with what is set.
SAYS = {AS_TOLD: []}
STOCK = {"sampler=mitsuba": ["sampler=mitsuba"]}
REFINED = SAYS | {"photos.refine=true": ["photos.refine=true"]}
VIEWS = {
    "lens: 5 % longer, principal point 2.5 pixels off, k = 0.1": (
        {"lens": LENS, "focals": SHORT},
        {
            AS_TOLD: ["photos.background=black"],
            "photos.lens": ["photos.background=black", "photos.lens=[focal,centre,radial]"],
            "photos.lens, background=false": ["photos.lens=[focal,centre,radial]"],
        },
    ),
    "poses of all views off by 1.5 pixels": ({"turned": 1.5}, REFINED),
    "poses right": ({}, REFINED),
    "exposures of 0.4 to 1.2": (
        {"exposures": EXPOSURES},
        {"photos.exposure=scale": ["photos.exposure=scale"]},
    ),
    "colours alone": ({}, SAYS | STOCK),
}


def run(folder: Path, settings: list[str], seed: int):
    own = [f"photos.path={folder}", f"seed={seed}", f"budget.seconds={SECONDS}"]
    out = f"hydra.run.dir={folder / 'run'}"
    return isas_cli.run("scene=photos", *own, *QUIET, *settings, out, "overwrite=true")


def chamfer(folder: Path) -> float:
    """Of the result, over the start's."""
    truth = trimesh.creation.box(2 * box.HALF)
    truth = Sampled.of(np.asarray(truth.vertices), np.asarray(truth.faces))
    far = []
    for name in ("result", "start"):
        mesh = trimesh.load(folder / f"run/meshes/{name}_object.vertices.ply", process=False)
        far.append(apart(Sampled.of(np.asarray(mesh.vertices), mesh.faces), truth)["chamfer"])
    return far[0] / far[1]


def posed(folder: Path, outline: str, way: str, seed: int) -> dict:
    cluttered = outline == "none"
    axis = np.random.default_rng(seed).normal(size=3) if cluttered else (0.6, 0.7, -0.39)
    by = (5, 1.0) if cluttered else (10, 1.12)
    corners = box.turned_mesh(folder / "box.obj", *by, axis)
    settings = [f"photos.mesh={folder / 'box.obj'}", "photos.pose=true"]
    settings += [f"photos.environment={folder / 'white.png'}"]
    if not cluttered:
        settings.append("photos.background=black")
    if way == WAYS[1]:
        settings += ["estimator.outline=0", f"scene.unknowns={{{COLOUR}}}"]
    elif cluttered:
        settings.append("photos.edges=true")
    found = box.off(run(folder, settings, seed).parameters(), corners)
    return dict(zip(("degrees", "size", "shift"), found))


def shaped(folder: Path, way: str, seed: int) -> dict:
    trimesh.creation.icosphere(4, 0.35).export(folder / "ball.obj")
    during = "" if way == WAYS[0] else ", during: [0.0, 1.0]"
    colour = f"object.bsdf.brdf_0.base_color.value: {{start: 0.5{during}}}"
    settings = [f"photos.mesh={folder / 'ball.obj'}", "photos.background=black"]
    settings += [f"photos.environment={folder / 'white.png'}", "estimator=silhouettes"]
    settings += ["sampler=ours", f"scene.unknowns={{object.vertices: {{lr: 0.005}}, {colour}}}"]
    settings += [] if way == WAYS[0] else ["estimator.outline=0"]
    run(folder, settings, seed)
    return {"chamfer": chamfer(folder)}


def seen(folder: Path, settings: list[str], seed: int) -> dict:
    """Of the box at its true pose."""
    box.turned_mesh(folder / "box.obj", 0, 1)
    known = [f"photos.mesh={folder / 'box.obj'}", f"photos.environment={folder / 'white.png'}"]
    summary = run(folder, [*known, "photos.test=4", "photos.texture=64", *settings], seed).summary
    found = dict(summary["held_out"]["mean"])
    for lens in summary.get("lens", {}).values():
        found["focal"] = abs(lens["focal"] / box.FOCAL - 1)
        off = lens["centre_x"] - LENS[0], lens["centre_y"] - LENS[1]
        found |= {"centre": float(np.hypot(*off)), "radial": abs(lens["radial"] - LENS[2])}
    for name, told in summary.get("exposure", {}).items():
        off = abs(np.ravel(told)[0] / EXPOSURES[int(name.partition(".")[0])] - 1)
        found["exposure"] = max(found.get("exposure", 0.0), float(off))
    return found


def views(made: Path) -> pandas.DataFrame:
    rows = []
    for number, (case, (pictures, ways)) in enumerate(VIEWS.items()):
        for seed in (1, 2, 3):
            folder = made / f"views-{number}-{seed}"
            box.photographed(folder, 12, "alpha", seed=seed, **pictures)
            for way, settings in ways.items():
                found = seen(folder, settings, seed)
                rows.append({"case": case, "by": way, "seed": seed, **found})
                print(rows[-1], flush=True)
    return pandas.DataFrame(rows)


def poses(made: Path) -> pandas.DataFrame:
    rows = []
    for case, (outline, posing, seeds) in CASES.items():
        for seed in seeds:
            cluttered = outline == "none"
            folder = made / (f"{outline}{seed}" if cluttered else outline)
            if not folder.exists():
                count, scale = (1, 4) if cluttered else (8, 1)
                box.photographed(folder, count, outline, scale, seed)
            for way in WAYS:
                known = (folder, outline, way, seed) if posing else (folder, way, seed)
                found = (posed if posing else shaped)(*known)
                rows.append({"case": case, "by": way, "seed": seed, **found})
                print(rows[-1], flush=True)
    return pandas.DataFrame(rows)


def hull(made: Path) -> pandas.DataFrame:
    rows = []
    for seed in (1, 2, 3):
        folder = made / f"hull-{seed}"
        box.photographed(folder, 12, "alpha", seed=seed)
        for way, settings in ({"isas": []} | STOCK).items():
            held = run(folder, ["photos.test=4", *settings], seed).summary["held_out"]["mean"]
            far = {"chamfer": chamfer(folder)}
            rows.append({"case": HULL, "by": way, "seed": seed, **far, **held})
            print(rows[-1], flush=True)
    return pandas.DataFrame(rows)


PARTS = {
    "poses": (poses, "photographs.csv"),
    "hull": (hull, "photographs_hull.csv"),
    "views": (views, "photographs_views.csv"),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(PARTS))
    for part in parser.parse_args().parts or PARTS:
        measured, name = PARTS[part]
        with tempfile.TemporaryDirectory() as made:
            measured(Path(made)).to_csv(RESULTS / name, index=False, float_format="%.4g")
    pages.write()


if __name__ == "__main__":
    main()
