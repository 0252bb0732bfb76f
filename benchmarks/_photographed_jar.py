"""Photographs of pottery's jar, by Mitsuba's `path` in `scalar_rgb`: nothing of isas renders.

usage: _photographed_jar.py FOLDER

Writes FOLDER/jar.obj; city.exr and forest.exr, lights; and a set of 15 pictures under the first
(`transforms.json`, every fifth to be held out) and one of 4 under the second
(`transforms_novel.json`), 128 pixels wide, through a camera's curve, with noise, in 8 bits, alpha
where the jar is. In a process of its own, whose Mitsuba is the scalar one.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from PIL import Image

from isas_cli.runtime import backend, images

SIZE, FIELD, PATHS, DEPTH = 128, 30.0, 256, 8
MIDDLE, DISTANCE = np.array([0.0, 0.54, 0.0]), 2.8
ROUGHNESS = 0.3
# Of a sensor: electrons of a full pixel, and what reading adds.
_FULL, _READ = 4000, 8
SETS = {"transforms.json": (15, "city.exr", 0), "transforms_novel.json": (4, "forest.exr", 1)}


def main(folder: Path) -> None:
    backend.start()
    import mitsuba as mi
    from isas_cli.scenes import library, meshes
    from isas_cli.scenes.bake import bake
    from isas_cli.scenes.pottery_paint import paint
    from isas_cli.scenes.subdivide import subdivide

    folder.mkdir(parents=True, exist_ok=True)
    coarse = meshes.read_obj(library.asset("models/old_jar/old_jar.obj"))
    jar = subdivide(coarse, levels=1, name="old_jar.obj")
    _write(folder / "jar.obj", jar)
    texels = np.array(bake(jar, 256, paint), np.float32)
    mi.set_variant("scalar_rgb")
    colour = mi.Bitmap(np.ascontiguousarray(texels))
    material = {"type": "principled", "roughness": ROUGHNESS}
    material["base_color"] = {"type": "bitmap", "bitmap": colour, "raw": True}
    for name, (count, light, seed) in SETS.items():
        # Resampling has left it slightly negative around its sun.
        sky = np.maximum(images.read(library.asset(f"hdri/{light}")), 0)
        images.write_exr(folder / light, sky, [*"RGB"], {})
        frames, rng = [], np.random.default_rng(seed)
        for number in range(count):
            around, up = 0.4 + 2 * np.pi * number / count, np.radians((10, 35, 55)[number % 3])
            back = np.array([np.cos(around) * np.cos(up), np.sin(up), np.sin(around) * np.cos(up)])
            place = MIDDLE + DISTANCE * back
            picture = f"{light[:-4]}_{number:03d}.png"
            pixels = _seen(folder, light, material, place, 1000 * seed + number)
            Image.fromarray(taken(pixels, rng)).save(folder / picture)
            right = np.cross([0, 1, 0], back) / np.linalg.norm(np.cross([0, 1, 0], back))
            pose = np.eye(4)
            pose[:3] = np.column_stack([right, np.cross(back, right), back, place])
            frames.append({"file_path": picture, "transform_matrix": pose.tolist()})
        top = {"camera_angle_x": float(np.radians(FIELD)), "frames": frames}
        (folder / name).write_text(json.dumps(top))


def _seen(folder: Path, light: str, material: dict, place: np.ndarray, seed: int) -> np.ndarray:
    """Linear colours and alpha, ``(SIZE, SIZE, 4)``."""
    import mitsuba as mi

    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": DEPTH, "hide_emitters": True},
        "sky": {"type": "envmap", "filename": str(folder / light)},
        "jar": {"type": "obj", "filename": str(folder / "jar.obj"), "bsdf": material},
        "camera": {
            "type": "perspective",
            "fov": FIELD,
            "to_world": mi.ScalarTransform4f().look_at(place, MIDDLE, [0, 1, 0]),
            "film": {
                **dict(type="hdrfilm", width=SIZE, height=SIZE, pixel_format="rgba"),
                **dict(rfilter={"type": "box"}),
            },
        },
    }
    return np.array(mi.render(mi.load_dict(scene), spp=PATHS, seed=seed))


def taken(pixels: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """As a camera takes it: photons and reading, sRGB, 8 bits, alpha beside straight colours."""
    alpha = np.clip(pixels[..., 3:], 0, 1)
    colour = np.clip(pixels[..., :3] / np.maximum(alpha, 1e-4), 0, None)
    electrons = rng.poisson(np.clip(colour, 0, 2) * _FULL) + rng.normal(0, _READ, colour.shape)
    linear = np.clip(electrons / _FULL, 0, 1)
    low, high = linear * 12.92, 1.055 * np.clip(linear, 1e-9, None) ** (1 / 2.4) - 0.055
    encoded = np.where(linear < 0.0031308, low, high)
    return np.uint8(np.rint(255 * np.dstack([encoded, alpha])))


def _write(path: Path, surface) -> None:
    """As OBJ, whose v counts from below."""
    lines = [f"v {x:.7g} {y:.7g} {z:.7g}" for x, y, z in surface.vertices]
    lines += [f"vt {u:.7g} {1 - v:.7g}" for u, v in surface.texcoords]
    lines += [f"vn {x:.7g} {y:.7g} {z:.7g}" for x, y, z in surface.normals]
    lines += ["f " + " ".join(f"{k}/{k}/{k}" for k in face + 1) for face in surface.faces]
    path.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
