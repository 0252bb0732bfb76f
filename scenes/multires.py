"""Multires: a bin of one colour and a cake with a texture in a Cornell box; both are unknown.

The paper's scene (Fig. 5): "a Cornell box containing a texture-less trash can and a textured
CATCAKE. Using one input image, we jointly optimize the albedo values for both objects". It shows
what the multi-resolution scheme is for: one colour that very many pixels determine beside thousands
of texels that a few pixels each determine.

Ours: the CC0 models `dustbin`, with one colour, and `cupcake`. Its sponge and its paper cup share
one texture: the upper half holds the photograph of sponge cake that comes with the model, the
lower half a print on the cup, made by code. Cream, cherry and stalk keep known plain colours. All
surfaces are principled. One image, as in the paper: a third of the texels is seen well, the others
are behind, hidden or unused.

What differs: the paper's models, colours and light are not published, so ours are others; our box
is closed behind the camera (`cornell`).

Depth 6: camera, up to five surfaces, light. In a closed white room much light comes by many
bounces: against depth 16 the image lacks 2.6 % of it (9 % at depth 4); targets have the same depth.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from . import library, meshes
from .bake import bake
from .cornell import cornell_box
from .noise import fractal_noise

BIN_COLOUR = [0.16, 0.34, 0.55]
PLAIN = {"Cream": [0.85, 0.70, 0.68], "Cherry": [0.55, 0.04, 0.05], "Tail": [0.12, 0.20, 0.05]}
CAKE_HEIGHT, CAKE_TURN, CAKE_AT = 1.15, 30.0, (0.48, 0.2)
PAPER = np.array([0.80, 0.72, 0.58], np.float32)
TEAL = np.array([0.05, 0.30, 0.28], np.float32)
BERRY = np.array([0.45, 0.05, 0.12], np.float32)
# Height in the model's units up to which the cup reaches, and its bands.
CUP_TOP = 3.15


def build(resolution: int, texture: int) -> dict[str, Any]:
    """Unknowns: `bin.bsdf.brdf_0.base_color.value`, three numbers, and
    `cake.bsdf.brdf_0.base_color.data`, (texture²) x 3."""
    path = library.asset("models/cupcake/cupcake.obj")
    whole = meshes.read_obj(path, textured=False, flat=True)
    fit = meshes.placement(whole, CAKE_HEIGHT, CAKE_TURN, CAKE_AT)
    cake, albedo = _cake(texture)
    dustbin = library.asset("models/dustbin/dustbin.obj")
    bin_ = meshes.place(meshes.read_obj(dustbin, textured=False), 1.15, 20.0, (-0.45, -0.3))
    scene = {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 6},
        "bin": meshes.shape("bin", bin_, _matt({"type": "rgb", "value": BIN_COLOUR})),
        "cake": meshes.shape("cake", fit(cake), _matt(library.texture(albedo))),
        **cornell_box(resolution),
    }
    for part, colour in PLAIN.items():
        surface = fit(meshes.read_obj(path, textured=False, material=part, flat=True))
        material = _matt({"type": "rgb", "value": colour})
        scene[part.lower()] = meshes.shape(part.lower(), surface, material)
    return scene


def _cake(size: int) -> tuple[meshes.Surface, np.ndarray]:
    """Sponge and cup as one surface, and its texture (size, size, 3)."""
    path = library.asset("models/cupcake/cupcake.obj")
    sponge, cup = (meshes.read_obj(path, material=part) for part in ("Cake", "Cup"))
    # The sponge's chart goes to v < 1/2. The cup's own lies at v from 0.2 to 0.64, the rest empty.
    half = np.array([1.0, 0.5], np.float32)
    sponge = replace(sponge, texcoords=sponge.texcoords * half)
    cup = replace(cup, texcoords=cup.texcoords + np.array([0.0, 0.33], np.float32))
    albedo = bake(cup, size, _print)
    upper = size // 2
    photograph = "models/cupcake/sponge-cake-out-of-oven-8n-10.jpg"
    albedo[:upper] = library.picture(photograph, size, max(1, upper))[:upper]

    def both(name: str) -> np.ndarray:
        return np.concatenate([getattr(part, name)[part.faces] for part in (sponge, cup)])

    return meshes.from_corners(both("vertices"), both("texcoords"), both("normals")), albedo


def _print(positions: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """The cup's print, linear albedo (N, 3): chevrons between lines, dots above and below.

    By position in the model's own units, in which the cup stands on y = 0 around the y axis.
    """
    height = positions[:, 1] / CUP_TOP
    around = np.arctan2(positions[:, 2], positions[:, 0]) / (2 * np.pi)
    colour = np.broadcast_to(PAPER, positions.shape).copy()
    wave = np.abs((18 * around) % 1 - 0.5)
    chevron = np.abs((6 * (height - 0.35 * wave)) % 1 - 0.5) < 0.22
    middle = (height > 0.3) & (height < 0.72)
    colour[middle & chevron] = TEAL
    for low, high in ((0.27, 0.30), (0.72, 0.75)):
        colour[(height > low) & (height < high)] = BERRY
    for row in (0.15, 0.86):
        across, up = ((24 * around) % 1 - 0.5) * 0.72, (height - row) * CUP_TOP
        colour[np.hypot(across, up) < 0.2] = BERRY
    grain = 0.85 + 0.3 * fractal_noise(positions, 6, 4, seed=3)
    return np.clip(colour * grain[:, None], library.DARKEST, library.BRIGHTEST)


def _matt(colour: dict[str, Any]) -> dict[str, Any]:
    """On both sides: cup and bin are open sheets."""
    material = {"type": "principled", "base_color": colour, "roughness": 0.7}
    return {"type": "twosided", "bsdf": material}
