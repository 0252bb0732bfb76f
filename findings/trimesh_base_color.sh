#!/usr/bin/env bash
# A glTF file that trimesh writes has a base colour in steps of 1/255, so that dark ones become black.
# One would guess: glTF's baseColorFactor is four floating-point numbers, linear, and trimesh takes
# floating-point ones, so that 0.001 is 0.001 in the file.
# Seen with trimesh 5.2.0: it is 0, and 0.02 is 0.0196; a file in which it is 0.001 is 0 when read.
# Linear steps of 1/255 are coarse in the dark: the first one above black is 5 % of white as a screen
# shows it.
# Where: trimesh/visual/material.py, the setter of PBRMaterial.baseColorFactor, makes bytes of it by
# color.to_rgba; roughnessFactor and metallicFactor stay as they are.
# Users of isas: `isas export` puts its own numbers into the file, by `tree_postprocessor`.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip --disable-pip-version-check install --quiet trimesh==5.2.0 numpy pillow
cd "$folder"
cat > try.py <<'END'
import io
import json
import struct

import numpy as np
import trimesh

GIVEN = [0.001, 0.02, 0.5, 1.0]


def ball():
    mesh = trimesh.creation.icosphere(1)
    material = trimesh.visual.material.PBRMaterial(baseColorFactor=np.array(GIVEN))
    mesh.visual = trimesh.visual.TextureVisuals(material=material)
    return trimesh.Scene(mesh)


def tree(content):
    (size,) = struct.unpack_from("<I", content, 12)
    return json.loads(content[20 : 20 + size])


def exact(tree):
    tree["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] = GIVEN


print(f"trimesh {trimesh.__version__}")
content = ball().export(file_type="glb")
written = tree(content)["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"]
print("given", GIVEN, "written", written)
content = trimesh.exchange.gltf.export_glb(ball(), tree_postprocessor=exact)
(mesh,) = trimesh.load_scene(io.BytesIO(content), file_type="glb").geometry.values()
read = mesh.visual.material.baseColorFactor
print("of", tree(content)["materials"][0]["pbrMetallicRoughness"], "is read", read)
if written[0] != 0 or abs(written[1] - 5 / 255) > 1e-6 or read[0] != 0:
    raise SystemExit("changed: trimesh 5.2.0 made bytes of them")
END
"$folder/venv/bin/python" try.py
