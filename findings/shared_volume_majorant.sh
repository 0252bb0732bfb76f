#!/usr/bin/env bash
# A medium whose volume stands for itself and is referred to keeps its old bound on the density.
# One would guess: after params["smoke.data"] = ... and params.update(), a medium that refers to the
# grid is as if it had been loaded with it.
# Seen with Mitsuba 3.9.1: update() tells the object by way of which the parameter was found, which
# of a volume at the top level is the scene: the medium's largest extinction stays 0.2 where the grid
# has 7, and free paths are drawn by 0.2. Inside of the medium (no <ref>) it becomes 7.
# Users of isas: media that take an unknown from such a volume are told after every step.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip --disable-pip-version-check install --quiet mitsuba==3.9.1 drjit==1.5.0 numpy==2.2.6
cd "$folder"
cat > try.py <<'END'
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_rgb")
print(f"mitsuba {mi.__version__}")


def largest(shared: bool) -> float:
    """Of the extinction, as the medium has it, after the grid has become 7."""
    grid = {"type": "gridvolume", "grid": mi.VolumeGrid(np.full((4, 4, 4, 1), 0.2, np.float32))}
    medium = {"type": "heterogeneous", "albedo": 0.5, "sigma_t": grid}
    described = {"type": "scene"}
    if shared:
        described["smoke"] = grid
        medium["sigma_t"] = {"type": "ref", "id": "smoke"}
    described["box"] = {"type": "cube", "bsdf": {"type": "null"}, "interior": medium}
    scene = mi.load_dict(described, optimize=False)
    params = mi.traverse(scene)
    key = "smoke.data" if shared else "box.interior_medium.sigma_t.data"
    params[key] = mi.TensorXf(np.full((4, 4, 4, 1), 7, np.float32))
    params.update()
    inside = scene.shapes()[0].interior_medium()
    return float(np.ravel(inside.get_majorant(mi.MediumInteraction3f(), True))[0])


found = {shared: round(largest(shared), 3) for shared in (False, True)}
print(f"in the medium: {found[False]}; referred to: {found[True]}")
if found != {False: 7.0, True: 0.2}:
    raise SystemExit("changed: with Mitsuba 3.9.1 it was 7 and 0.2")
END
venv/bin/python try.py
