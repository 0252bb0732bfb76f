#!/usr/bin/env bash
# Numbers that are none and are added to one entry by scatter_add vanish where they fill a packet, and
# spoil the sum where a number is beside them.
# One would guess: the sum is NaN as soon as one of them is, as of any sum of floating-point numbers.
# Seen with Dr.Jit 1.5.0 (llvm, all modes but Direct): 64 times NaN give 0; 32 and 32 ones give 32; a
# single one among 63 ones gives NaN. Lanes whose value does not differ from 0 are left out before a
# packet is reduced, and NaN compares as if it did not, but for a reduction that others begin. Gradients
# are sums of this kind: how many bad paths a parameter survives depends on their neighbours.
# Users of isas: paths that are not finite are taken out, and counted, before they reach a gradient.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip --disable-pip-version-check install --quiet drjit==1.5.0 numpy==2.2.6
cd "$folder"
cat > try.py <<'END'
import drjit as dr
import numpy as np
from drjit.llvm import Float, UInt32

print(f"drjit {dr.__version__}")


def total(values: list[float]) -> float:
    """Of numbers that are all added to one entry."""
    target = dr.zeros(Float, 1)
    dr.scatter_add(target, Float(np.float32(values)), dr.opaque(UInt32, 0, len(values)))
    return float(target[0])


nan = float("nan")
found = [total(each) for each in ([nan] * 64, [nan] * 32 + [1] * 32, [nan] + [1] * 63)]
print(f"NaN alone: {found[0]}; half of them: {found[1]}; one of them: {found[2]}")
if found[:2] != [0.0, 32.0] or found[2] == found[2]:
    raise SystemExit("changed: with Dr.Jit 1.5.0 it was 0.0, 32.0 and nan")
END
venv/bin/python try.py
