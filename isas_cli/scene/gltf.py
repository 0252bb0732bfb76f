"""A scene's surfaces as one binary glTF 2.0 file, for programs that know nothing of Mitsuba.

Coordinates are the scene's; glTF calls y up. trimesh writes the file. What it would round, merge or
has no word for is put into its description of the file before that is written: factors of
materials, samplers, several sets of texture coordinates, extensions.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import mitsuba as mi
import numpy as np

from .. import __version__
from ..runtime import images
from ..runtime.files import write_atomically
from . import gltf_materials, gltf_surfaces
from .gltf_maps import Picture, Said, packed
from .gltf_materials import Material
from .gltf_surfaces import Front

if TYPE_CHECKING:
    import trimesh

# More is not told of what a file leaves out.
_MOST = 12
_UNTURNED = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
# What glTF has for Mitsuba's words.
_WRAPS = {"repeat": 10497, "mirror": 33648, "clamp": 33071}
_FILTERS = {"nearest": (9728, 9728), "bilinear": (9729, 9987)}  # of large texels, and of small
_VERTICES, _INDICES = 34962, 34963
_FLOATS = {"VEC2": 2, "VEC3": 3, "VEC4": 4}


def write(scene: mi.Scene, path: Path, said: Said) -> list[str]:
    """Writes ``path``, or nothing where nothing has a surface; returns lines about what the file
    leaves out."""
    import trimesh
    from trimesh.exchange.gltf import export_glb

    made = trimesh.Scene(base_frame="")
    left, palette = _beside(scene), _Palette(said)
    for shape in scene.shapes():
        bsdf = shape.bsdf()
        if bsdf is not None and bsdf.class_name() == "Null":
            continue
        front = None
        if bsdf is not None:
            material = palette.material(bsdf, shape.id())
            flipped = said(shape) is not None and said(shape).get("flip_normals", False)
            bumpy = material.normals is not None
            front = gltf_surfaces.front(shape, flipped, material.pictured, bumpy)
        if front is None:
            left.append(f"the shape '{shape.id()}'")
            continue
        painted = palette.painted(bsdf, gltf_surfaces.mirrored(front.surface))
        made.add_geometry(_mesh(shape, front, painted), shape.id(), shape.id())
    if not made.geometry:
        path.unlink(missing_ok=True)
        return [f"no {path.name}: nothing in it has a surface that glTF could hold"]
    told = list(dict.fromkeys([*left, *palette.left()]))
    if len(told) > _MOST:
        told[_MOST:] = [f"and {len(told) - _MOST} more"]
    content = export_glb(made, tree_postprocessor=lambda tree: _finish(tree, palette.named))
    write_atomically(path, lambda temporary: temporary.write_bytes(content))
    return [f"{path.name} leaves out: {', '.join(told)}"] if told else []


@dataclass(frozen=True)
class _Painted:
    """A material of the file's, of that ``name``: its pictures, and ``turns``, which make its sets
    of texture coordinates of a mesh's own. ``turned``: the second axis of its normals."""

    name: str
    material: Material
    turned: bool
    colour: Picture
    rough: Picture
    normals: Picture | None

    @property
    def pictures(self) -> list[Picture]:
        every = self.colour, self.rough, self.normals
        return [each for each in every if each is not None and each.pixels is not None]

    @cached_property
    def shown(self) -> trimesh.visual.material.PBRMaterial:
        """As trimesh has it, with the pictures once for all shapes."""
        return _material(self)

    @property
    def turns(self) -> list[tuple]:
        return list(dict.fromkeys(each.turn for each in self.pictures))


def _beside(scene: mi.Scene) -> list[str]:
    """What is no surface."""
    environment = scene.environment()
    of_shapes = [shape.emitter() for shape in scene.shapes() if shape.is_emitter()]
    found = [] if environment is None else [f"the environment '{environment.id()}'"]
    for each in scene.emitters():
        if each != environment and each not in of_shapes:
            found.append(f"the light '{each.id()}'")
    for shape in scene.shapes():
        if shape.is_emitter():
            found.append(f"the light of '{shape.id()}'")
        if shape.interior_medium() is not None:
            found.append(f"the volume in '{shape.id()}'")
    return found


