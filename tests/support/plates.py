"""Photographs of a square plate with texture coordinates, rendered by Mitsuba: what lies on it and
where it stands is known."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi
import numpy as np
import photo_sets
from photo_sets import Files, look_at

from isas_cli.runtime import images

SIZE, FOCAL = (64, 48), 80.0
EYES = [(0.5, 0.4, 2.6), (-1.5, 0.3, 2.0), (1.6, -0.4, 1.9), (0.2, 1.6, 1.9), (-0.4, -1.5, 2.0)]


def obj(path: Path, turn: float = 0.0, shift=(0.0, 0.0, 0.0)) -> Path:
    """A square of 1.2 in the plane z = 0, seen from above, v upwards along y; turned about z by
    degrees and shifted."""
    corners = np.array([[-0.6, -0.6, 0], [0.6, -0.6, 0], [0.6, 0.6, 0], [-0.6, 0.6, 0]])
    cos, sin = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    placed = corners @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]) + shift
    lines = ["v {:.7f} {:.7f} {:.7f}".format(*place) for place in placed]
    lines += ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1", "f 1/1 2/2 3/3", "f 1/1 3/3 4/4"]
    path.write_text("\n".join(lines) + "\n")
    return path


def chequered() -> np.ndarray:
    """Light with edges on all sides, which a glossy plate shows."""
    row, column = np.mgrid[:16, :32]
    return np.repeat(np.where((row // 2 + column // 2) % 2, 3.0, 0.2)[..., None], 3, 2)


def coloured() -> np.ndarray:
    """Smooth light of a colour of its own from each side, which tells where a plate faces."""
    row, column = (np.mgrid[:16, :32] + 0.5) * np.array([np.pi / 16, np.pi / 16])[:, None, None]
    return np.stack([1.2 + np.sin(column), 1.2 + np.cos(column), 1.2 + np.cos(row)], axis=-1)


def laid(texels: np.ndarray) -> dict:
    """As Mitsuba's own reader of OBJ files lays it: the first row at v = 1."""
    bitmap = mi.Bitmap(np.ascontiguousarray(texels, np.float32))
    return {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "clamp"}


def written(folder: Path, material: dict, mesh: Path, eyes=EYES, light=chequered) -> list[str]:
    """A set of the plate ``mesh`` of that material, as settings; the mesh is not among them."""
    sky = light().astype(np.float32)
    images.write_exr(folder / "sky.exr", sky, ["R", "G", "B"], {})
    up = (0.0, 1.0, 0.0)
    film = {"width": SIZE[0], "height": SIZE[1], "rfilter": {"type": "box"}, "pixel_format": "rgb"}
    sensors = {
        f"sensor_{number}": {
            "type": "perspective",
            "fov": float(np.degrees(2 * np.arctan(SIZE[0] / 2 / FOCAL))),
            "to_world": mi.ScalarTransform4f().look_at(eye, [0, 0, 0], up),
            "film": {"type": "hdrfilm", **film},
        }
        for number, eye in enumerate(eyes)
    }
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},
            "sky": {"type": "envmap", "bitmap": mi.Bitmap(sky)},
            "plate": {"type": "obj", "filename": str(mesh), "bsdf": material},
            **sensors,
        },
        optimize=False,
    )
    shown = [
        np.array(mi.render(scene, sensor=n, spp=512, seed=n), np.float32) for n in range(len(eyes))
    ]
    inner = {"w": SIZE[0], "h": SIZE[1], "fl_x": FOCAL, "fl_y": FOCAL}
    inner |= {"cx": SIZE[0] / 2, "cy": SIZE[1] / 2}
    poses = [look_at(eye, (0.0, 0.0, 0.0), up) for eye in eyes]
    photo_sets.transforms(Files(folder, poses, shown), **inner)
    return [f"photos.path={folder}", f"photos.environment={folder / 'sky.exr'}"]
