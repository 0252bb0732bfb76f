"""By which parameters a path's derivative is none, or a wrong one, and what is done instead.

Path replay differentiates the values of materials and lights along directions that stay. What
Mitsuba makes of a parameter on the side, in plain numbers, it does not see, nor what moves the
directions of mirrors and clear glass. benchmarks/derivatives.py measures all that Mitsuba has.
"""

from __future__ import annotations

import functools
import operator

import mitsuba as mi
import numpy as np

from .parameters import held, owner
from .ranges import fed

# By the class of what takes the parameter and its name there: why a path's derivative is not all.
_ASIDE = {
    ("RoughPlastic", "alpha"): "Mitsuba makes tables of it, through which no derivative flows",
    ("RoughPlastic", "eta"): "Mitsuba makes tables of it, through which no derivative flows",
    ("HeterogeneousMedium", "sigma_t"): (
        "where the density is the largest that there is, Mitsuba samples nothing that tells less"
    ),
    ("PolarizedPlastic", "eta"): "a part of its derivative is lost within Mitsuba",
}
_SPLATS = "Ellipsoids", "EllipsoidsMesh"
# What turns the frame that a material scatters in.
_TURNING = "normalmap", "nested_texture"
# Materials that have the lobes of what they are made of, and no other.
_OF_PARTS = "BlendBSDF", "TwoSidedBRDF", "BumpMap", "NormalMap"


def aside(params: mi.SceneParameters, key: str) -> str:
    """Why differences of renderings are taken by the parameter beside path replay; or nothing."""
    reasons = (_ASIDE.get((holder.class_name(), word)) for holder, word, _ in fed(params, key))
    return next(filter(None, reasons), "")


def refusal(params: mi.SceneParameters, key: str) -> str:
    """Why no estimator has the right derivative by the parameter, and what to do; or nothing."""
    name = key.rpartition(".")[2]
    if name == "vertex_texcoords":
        return "no derivative by texture coordinates is taken: find the texture itself"
    if name.startswith(("vertex_", "face_")) and channels(params, key) not in (1, 3):
        return (
            f"it holds {channels(params, key)} numbers each, and Mitsuba's mesh_attribute shows "
            "1 or 3: write the colours without alpha"
        )
    if owner(params, key).class_name() in _SPLATS and name == "data":
        return "it moves and turns ellipsoids, which path replay does not differentiate"
    if "opacity" in key.split("."):
        for holder, word, _ in fed(params, key):
            inside = dict(held(holder)).get("nested_bsdf") if word == "opacity" else None
            if inside is not None and inside.class_name() == "Null":
                return "it changes nothing: what it masks lets all light through, as a gap does"
    for holder, word, _ in fed(params, key):
        sharp = mi.BSDFFlags.DeltaReflection | mi.BSDFFlags.DeltaTransmission
        if word in _TURNING and flags(holder) & sharp:
            return (
                "it turns what mirrors and clear glass show, which path replay does not "
                "differentiate: give the material under it a roughness"
            )
        if word == "spec_trans" and _two_sided(params, holder):
            return (
                "twosided takes no material that lets light through: take it away, or leave this "
                "out"
            )
    return ""


def channels(params: mi.SceneParameters, key: str) -> int:
    """Numbers a vertex or face of a mesh attribute."""
    shape, name = owner(params, key), key.rpartition(".")[2]
    count = shape.vertex_count() if name.startswith("vertex_") else shape.face_count()
    return int(np.prod(np.shape(params[key]))) // max(1, count)


def _two_sided(params: mi.SceneParameters, bsdf: mi.BSDF) -> bool:
    """Whether a material is, at any depth, within one of two sides."""
    wholes = (each for each in params.hierarchy if each.class_name() == "TwoSidedBRDF")
    return any(bsdf in mi.traverse(whole).hierarchy for whole in wholes)


def flags(bsdf: mi.BSDF) -> int:
    """What lobes a material has, as ``mi.BSDFFlags``; of hair without the gap that Mitsuba lists
    for it and never draws."""
    name = bsdf.class_name()
    if name in _OF_PARTS:
        parts = (each for _, each in held(bsdf) if isinstance(each, mi.BSDF))
        return functools.reduce(operator.or_, map(flags, parts))
    return bsdf.flags() & ~mi.BSDFFlags.Null if name == "Hair" else bsdf.flags()


def discrete(bsdf: mi.BSDF) -> list[int]:
    """The numbers of a material's lobes that have no density."""
    if not mi.has_flag(flags(bsdf), mi.BSDFFlags.Delta):
        return []
    every = (bsdf.flags(number) for number in range(bsdf.component_count()))
    return [k for k, own in enumerate(every) if mi.has_flag(own, mi.BSDFFlags.Delta)]
