"""Paint that is defined in space, written into a texture atlas.

A pattern that is a function of the position on the object has no seams where the charts of the
atlas meet, which a pattern drawn in texture coordinates always has.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import ndimage

from .meshes import Surface

# Paint is averaged over at least this many points a side of each texel, and more in small
# textures, whose texels hold whole strokes. Textures beyond the limit would take too long.
POINTS_PER_SIDE = 2
COARSEST_GRID = 512
LARGEST_AVERAGED = 1024


def bake(
    surface: Surface, size: int, paint: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> np.ndarray:
    """Texture (size, size, 3) float32 of `paint(positions (N, 3), normals (N, 3)) -> (N, 3)`.

    Texels outside all charts take the value of the nearest texel inside one, so that bilinear
    lookups at the borders of a chart see no foreign colour.
    """
    finer = max(POINTS_PER_SIDE, -(-COARSEST_GRID // size)) if size <= LARGEST_AVERAGED else 1
    positions, normals, covered = unfold(surface, size * finer)
    image = np.zeros(covered.shape + (3,), dtype=np.float32)
    image[covered] = paint(positions[covered], normals[covered])
    nearest = ndimage.distance_transform_edt(~covered, return_distances=False, return_indices=True)
    image = image[tuple(nearest)]
    return image.reshape(size, finer, size, finer, 3).mean(axis=(1, 3))


def unfold(surface: Surface, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What each texel of a square atlas shows.

    Returns positions and normals, (size, size, 3) float32 each, and whether the texel's centre
    lies in a chart, (size, size) bool. The atlas is looked at as a flat mesh whose positions
    are the texture coordinates: the renderer's ray casting serves as the rasteriser.
    """
    import mitsuba as mi

    flat = mi.Mesh("atlas", len(surface.vertices), len(surface.faces))
    values = mi.traverse(flat)
    depth = np.zeros((len(surface.vertices), 1), dtype=np.float32)
    values["vertex_positions"] = np.hstack([surface.texcoords, depth]).ravel()
    values["faces"] = surface.faces.ravel()
    values.update()
    flat.add_attribute("vertex_place", 3, surface.vertices.ravel())
    flat.add_attribute("vertex_facing", 3, surface.normals.ravel())
    scene = mi.load_dict({"type": "scene", "atlas": flat}, optimize=False)

    v, u = ((np.indices((size, size), dtype=np.float32) + 0.5) / size).reshape(2, -1)
    hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(u, v, 1.0), mi.Vector3f(0, 0, -1)))
    covered = np.array(hit.is_valid()).reshape(size, size)

    def attribute(name: str) -> np.ndarray:
        value = flat.eval_attribute_3(name, hit, hit.is_valid())
        return np.array(value).T.reshape(size, size, 3)

    return attribute("vertex_place"), attribute("vertex_facing"), covered
