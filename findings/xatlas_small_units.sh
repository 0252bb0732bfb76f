#!/usr/bin/env bash
# Texture coordinates depend on a mesh's unit of length.
# One would guess: a sphere of radius 1 mm, in metres, is unwrapped into the charts of one of radius
# 1, as angles and ratios of areas are the same.
# Seen with xatlas 0.0.11, 1280 triangles: radius 1 gives 8 charts; radius 0.001 gives none, and every
# texture coordinate is not a number. No error, no warning.
# Where: xatlas.cpp, AddMesh: a face of no more area than FLT_EPSILON, whatever the mesh's size, counts
# as degenerate and is ignored.
# Users of isas: visual hulls of photographs whose cameras count in a large unit. isas unwraps them
# at size 1, wherever they lie.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip --disable-pip-version-check install --quiet xatlas==0.0.11 trimesh==5.2.0 numpy==2.2.6
cd "$folder"
cat > try.py <<'END'
from importlib.metadata import version

import numpy as np
import trimesh
import xatlas

print(f"xatlas {version('xatlas')}")
ball = trimesh.creation.icosphere(subdivisions=3)
vertices, faces = np.asarray(ball.vertices), np.asarray(ball.faces, np.uint32)


def covered(radius):
    """Charts, and the share of the atlas that triangles cover."""
    atlas = xatlas.Atlas()
    atlas.add_mesh((vertices * radius).astype(np.float32), faces)
    atlas.generate()
    _, indices, uvs = atlas[0]
    a, b, c = (np.float64(uvs[indices[:, k]]) for k in range(3))
    (ax, ay), (bx, by) = (b - a).T, (c - a).T
    return atlas.chart_count, float(np.abs(ax * by - ay * bx).sum() / 2)


for radius, described in ((1.0, 8), (0.1, 8), (1e-3, 0), (1e-4, 0)):
    charts, share = covered(radius)
    print(f"radius {radius:g}: {charts} charts, {share:.2f} of the atlas")
    if charts != described or np.isnan(share) != (charts == 0):
        raise SystemExit(f"changed: {described} charts are what xatlas 0.0.11 gave")
END
venv/bin/python try.py
