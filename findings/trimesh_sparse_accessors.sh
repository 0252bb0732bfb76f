#!/usr/bin/env bash
# trimesh leaves out the "sparse" part of a glTF accessor: vertices that a file moves by it stay where
# they were before, without a word.
# One would guess: accessors are read as glTF 2.0 has them, where "sparse" names the entries that
# differ from the buffer view's (or from zeros); a reader that knows no sparse ones refuses the file.
# Seen with trimesh 5.2.0: a triangle whose third vertex the sparse part moves from (0, 1, 0) to
# (0, 5, 0) is loaded with (0, 1, 0); one all of whose vertices are sparse is loaded as a point at 0.
# Where: trimesh/exchange/gltf, which takes accessors by bufferView, or zeros where there is none.
# Users of isas: such a mesh (exporters write shape keys and edited copies so) is refused in one line.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip --disable-pip-version-check install --quiet trimesh==5.2.0 numpy
cd "$folder"
cat > try.py <<'END'
import base64
import json
from pathlib import Path

import numpy as np
import trimesh

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
MOVED = np.array([[0, 0, 0], [1, 0, 0], [0, 5, 0]], np.float32)


def loaded(which, base):
    """Vertices of a triangle whose entries ``which`` come by the sparse part."""
    parts = [np.array(which, np.uint16), MOVED[which], CORNERS]
    blobs = [part.tobytes() + b"\0" * (-part.nbytes % 4) for part in parts]
    starts = np.cumsum([0, *map(len, blobs)])
    views = [
        {"buffer": 0, "byteOffset": int(start), "byteLength": part.nbytes}
        for start, part in zip(starts, parts)
    ]
    sparse = {
        "count": len(which),
        "indices": {"bufferView": 0, "componentType": 5123},
        "values": {"bufferView": 1},
    }
    places = {"componentType": 5126, "count": 3, "type": "VEC3", "sparse": sparse}
    places |= {"min": [0, 0, 0], "max": [1, 5, 0]} | ({"bufferView": 2} if base else {})
    data = base64.b64encode(b"".join(blobs)).decode()
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [places],
        "bufferViews": views,
        "buffers": [
            {
                "byteLength": int(starts[-1]),
                "uri": f"data:application/octet-stream;base64,{data}",
            }
        ],
    }
    Path("model.gltf").write_text(json.dumps(tree))
    scene = trimesh.load_scene("model.gltf", process=False)
    (mesh,) = scene.geometry.values()
    return np.asarray(mesh.vertices)


print(f"trimesh {trimesh.__version__}")
some, every = loaded([2], base=True), loaded([0, 1, 2], base=False)
print(f"third vertex moved to (0, 5, 0) by the sparse part: {some[2].tolist()}")
print(f"all three by the sparse part: {every.tolist()}")
if not np.array_equal(some, CORNERS) or every.any():
    raise SystemExit("changed: trimesh 5.2.0 left sparse parts out")
END
"$folder/venv/bin/python" try.py
