"""Meshes as files that other programs read."""

from __future__ import annotations

import numpy as np

from ..runtime import images


def upwards(texcoords: np.ndarray) -> np.ndarray:
    """Texture coordinates as Mitsuba has them, ``(n, 2)``, v down the picture, as OBJ files have
    them, v up; and back."""
    return texcoords * [1, -1] + [0, 1]


def painted(
    name: str, vertices: np.ndarray, faces: np.ndarray, texcoords: np.ndarray, colour: np.ndarray
) -> dict[str, bytes]:
    """OBJ, its MTL and the PNG that this names, by file name; ``colour (H, W, 3)``, linear."""
    import trimesh
    from PIL import Image
    from trimesh.exchange.obj import export_obj

    material = trimesh.visual.material.SimpleMaterial(
        image=Image.fromarray(images.to_display(colour)), diffuse=[255, 255, 255, 255], name=name
    )
    visual = trimesh.visual.TextureVisuals(uv=upwards(texcoords), material=material)
    mesh = trimesh.Trimesh(vertices, faces, visual=visual, process=False)
    text, files = export_obj(mesh, return_texture=True, mtl_name=f"{name}.mtl")
    return {f"{name}.obj": text.encode(), **files}
