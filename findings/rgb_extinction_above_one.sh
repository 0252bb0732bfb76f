#!/usr/bin/env bash
# A medium's extinction as a colour must not exceed 1; as one number it may be anything.
# One would guess: `sigma_t` is per unit of length, from 0 on, whether <float> or <rgb>: a scene a
# thousand times as small needs numbers a thousand times as large.
# Seen with Mitsuba 3.9.1: <float name="sigma_t" value="4"/> loads; <rgb name="sigma_t"
# value="1, 2, 4"/> is "Invalid RGB reflectance value"; <rgb value="0.25, 0.5, 1"/> with <float
# name="scale" value="4"/> is the same medium and loads. So does value="1, 2, 4" of a light's radiance.
# Users of isas: write the colour below 1 and `scale`, as Mitsuba's own message does not say.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip --disable-pip-version-check install --quiet mitsuba==3.9.1 drjit==1.5.0 numpy==2.2.6
cd "$folder"
cat > try.py <<'END'
import mitsuba as mi
import numpy as np

mi.set_variant("scalar_rgb")
print(f"mitsuba {mi.__version__}")


def fog(inside: str):
    medium = f'<medium type="homogeneous" name="interior">{inside}</medium>'
    return mi.load_string(
        '<scene version="3.0.0"><emitter type="constant"><rgb name="radiance" value="1, 2, 4"/>'
        f'</emitter><shape type="cube"><bsdf type="null"/>{medium}</shape></scene>'
    )


def extinction(scene) -> list:
    medium = scene.shapes()[0].interior_medium()
    values = medium.get_scattering_coefficients(mi.MediumInteraction3f(), True)
    return np.round(np.ravel(values[2]), 3).tolist()


print("float 4:", extinction(fog('<float name="sigma_t" value="4"/>')))
try:
    found = extinction(fog('<rgb name="sigma_t" value="1, 2, 4"/>'))
except RuntimeError as error:
    print("rgb 1, 2, 4:", str(error).splitlines()[0][-110:])
    if "Invalid RGB reflectance value" not in str(error):
        raise SystemExit("changed: with Mitsuba 3.9.1 it was called an invalid reflectance")
else:
    raise SystemExit(f"changed: with Mitsuba 3.9.1 it was refused, now it is {found}")
scaled = '<rgb name="sigma_t" value="0.25, 0.5, 1"/><float name="scale" value="4"/>'
print("rgb 0.25, 0.5, 1 and scale 4:", extinction(fog(scaled)))
if extinction(fog(scaled)) != [1.0, 2.0, 4.0]:
    raise SystemExit("changed: with Mitsuba 3.9.1 the scale made it the same medium")
END
venv/bin/python try.py
