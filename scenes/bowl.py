"""Bowl: a glossy painted bowl seen from all sides; its albedo is unknown.

The paper's scene (Fig. 9, BOWL): "a textured glossy bowl, and we optimize albedo using 32 images of
the object", 262,144 pixels an image, under environmental lighting, started from 0.5.

Ours: a bowl turned and painted by code, glazed (principled BSDF of roughness 0.15), on a plinth
under the CC0 map `city`, whose sun gives a quarter of the light. 32 cameras on a spiral around it,
from 8° to 55° above the horizon; 16 at the size `default`.

What differs: the paper's bowl, a scanned one, and its light are not published, so ours are others.
The foot's underside cannot be seen, here as there.

Depth 3: camera, two surfaces, light. One bounce between surfaces lights the inside. Against depth
8 the images lack 3 % of their light (13 % at depth 2); targets have the same depth.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator

from . import library, meshes
from .cameras import spiral
from .lathe import turn
from .noise import fractal_noise
from .plinth import plinth

ROUGHNESS = 0.15
CREAM = np.array([0.44, 0.40, 0.33], np.float32)
COBALT = np.array([0.03, 0.07, 0.30], np.float32)
RUST = np.array([0.42, 0.11, 0.04], np.float32)
OCHRE = np.array([0.50, 0.29, 0.06], np.float32)
# (radius, height) of the wall from the foot to the rim, and from the rim to the inside's middle.
OUTER = [(0.26, 0.0), (0.26, 0.04), (0.36, 0.11), (0.50, 0.25), (0.58, 0.42), (0.62, 0.60)]
INNER = [(0.59, 0.61), (0.54, 0.43), (0.46, 0.27), (0.33, 0.14), (0.17, 0.08), (0.0, 0.07)]
# Paint is averaged over this many points a side of each texel, at the sizes of small textures.
POINTS_PER_SIDE = 4
LARGEST_AVERAGED = 512


def build(views: int, resolution: int, texture: int) -> dict[str, Any]:
    """The scene with the true texture; unknown: `bowl.bsdf.base_color.data`, (texture²) x 3."""
    material = {
        "type": "principled",
        "base_color": library.texture(paint(texture)),
        "roughness": ROUGHNESS,
    }
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 3},
        "sky": library.environment("hdri/city.exr"),
        "bowl": meshes.shape("bowl", turn(profile(), 160), material),
        "plinth": plinth(0.72),
        **spiral(views, resolution, (0.0, 0.28, 0.0), 3.2, 25.0, (8.0, 55.0)),
    }


def profile() -> np.ndarray:
    """The points above on a smooth curve: foot, outside, rim, inside."""
    foot = [(0.0, 0.02), (0.22, 0.02)]
    steps = np.linspace(0, 1, 40)

    def curve(points: list[tuple[float, float]]) -> np.ndarray:
        p = np.array(points)
        length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))])
        return PchipInterpolator(length / length[-1], p)(steps)

    return np.concatenate([foot, curve(OUTER), [(0.607, 0.62)], curve(INNER)])


def paint(size: int) -> np.ndarray:
    """Linear albedo (size, size, 3): lines, leaves and dots on a cream glaze."""
    finer = POINTS_PER_SIDE if size <= LARGEST_AVERAGED else 1
    v, u = (np.indices((size * finer, size * finer), dtype=np.float32) + 0.5) / (size * finer)
    angle = 2 * np.pi * u
    where = np.stack([np.sin(angle), 3 * v, np.cos(angle)], axis=-1).reshape(-1, 3)
    noise = fractal_noise(where, 5, 4, seed=5).reshape(u.shape)
    # The brush wanders.
    row, column = 16 * (v + 0.008 * (noise - 0.5)), 14 * (u + 0.01 * (noise - 0.5))
    inside_row = row % 1 - 0.5
    along = (column + 0.5 * (np.floor(row) % 2)) % 1 - 0.5
    leaf = (along - 0.25 * inside_row) ** 2 / 0.09 + inside_row**2 / 0.07 < 1
    vein = np.abs(inside_row + 0.3 * along) < 0.05
    dot = (np.abs(along) - 0.5) ** 2 + (inside_row * 0.9) ** 2 < 0.012
    line = np.abs(inside_row) > 0.45
    colour = CREAM * (0.8 + 0.4 * noise[..., None])
    for mask, paint in ((leaf, COBALT), (leaf & vein, CREAM), (dot, OCHRE), (line, RUST)):
        colour = np.where(mask[..., None], paint * (0.8 + 0.4 * noise[..., None]), colour)
    colour = colour.reshape(size, finer, size, finer, 3).mean(axis=(1, 3))
    return np.clip(colour, library.DARKEST, library.BRIGHTEST).astype(np.float32)
