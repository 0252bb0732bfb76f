#!/usr/bin/env bash
# A bitmap with an id is named by an address in memory, another one in each process.
# One would guess: a texture declared with id="tex" and used twice is "tex.data" in mi.traverse(),
# as a shared material with id="mat" is "mat....", and the same in every process.
# Seen with Mitsuba 3.9.1: "object_93939848592384.data"; the next process has another number.
# Where: the texture made by `bitmap` has an empty id(), and Scene::traverse() of
# src/render/scene.cpp then names its child by "object_" and the pointer.
# Users of isas: a run of such a scene could not be resumed, nor its cached targets found again, as
# the parameter's name is new each time. isas gives such textures their ids back when it loads.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip --disable-pip-version-check install --quiet mitsuba==3.9.1 drjit==1.5.0 numpy
cd "$folder"
cat > try.py <<'END'
import subprocess
import sys

import mitsuba as mi
import numpy as np

mi.set_variant("scalar_rgb")
SCENE = """<scene version="3.0.0">
<texture type="bitmap" id="tex"><string name="filename" value="t.exr"/></texture>
<bsdf type="diffuse" id="mat"><rgb name="reflectance" value="0.5"/></bsdf>
<shape type="sphere" id="ball"><bsdf type="roughplastic">
  <ref id="tex" name="diffuse_reflectance"/><ref id="tex" name="specular_reflectance"/>
</bsdf></shape>
<shape type="sphere" id="a"><ref id="mat"/></shape>
<shape type="sphere" id="b"><ref id="mat"/></shape>
</scene>"""
if sys.argv[1:]:
    params = mi.traverse(mi.load_string(SCENE))
    print(*(key for key in params.keys() if key.endswith((".data", "reflectance.value"))))
    raise SystemExit

mi.Bitmap(np.full((4, 4, 3), 0.5, np.float32)).write("t.exr")
print(f"mitsuba {mi.__version__}, {mi.variant()}")
print("expected: mat.reflectance.value tex.data, in both processes")
names = []
for _ in range(2):
    command = [sys.executable, __file__, "child"]
    names.append(subprocess.run(command, check=True, capture_output=True, text=True).stdout.split())
    print("seen:", *names[-1])
bitmaps = {name for found in names for name in found if name.startswith("object_")}
if len(bitmaps) != 2 or not all("mat.reflectance.value" in found for found in names):
    raise SystemExit("changed: with Mitsuba 3.9.1 the bitmap has an address in each process")
END
venv/bin/python try.py
