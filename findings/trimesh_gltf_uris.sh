#!/usr/bin/env bash
# trimesh looks for a glTF file's buffers and pictures by their URIs as they stand: a file whose name
# has a blank, which a URI writes as %20, is not found.
# One would guess: URIs are decoded before they are taken for paths, as RFC 3986 has it, which glTF
# 2.0 names for them: a blank cannot stand in one otherwise.
# Seen with trimesh 5.2.0: FileNotFoundError for a .gltf that names "my%20scan.bin" beside a file
# "my scan.bin"; with the blank as it is in the URI, which is no URI, it loads.
# Where: trimesh/exchange/gltf hands the text of "uri" to its resolver, which joins it to the folder.
# Users of isas: `photos.mesh` decodes URIs before trimesh reads the file.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip --disable-pip-version-check install --quiet trimesh==5.2.0 numpy
cd "$folder"
cat > try.py <<'END'
import json
from pathlib import Path

import trimesh
from trimesh.exchange.gltf import export_gltf

files = export_gltf(trimesh.Scene(trimesh.creation.box()))
tree = json.loads(files["model.gltf"])
for number, buffer in enumerate(tree["buffers"]):
    Path(f"my scan {number}.bin").write_bytes(files[buffer["uri"]])


def loaded(blank: str):
    for number, buffer in enumerate(tree["buffers"]):
        buffer["uri"] = f"my{blank}scan{blank}{number}.bin"
    Path("model.gltf").write_text(json.dumps(tree))
    try:
        return len(trimesh.load("model.gltf", force="mesh").faces)
    except OSError as error:
        return f"{type(error).__name__}: {error}"


print(f"trimesh {trimesh.__version__}")
found = {blank: loaded(blank) for blank in ("%20", " ")}
for blank, what in found.items():
    print(f"a blank written as {blank!r}: {what}")
if "FileNotFoundError" not in str(found["%20"]) or found[" "] != 12:
    raise SystemExit("changed: trimesh 5.2.0 found no file by a URI with %20")
END
"$folder/venv/bin/python" try.py
