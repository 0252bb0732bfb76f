"""Scenes on which defaults are chosen, so that those that judge them have no part in it.

Each in the place of `jumpydumpy`, with its unknown and its sizes, which `SETTINGS` does; none is
in `isas scenes`. What they differ in is what asks for one rate or another: detail of the size of a
texel or none, a matt surface or a glossy one, soft light or a sun, one bounce or several.
"""

from __future__ import annotations

from typing import Any

from isas_cli.scenes import library, meshes
from isas_cli.scenes.cameras import spiral
from isas_cli.scenes.plinth import plinth
from isas_cli.scenes.subdivide import subdivide

SCENES = ("hen", "cat", "jar")
# In the environment of what runs them, with the folder of this file on PYTHONPATH.
ALLOW = {"ISAS_ALLOW": "_choosing"}


def settings(scene: str) -> list[str]:
    """Of `isas run` and `isas race`."""
    return ["scene=jumpydumpy", f"scene.builder=_choosing.{scene}", f"scene.name={scene}"]


def hen(views: int, resolution: int, texture: int) -> dict[str, Any]:
    """Matt, a stone's picture with detail of all sizes, at sunset."""
    coarse = meshes.read_obj(library.asset("models/chicken/chicken.obj"))
    albedo = library.picture("models/rock1/rock01.jpg", texture, texture)
    material = {"type": "principled", "base_color": library.texture(albedo), "roughness": 0.9}
    return _scene(meshes.place(coarse), material, "hdri/sunset.exr", 2, views, resolution)


def cat(views: int, resolution: int, texture: int) -> dict[str, Any]:
    """Glazed, a planet's picture, soft but for some craters, under a high sun."""
    coarse = meshes.read_obj(library.asset("models/cat/cat.obj"))
    albedo = library.picture("textures/mars.png", texture, texture)
    material = {"type": "principled", "base_color": library.texture(albedo), "roughness": 0.25}
    figure = meshes.place(subdivide(coarse, levels=1, name="cat.obj"))
    return _scene(figure, material, "hdri/city.exr", 2, views, resolution)


def jar(views: int, resolution: int, texture: int) -> dict[str, Any]:
    """A jar of plain glaze over a picture of fur, in a wood; light between surfaces counts."""
    coarse = meshes.read_obj(library.asset("models/old_jar/old_jar.obj"))
    albedo = library.picture("models/cat/cat-texture.jpg", texture, texture)
    material = {"type": "principled", "base_color": library.texture(albedo), "roughness": 0.5}
    figure = meshes.place(subdivide(coarse, levels=1, name="old_jar.obj"))
    return _scene(figure, material, "hdri/forest.exr", 4, views, resolution)


def _scene(figure, material: dict, sky: str, depth: int, views: int, resolution: int) -> dict:
    around = {"target": (0.0, 0.5, 0.0), "distance": 3.0, "field_of_view": 25.0}
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": depth},
        "sky": library.environment(sky),
        "figure": meshes.shape("figure", figure, material),
        "plinth": plinth(0.5),
        **spiral(views, resolution, **around, elevations=(4.0, 50.0)),
    }
