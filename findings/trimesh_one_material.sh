#!/usr/bin/env bash
# Of two unlike materials trimesh writes one into a glTF file, and both meshes have it.
# One would guess: materials are one where their numbers, pictures and names are.
# Seen with trimesh 5.2.0: of roughnessFactor=0.5 on one mesh and metallicFactor=0.5 on another the
# file has the first alone; so it has of one picture that is one mesh's colour and another's light.
# Where: trimesh/visual/material.py, PBRMaterial.__hash__, joins the bytes of the values without what
# they are of, nor the shapes of pictures; trimesh/exchange/gltf takes equal hashes for equality.
# Users of isas: every material that `isas export` writes has a name of its own, which is hashed too.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip --disable-pip-version-check install --quiet trimesh==5.2.0 numpy pillow
cd "$folder"
cat > try.py <<'END'
import json
import struct

import numpy as np
import trimesh
from PIL import Image
from trimesh.visual.material import PBRMaterial


def written(*materials):
    """What the file has, and which of it each mesh has."""
    scene = trimesh.Scene()
    for number, material in enumerate(materials):
        mesh = trimesh.creation.icosphere(1)
        mesh.visual = trimesh.visual.TextureVisuals(uv=mesh.vertices[:, :2], material=material)
        scene.add_geometry(mesh, geom_name=str(number))
    content = scene.export(file_type="glb")
    (size,) = struct.unpack_from("<I", content, 12)
    tree = json.loads(content[20 : 20 + size])
    return tree["materials"], [mesh["primitives"][0]["material"] for mesh in tree["meshes"]]


print(f"trimesh {trimesh.__version__}")
picture = Image.fromarray(np.arange(48, dtype=np.uint8).reshape(4, 4, 3))
pairs = {
    "rough, metallic": (PBRMaterial(roughnessFactor=0.5), PBRMaterial(metallicFactor=0.5)),
    "colour, light": (PBRMaterial(baseColorTexture=picture), PBRMaterial(emissiveTexture=picture)),
}
for name, pair in pairs.items():
    materials, used = written(*pair)
    print(f"{name}: {json.dumps(materials)}, of the meshes {used}")
    if len(materials) != 1 or used != [0, 0]:
        raise SystemExit("changed: trimesh 5.2.0 wrote one material for both")
named = [PBRMaterial(name=n, **k) for n, k in (("a", {"roughnessFactor": 0.5}), ("b", {"metallicFactor": 0.5}))]
print("with names:", written(*named)[1])
END
"$folder/venv/bin/python" try.py
