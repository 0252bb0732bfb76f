"""Scenes on which defaults are chosen, so that those that judge them have no part in it.

Each in the place of `jumpydumpy`, with its unknown and its sizes (`choosing.py`); none is in
`isas scenes`. What they differ in is what asks for one rate or another: detail of the size of a
texel or none, a matt surface or a glossy one, soft light or a sun, one bounce or several.
"""

from __future__ import annotations

from typing import Any

from isas_cli.scenes import library, meshes
from isas_cli.scenes.cameras import spiral
from isas_cli.scenes.plinth import plinth
from isas_cli.scenes.subdivide import subdivide

SCENES = ("hen", "cat", "jar")


def hen(views: int, resolution: int, texture: int) -> dict[str, Any]:
    """Matt, a stone's picture with detail of all sizes, at sunset."""
    own = "models/chicken/chicken.obj", 0, "models/rock1/rock01.jpg", 0.9, "hdri/sunset.exr", 2
    return _scene(*own, views, resolution, texture)


def cat(views: int, resolution: int, texture: int) -> dict[str, Any]:
    """Glazed, a planet's picture, soft but for some craters, under a high sun."""
    own = "models/cat/cat.obj", 1, "textures/mars.png", 0.25, "hdri/city.exr", 2
    return _scene(*own, views, resolution, texture)


def jar(views: int, resolution: int, texture: int) -> dict[str, Any]:
    """A jar of plain glaze over a picture of fur, in a wood; light between surfaces counts."""
    own = "models/old_jar/old_jar.obj", 1, "models/cat/cat-texture.jpg", 0.5, "hdri/forest.exr", 4
    return _scene(*own, views, resolution, texture)


def _scene(
    model: str,
    levels: int,
    picture: str,
    roughness: float,
    sky: str,
    depth: int,
    views: int,
    resolution: int,
    texture: int,
) -> dict[str, Any]:
    surface = meshes.read_obj(library.asset(model))
    if levels:
        surface = subdivide(surface, levels=levels, name=model)
    material = {
        "type": "principled",
        "base_color": library.texture(library.picture(picture, texture, texture)),
        "roughness": roughness,
    }
    around = {"target": (0.0, 0.5, 0.0), "distance": 3.0, "field_of_view": 25.0}
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": depth},
        "sky": library.environment(sky),
        "figure": meshes.shape("figure", meshes.place(surface), material),
        "plinth": plinth(0.5),
        **spiral(views, resolution, **around, elevations=(4.0, 50.0)),
    }
