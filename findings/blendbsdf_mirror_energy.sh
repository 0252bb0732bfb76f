#!/usr/bin/env bash
# A blend of a mirror and a diffuse material loses light.
# One would guess: in a white furnace, 0.3 of a perfect mirror and 0.7 of a grey of 0.1 show
# 0.3 + 0.07 = 0.37, as blendbsdf is a linear combination.
# Seen with Mitsuba 3.9.1: about 0.26. Two mirrors, or two diffuse materials, are right; so is a
# diffuse albedo of 1, by coincidence.
# Where: src/bsdfs/blendbsdf.cpp, sample(): the balance heuristic adds the mirror's pdf, which is a
# probability (1), to the diffuse part's density per solid angle, as if they had one unit.
# Users of isas: a photograph of a coated thing cannot be matched by such a blend at its true
# weight. isas keeps Mitsuba's pictures, says so in its pages and advises `principled`.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip --disable-pip-version-check install --quiet mitsuba==3.9.1 drjit==1.5.0 numpy
cd "$folder"
cat > try.py <<'END'
import mitsuba as mi
import numpy as np

mi.set_variant("scalar_rgb")


def rgb(value):
    return {"type": "rgb", "value": value}


def grey(albedo):
    return {"type": "diffuse", "reflectance": rgb(albedo)}


def mirror(share):
    return {"type": "conductor", "specular_reflectance": rgb(share)}


def furnace(first, second, weight=0.3):
    view = mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}}
    blend = {"type": "blendbsdf", "weight": weight, "first": first, "second": second}
    scene = mi.load_dict({
        "type": "scene", "integrator": {"type": "path", "max_depth": 4},
        "sensor": {"type": "perspective", "fov": 10, "to_world": view, "film": film},
        "light": {"type": "constant"}, "ball": {"type": "sphere", "bsdf": blend},
    })
    return float(np.array(mi.render(scene, spp=4096)).mean())


print(f"mitsuba {mi.__version__}, {mi.variant()}")
cases = [
    ("0.7 grey 0.1, 0.3 mirror 1", grey(0.1), mirror(1.0), 0.37, 0.258),
    ("0.7 grey 1, 0.3 mirror 1", grey(1.0), mirror(1.0), 1.0, 1.0),
    ("0.7 grey 0.1, 0.3 grey 0.9", grey(0.1), grey(0.9), 0.34, 0.34),
    ("0.7 mirror 0.5, 0.3 mirror 1", mirror(0.5), mirror(1.0), 0.65, 0.65),
]
for name, first, second, expected, described in cases:
    seen = furnace(first, second)
    print(f"{name}: expected {expected:.3f}, seen {seen:.3f}")
    if abs(seen - described) > 0.01:
        raise SystemExit(f"changed: {described:.3f} is what Mitsuba 3.9.1 gave")
END
venv/bin/python try.py
