#!/usr/bin/env bash
# `flip_evaluator.evaluate` takes arrays of 8 bits for light between 0 and 1: all but black is white.
# One would guess: pictures of uint8, as Pillow, imageio and OpenCV read them, are of 0 to 255, as in
# scikit-image's metrics; or are refused.
# Seen with flip-evaluator 1.7: noise of 1 to 255 differs from plain white by a mean FLIP of 0.0, while
# the same pictures as files, or as floats over 255, differ by 0.8. No warning.
# Users of isas: the FLIP of held-out views is of floats, and a test holds it to that of files.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip --disable-pip-version-check install --quiet flip-evaluator==1.7 numpy==2.2.6 pillow==12.0.0
cd "$folder"
cat > try.py <<'END'
from importlib.metadata import version

import flip_evaluator
import numpy as np
from PIL import Image

print(f"flip-evaluator {version('flip-evaluator')}")
noise = np.random.default_rng(0).integers(1, 256, (64, 64, 3), dtype=np.uint8)
white = np.full_like(noise, 255)
for name, picture in (("noise", noise), ("white", white)):
    Image.fromarray(picture).save(f"{name}.png")
_, files, _ = flip_evaluator.evaluate("white.png", "noise.png", "LDR")
_, bits, _ = flip_evaluator.evaluate(white, noise, "LDR")
_, floats, _ = flip_evaluator.evaluate(
    *(np.float32(each) / 255 for each in (white, noise)), "LDR"
)
print(f"mean FLIP of files {files:.3f}, of floats {floats:.3f}, of uint8 {bits:.3f}")
if abs(files - floats) > 1e-3:
    raise SystemExit("changed: with flip-evaluator 1.7 floats and files were alike")
if bits > 1e-6:
    raise SystemExit("changed: with flip-evaluator 1.7 noise of 8 bits was as white")
END
venv/bin/python try.py