class _Palette:
    """Materials, each once for all shapes that share it."""

    def __init__(self, said: Said):
        self.said = said
        self.named: dict[str, _Painted] = {}
        self._read: dict[mi.BSDF, Material] = {}
        self._names: set[str] = set()
        self._painted: dict[tuple, _Painted] = {}

    def material(self, bsdf: mi.BSDF, shape: str) -> Material:
        """``shape``: what it is called after where it has no name of its own."""
        if bsdf not in self._read:
            name = self.said.name(bsdf) or shape
            self._read[bsdf] = gltf_materials.read(bsdf, unlike(name, self._names), self.said)
            self._names.add(self._read[bsdf].name)
        return self._read[bsdf]

    def painted(self, bsdf: mi.BSDF, mirrored: bool | None) -> _Painted:
        """Of a shape whose texture coordinates are ``mirrored``, or, None, some of them."""
        material = self._read[bsdf]
        turned = bool(mirrored) and material.normals is not None
        if mirrored is None and material.normals is not None:
            material.leave(
                "the normal map where coordinates are mirrored, for what heeds no tangents,"
            )
        if (bsdf, turned) not in self._painted:
            normals = None
            if material.normals is not None:
                normals = packed(material.leave, **{"normal map": material.normals.of(3)})
            if turned:  # Mitsuba's second axis is then glTF's, turned round
                sign, more = np.float32([1, -1, 1]), np.float32([0, 1, 0])
                normals = replace(normals, pixels=normals.pixels * sign + more)
            name = unlike(material.name, self.named)
            self.named[name] = self._painted[bsdf, turned] = _Painted(
                name,
                material,
                turned,
                packed(material.leave, colour=material.colour, opacity=material.opacity),
                packed(material.leave, roughness=material.roughness, metallic=material.metallic),
                normals,
            )
        return self._painted[bsdf, turned]

    def left(self) -> list[str]:
        return [what for each in self._read.values() for what in each.left]


def unlike(name: str, taken: Iterable[str]) -> str:
    """``name``, with a number behind it where another that is ``taken`` has it."""
    every = itertools.chain([name], (f"{name}_{number}" for number in itertools.count(2)))
    return next(each for each in every if each not in taken)


def _mesh(shape: mi.Shape, front: Front, painted: _Painted) -> trimesh.Trimesh:
    import trimesh

    surface, attributes = front.surface, {}
    if len(surface.normals):
        attributes["NORMAL"] = surface.normals
    if painted.normals is not None:
        attributes["TANGENT"] = gltf_surfaces.tangents(surface, painted.turned)
    if (colours := _colours(shape, painted.material)) is not None:
        attributes["COLOR_0"] = colours[front.origin]
    for number, turn in enumerate(painted.turns or [_UNTURNED]):
        if len(surface.texcoords):
            matrix = np.reshape(turn, (3, 3))
            turned = surface.texcoords @ matrix[:2, :2].T + matrix[:2, 2]
            attributes[f"TEXCOORD_{number}"] = turned.astype(np.float32)
    visual = trimesh.visual.TextureVisuals(material=painted.shown)
    return trimesh.Trimesh(
        surface.vertices, surface.faces, vertex_attributes=attributes, visual=visual, process=False
    )


def _colours(shape: mi.Shape, material: Material) -> np.ndarray | None:
    """Of the shape's vertices, ``(V, 3)``, where its material shows them."""
    name, values = material.attribute, mi.traverse(shape)
    if name is None or name not in values:
        return None
    found = np.array(values[name]).reshape(shape.vertex_count(), -1)
    if found.shape[1] not in (1, 3):
        material.leave(f"'{name}', which holds {found.shape[1]} numbers each,")
        return None
    if found.min() < 0 or found.max() > 1:
        material.leave(f"what lies outside 0 to 1 in '{name}'")
    return np.broadcast_to(np.clip(found, 0, 1), (len(found), 3)).astype(np.float32)


