#!/usr/bin/env bash
# A heterogeneous medium fills no more of its shape than the bounds of its extinction's volume do,
# and those of a constant one are the cube from 0 to 1.
# One would guess: <float name="sigma_t" value="1"/>, or a constvolume, is the same everywhere, so
# that the shape is filled, as it is of a homogeneous medium; and a grid without to_world repeats its
# border beyond, as its lookups do.
# Seen with Mitsuba 3.9.1: in a cube from -1 to 1 the extinction 5 as one number leaves the light
# behind as it is along a ray through (-0.5, -0.5), and at exp(-5) of itself through
# (0.5, 0.5), where homogeneous leaves exp(-10) in both.
# Users of isas: its own paths through media are taken only where the volume fills the shape.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip --disable-pip-version-check install --quiet mitsuba==3.9.1 drjit==1.5.0 numpy==2.2.6
cd "$folder"
cat > try.py <<'END'
import math

import mitsuba as mi
import numpy as np

mi.set_variant("scalar_rgb")
print(f"mitsuba {mi.__version__}")


def behind(kind: str, x: float) -> float:
    """What a ray along z through (x, x) sees of a sky of radiance 1; the medium scatters nothing."""
    scene = mi.load_string(
        '<scene version="3.0.0"><integrator type="volpath"/><emitter type="constant"/>'
        '<sensor type="orthographic"><film type="hdrfilm"><integer name="width" value="1"/>'
        '<integer name="height" value="1"/><rfilter type="box"/></film><transform name="to_world">'
        f'<scale value="0.01"/><lookat origin="{x}, {x}, 5" target="{x}, {x}, 0" up="0, 1, 0"/>'
        f'</transform></sensor><shape type="cube"><bsdf type="null"/><medium type="{kind}" '
        'name="interior"><float name="sigma_t" value="5"/><float name="albedo" value="0"/></medium>'
        "</shape></scene>"
    )
    return float(np.mean(mi.render(scene, spp=20000)))


for x, half in ((-0.5, 1.0), (0.5, math.exp(-5))):
    whole, found = behind("homogeneous", x), behind("heterogeneous", x)
    print(f"({x}, {x}): homogeneous {whole:.4f}, heterogeneous {found:.4f}")
    if abs(found - half) > 5e-3 or whole > 1e-3:
        raise SystemExit("changed: with Mitsuba 3.9.1 it filled the cube from 0 to 1 alone")
END
venv/bin/python try.py
