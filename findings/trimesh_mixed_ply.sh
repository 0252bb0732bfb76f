#!/usr/bin/env bash
# trimesh reads faces of three and of four corners beside each other from an ASCII PLY, and refuses
# the same mesh in binary.
# One would guess: of one mesh both forms give the same, as both are of the format.
# Seen with trimesh 5.2.0: ASCII gives three triangles; binary_little_endian raises ValueError, "PLY
# is unexpected length!". Faces of four corners alone are read from both. Blender writes such files
# where a mesh was not triangulated.
# Where: trimesh/exchange/ply.py, _ply_binary, reads all faces with the length of the first one's
# list, and compares the size of the file with that before it reads any.
# Users of isas: `photos.mesh` takes such files, which isas reads itself.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip --disable-pip-version-check install --quiet trimesh==5.2.0 numpy
cd "$folder"
cat > try.py <<'END'
import io
import struct

import numpy as np
import trimesh

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0]], np.float32)
MIXED, ALIKE = [(0, 1, 2, 3), (1, 4, 2)], [(0, 1, 2, 3), (1, 4, 5, 2)]


def ply(form: str, faces: list) -> bytes:
    head = ["ply", f"format {form} 1.0", f"element vertex {len(CORNERS)}"]
    head += [f"property float {axis}" for axis in "xyz"] + [f"element face {len(faces)}"]
    head += ["property list uchar int vertex_indices", "end_header", ""]
    start = "\n".join(head).encode()
    if form == "ascii":
        lines = [" ".join(f"{x:g}" for x in point) for point in CORNERS]
        lines += [" ".join(map(str, (len(face), *face))) for face in faces]
        return start + "\n".join([*lines, ""]).encode()
    lists = [struct.pack(f"<B{len(face)}i", len(face), *face) for face in faces]
    return start + CORNERS.tobytes() + b"".join(lists)


def triangles(form: str, faces: list):
    try:
        return len(trimesh.load(io.BytesIO(ply(form, faces)), file_type="ply", process=False).faces)
    except ValueError as error:
        return str(error)


print(f"trimesh {trimesh.__version__}")
found = {
    (form, name): triangles(form, faces)
    for form in ("ascii", "binary_little_endian")
    for name, faces in (("mixed", MIXED), ("alike", ALIKE))
}
for key, what in found.items():
    print(*key, what)
expected = [3, 4, "PLY is unexpected length!", 4]
if [*found.values()] != expected:
    raise SystemExit(f"changed: trimesh 5.2.0 gave {expected}")
END
"$folder/venv/bin/python" try.py