def _material(painted: _Painted) -> trimesh.visual.material.PBRMaterial:
    """As trimesh has it: the name and the pictures; numbers are put in by ``_finish``."""
    import trimesh

    pictures = {"baseColorTexture": _shown(painted.colour.pixels)}
    if (pixels := painted.rough.pixels) is not None:
        unused = np.ones_like(pixels[..., :1])  # where others keep how much is occluded
        pictures["metallicRoughnessTexture"] = _stored(np.concatenate([unused, pixels], axis=2))
    if painted.normals is not None:
        pictures["normalTexture"] = _stored(painted.normals.pixels)
    return trimesh.visual.material.PBRMaterial(name=painted.name, **pictures)


def _shown(pixels: np.ndarray | None):
    """Colour and opacity as a picture, the colour encoded as sRGB; without an opacity of 1."""
    from PIL import Image

    if pixels is None:
        return None
    colour = images.to_display(pixels[..., :3])
    alpha = np.rint(pixels[..., 3:] * 255).astype(np.uint8)
    return Image.fromarray(
        colour if (alpha == 255).all() else np.concatenate([colour, alpha], axis=2)
    )


def _stored(pixels: np.ndarray):
    from PIL import Image

    return Image.fromarray(np.rint(pixels * 255).astype(np.uint8))


def _finish(tree: dict, known: dict[str, _Painted]) -> None:
    """Puts into the description of the file what trimesh has no word for, or would round."""
    tree["asset"]["generator"] = f"isas {__version__}, by trimesh"
    samplers: list[dict] = []
    for entry in tree["materials"]:
        _describe(entry, known[entry["name"]], tree, samplers)
    if samplers:
        tree["samplers"] = samplers
    used = {name for entry in tree["materials"] for name in entry.get("extensions", {})}
    if used:
        tree["extensionsUsed"] = sorted(used)
    for mesh in tree["meshes"]:
        if not mesh.get("extras", True):
            del mesh["extras"]
        for each in mesh["primitives"]:
            own = {name.removeprefix("_"): at for name, at in each["attributes"].items()}
            each["attributes"] = own
            tree["bufferViews"][tree["accessors"][each["indices"]]["bufferView"]]["target"] = (
                _INDICES
            )
            for at in own.values():
                accessor = tree["accessors"][at]
                view = tree["bufferViews"][accessor["bufferView"]]
                # Equal numbers are stored once, and what several read has to say how.
                view |= {"target": _VERTICES, "byteStride": 4 * _FLOATS[accessor["type"]]}


def _describe(entry: dict, painted: _Painted, tree: dict, samplers: list[dict]) -> None:
    material, inside = painted.material, entry.setdefault("pbrMetallicRoughness", {})
    inside["baseColorFactor"] = painted.colour.factors.tolist()
    inside["roughnessFactor"], inside["metallicFactor"] = painted.rough.factors.tolist()
    entry["doubleSided"] = material.two_sided
    pixels = painted.colour.pixels
    alpha = painted.colour.factors[3] * (np.ones(1) if pixels is None else pixels[..., 3])
    # One that stands otherwise than the colour is written as its mean.
    opacity = material.opacity.texels if np.ptp(alpha) else alpha
    if (opacity < 1).any():
        entry["alphaMode"] = "MASK" if np.isin(opacity, (0, 1)).all() else "BLEND"
    if material.extensions:
        entry["extensions"] = material.extensions
    pictures = (
        (inside, "baseColorTexture", painted.colour),
        (inside, "metallicRoughnessTexture", painted.rough),
        (entry, "normalTexture", painted.normals),
    )
    for where, name, picture in pictures:
        if name not in where:
            continue
        if (number := painted.turns.index(picture.turn)) > 0:
            where[name]["texCoord"] = number
        wrap, (large, small) = _WRAPS[picture.wrap], _FILTERS[picture.filter]
        sampler = {"magFilter": large, "minFilter": small, "wrapS": wrap, "wrapT": wrap}
        if sampler not in samplers:
            samplers.append(sampler)
        tree["textures"][where[name]["index"]]["sampler"] = samplers.index(sampler)
