"""Mitsuba's materials in the terms of glTF 2.0: base colour, opacity, roughness, metalness, and a
normal map. What these cannot say is collected in words."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import mitsuba as mi
import numpy as np

from ..unknowns.parameters import as_numpy, held
from .gltf_maps import Map, Said, constant
from .gltf_maps import read as read_map

# What of a material that is not listed below is its colour.
_COLOURS = "base_color", "reflectance", "diffuse_reflectance", "diffuse"
# Lobes of the principled material that glTF's has not, nor an extension with the same meaning.
_BESIDE = "anisotropic", "spec_trans", "spec_tint", "sheen", "flatness", "clearcoat"
_GREY, _IOR = 0.5, 1.5


@dataclass
class Material:
    """``attribute``: the mesh's, one colour a vertex, that its colour is to be multiplied by;
    ``extensions``: glTF's, by name; ``left``: what is not said, in words."""

    name: str
    two_sided: bool = False
    colour: Map = field(default_factory=lambda: constant(_GREY, _GREY, _GREY))
    opacity: Map = field(default_factory=lambda: constant(1.0))
    roughness: Map = field(default_factory=lambda: constant(1.0))
    metallic: Map = field(default_factory=lambda: constant(0.0))
    normals: Map | None = None
    attribute: str | None = None
    extensions: dict[str, dict] = field(default_factory=dict)
    left: list[str] = field(default_factory=list)

    @property
    def pictured(self) -> bool:
        every = self.colour, self.opacity, self.roughness, self.metallic, self.normals
        return any(each is not None and each.turn is not None for each in every)

    def leave(self, what: str) -> None:
        self.left.append(f"{what} of '{self.name}'")


def read(bsdf: mi.BSDF, name: str, said: Said) -> Material:
    """``bsdf`` as glTF has it, called ``name``."""
    found = Material(name)
    _read(bsdf, found, said)
    return found


def _read(bsdf: mi.BSDF, found: Material, said: Said) -> None:
    _KINDS.get(bsdf.class_name(), _other)(bsdf, found, said)


def _two_sided(bsdf: mi.BSDF, found: Material, said: Said) -> None:
    front, *others = (inner for _, inner in held(bsdf))
    found.two_sided = True
    if any(inner != front for inner in others):
        found.leave("the back")
    _read(front, found, said)


def _masked(bsdf: mi.BSDF, found: Material, said: Said) -> None:
    parts = dict(held(bsdf))
    inner = next(part for part in parts.values() if isinstance(part, mi.BSDF))
    _read(inner, found, said)
    if "opacity" in parts:
        found.opacity = read_map(parts["opacity"], "opacity", found.leave, said).of(1)
    else:
        found.opacity = constant(float(as_numpy(mi.traverse(bsdf)["opacity"]).mean()))


def _normal_map(bsdf: mi.BSDF, found: Material, said: Said) -> None:
    parts = dict(held(bsdf))
    _read(next(part for part in parts.values() if isinstance(part, mi.BSDF)), found, said)
    normals = read_map(parts["normalmap"], "normal map", found.leave, said)
    turn = normals.turn and np.reshape(normals.turn, (3, 3))
    if normals.turn is not None and (turn[0, 1] or turn[1, 0] or turn[0, 0] < 0 or turn[1, 1] < 0):
        # glTF's axes turn with the picture, and Mitsuba's do not.
        found.leave("the normal map, which is turned,")
    elif normals.turn is not None:
        found.normals = normals


def _bumps(bsdf: mi.BSDF, found: Material, said: Said) -> None:
    found.leave("the bump map")
    _read(next(part for _, part in held(bsdf) if isinstance(part, mi.BSDF)), found, said)


def _diffuse(bsdf: mi.BSDF, found: Material, said: Said) -> None:
    found.colour = _colour(dict(held(bsdf))["reflectance"], found, said)
    found.extensions |= _MATT


def _principled(bsdf: mi.BSDF, found: Material, said: Said) -> None:
    parts, numbers = dict(held(bsdf)), mi.traverse(bsdf)
    found.colour = _colour(parts["base_color"], found, said)
    for name in ("roughness", "metallic"):
        if name in parts:
            setattr(found, name, read_map(parts[name], name, found.leave, said).of(1))
    for name in _BESIDE:
        if name in parts and np.any(read_map(parts[name], name, found.leave, said).texels):
            found.leave(f"'{name}'")
    ior = _IOR
    if "eta" in numbers:
        ior = float(as_numpy(numbers["eta"]).mean())
    elif "specular" in numbers:
        ior = 2 / (1 - math.sqrt(0.08 * float(as_numpy(numbers["specular"]).mean()))) - 1
    if ior < 1:
        found.leave("an 'eta' below 1")
    elif abs(ior - _IOR) > 1e-4:
        found.extensions["KHR_materials_ior"] = {"ior": ior}


def _metal(bsdf: mi.BSDF, found: Material, said: Said) -> None:
    """In the colour that it reflects at a right angle."""
    parts = {
        name: read_map(texture, name, found.leave, said)
        for name, texture in held(bsdf)
        if isinstance(texture, mi.Texture)
    }
    η, k = (parts[name].mean().of(3).texels for name in ("eta", "k"))
    reflected = ((η - 1) ** 2 + k**2) / ((η + 1) ** 2 + k**2)
    tint = parts.get("specular_reflectance", constant(1.0)).of(3)
    found.colour = replace(tint, texels=tint.texels * reflected)
    # glTF's roughness is the root of the lobe's width.
    width = parts.get("alpha", parts.get("alpha_u", constant(0.0))).of(1)
    found.roughness, found.metallic = replace(width, texels=np.sqrt(width.texels)), constant(1.0)
    found.leave(f"all but colour and roughness of the '{said.kind(bsdf)}'")


def _other(bsdf: mi.BSDF, found: Material, said: Said) -> None:
    """Matt, in what is its colour or, of several together, the first one's."""
    parts = dict(held(bsdf))
    kind = said.kind(bsdf)
    name = next((name for name in _COLOURS if name in parts), None)
    inner = next((part for part in parts.values() if isinstance(part, mi.BSDF)), None)
    if name is not None:
        found.colour = _colour(parts[name], found, said)
        found.extensions |= _MATT
        found.leave(f"all but the colour of the '{kind}'")
    elif inner is not None:
        _read(inner, found, said)
        found.leave(f"all but the first part of the '{kind}'")
    else:
        found.extensions |= _MATT
        found.leave(f"the '{kind}', which is matt and grey there,")


# Otherwise what is matt in glTF has a rough gloss above it.
_MATT = {"KHR_materials_specular": {"specularFactor": 0.0}}
_KINDS = {
    "TwoSidedBRDF": _two_sided,
    "MaskBSDF": _masked,
    "NormalMap": _normal_map,
    "BumpMap": _bumps,
    "SmoothDiffuse": _diffuse,
    "Principled": _principled,
    "SmoothConductor": _metal,
    "RoughConductor": _metal,
}


def _colour(texture: mi.Texture, found: Material, said: Said) -> Map:
    named = said(texture)
    if texture.class_name() == "MeshAttribute" and named is not None:
        name = named["name"]
        if name.startswith("vertex_"):
            found.attribute = name
            return constant(*[named.get("scale", 1.0)] * 3)
    return read_map(texture, "colour", found.leave, said).of(3)
