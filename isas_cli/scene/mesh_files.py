"""Meshes as files that other programs read."""

from __future__ import annotations

import numpy as np

from ..runtime import images


def upwards(texcoords: np.ndarray) -> np.ndarray:
    """Texture coordinates as Mitsuba has them, ``(n, 2)``, v down the picture, as OBJ files have
    them, v up; and back."""
    return texcoords * [1, -1] + [0, 1]


def painted(
    name: str,
    vertices: np.ndarray,
    faces: np.ndarray,
    texcoords: np.ndarray,
    colour: np.ndarray | str,
) -> dict[str, bytes]:
    """OBJ, its MTL and the PNG that this names, by file name; ``colour (H, W, 3)``, linear, or the
    name of a PNG that is there."""
    import trimesh
    from PIL import Image
    from trimesh.exchange.obj import export_obj

    there = isinstance(colour, str)
    image = Image.new("RGB", (1, 1)) if there else Image.fromarray(images.to_display(colour))
    material = trimesh.visual.material.SimpleMaterial(
        image=image, diffuse=[255, 255, 255, 255], name=name
    )
    visual = trimesh.visual.TextureVisuals(uv=upwards(texcoords), material=material)
    mesh = trimesh.Trimesh(vertices, faces, visual=visual, process=False)
    text, files = export_obj(mesh, return_texture=True, mtl_name=f"{name}.mtl")
    if there:
        (own,) = (file for file in files if not file.endswith(".mtl"))
        del files[own]
        mtl = f"{name}.mtl"
        files[mtl] = files[mtl].replace(f"map_Kd {own}".encode(), f"map_Kd {colour}".encode())
    return {f"{name}.obj": text.encode(), **files}
