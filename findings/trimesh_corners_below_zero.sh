#!/usr/bin/env bash
# Two triangles whose corners an OBJ file numbers backwards are read as one triangle, twice.
# One would guess: a corner of -1 is the last vertex before its face, as the format says ("relative").
# Seen with trimesh 5.2.0: numbers below 0 count from the end of the file. Files that write vertices
# and faces in turn, block after block, lose all blocks but the last. No warning, and every number is
# a valid one.
# Users of isas: corners are counted from the face that names them before the file is handed on.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip --disable-pip-version-check install --quiet trimesh==5.2.0 numpy==2.2.6
cd "$folder"
cat > try.py <<'END'
import numpy as np
import trimesh

block = "v {0} 0 0\nv {1} 0 0\nv {1} 1 0\nf -3 -2 -1\n"
with open("two.obj", "w") as file:
    file.write(block.format(0, 1) + block.format(2, 3))
mesh = trimesh.load("two.obj", process=False, force="mesh")
places = mesh.vertices[mesh.faces][:, :, 0].tolist()
print(f"trimesh {trimesh.__version__}: the triangles' x: {places}; written: [[0, 1, 1], [2, 3, 3]]")
if places != [[2, 3, 3], [2, 3, 3]]:
    raise SystemExit("changed: with trimesh 5.2.0 both were the last")
END
venv/bin/python try.py
