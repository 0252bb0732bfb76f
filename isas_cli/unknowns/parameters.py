"""Mitsuba's parameters: which can be unknown, and their numbers as arrays."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np


def owner(params: mi.SceneParameters, key: str):
    """The object of the scene that holds the parameter."""
    return params.properties[key][2]


def is_environment(params: mi.SceneParameters, key: str) -> bool:
    """Whether the parameter is the picture of an environment map."""
    return isinstance(owner(params, key), mi.Emitter) and dr.is_tensor_v(params[key])


def moves_geometry(params: mi.SceneParameters, key: str) -> bool:
    """Whether the parameter changes what is visible. Mitsuba's flag alone would not do: it also
    marks roughness, whose lobe is smooth inside the legal range, and environment maps."""
    if isinstance(owner(params, key), (mi.BSDF, mi.Texture)) or is_environment(params, key):
        return False
    return bool(params.flags(key) & mi.ParamFlags.Discontinuous)


def is_float(value) -> bool:
    """Whether it holds floating-point numbers, at least one, and is no matrix."""
    if not (dr.is_array_v(value) and dr.is_float_v(value)):
        return False
    return not dr.is_matrix_v(value) and dr.width(value) > 0


def differentiable_keys(params: mi.SceneParameters) -> list[str]:
    """All keys that path replay can differentiate: floating point, not moving geometry."""
    keys = []
    for key in params.keys():
        if not (is_float(params[key]) and dr.is_diff_v(params[key])):
            continue
        if isinstance(owner(params, key), (mi.Sensor, mi.Film)):
            continue
        if params.flags(key) & mi.ParamFlags.NonDifferentiable or moves_geometry(params, key):
            continue
        keys.append(key)
    return keys


def as_numpy(value) -> np.ndarray:
    """A parameter as a float32 array: tensors keep their shape, colours become (3,)."""
    array = np.asarray(value, dtype=np.float32)
    return array if dr.is_tensor_v(value) else array.reshape(-1)


def loaded(params: mi.SceneParameters, key: str) -> np.ndarray:
    """The scene's value of a parameter, in the shape that it has as an unknown.

    An environment map of (H, W, 3) texels is kept by Mitsuba as (H, W + 2, 3): its last column
    stands before the first once more, and its first behind the last. Only the W in between are
    unknown (``Unknowns`` puts the others around them).
    """
    array = as_numpy(params[key])
    return array[:, 1:-1].copy() if is_environment(params, key) else array


def like(template, array: np.ndarray):
    """``array`` as a Dr.Jit value of the type of ``template``, in memory of its own: frozen kernels
    go on seeing earlier values of a texture of one channel whose memory is NumPy's."""
    kind = type(template)
    if not dr.is_tensor_v(kind) and array.size == dr.size_v(kind) > 1:
        return kind(*[float(x) for x in array])
    entries = mi.Float(np.ascontiguousarray(array.reshape(-1), dtype=np.float32))
    entries = entries + dr.opaque(mi.Float, 0, entries.shape[0])
    dr.eval(entries)
    if dr.is_tensor_v(kind):
        return kind(entries, array.shape)
    return dr.unravel(kind, entries) if dr.size_v(kind) > 1 else kind(entries)


def flat(value) -> mi.Float:
    """All entries of a parameter as one flat array, in Dr.Jit's order. Traced."""
    return value.array if dr.is_tensor_v(value) else dr.ravel(value)


def unflat(template, entries: mi.Float):
    """The inverse of ``flat`` for a parameter of the type and shape of ``template``."""
    if dr.is_tensor_v(template):
        return type(template)(entries, template.shape)
    return dr.unravel(type(template), entries)


def textures(params: mi.SceneParameters, keys: list[str]) -> dict[str, mi.Texture]:
    """Of ``keys``, those of texels laid out on a surface, with the texture that holds them."""
    tensors = [key for key in keys if key in params and dr.is_tensor_v(params[key])]
    owners = {key: owner(params, key) for key in tensors}
    return {key: found for key, found in owners.items() if isinstance(found, mi.Texture)}


def wrapped(shape: tuple[int, int, int]) -> mi.UInt32:
    """For each entry of an environment map of ``shape (H, W + 2, C)``: which entry of the
    (H, W, C) texels stands there."""
    height, width, channels = shape
    texels = np.arange(height * (width - 2) * channels, dtype=np.uint32)
    texels = texels.reshape(height, width - 2, channels)
    return mi.UInt32(np.pad(texels, ((0, 0), (1, 1), (0, 0)), mode="wrap").ravel())
