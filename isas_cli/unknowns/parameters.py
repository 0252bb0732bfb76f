"""Mitsuba's parameters: what can be an unknown at all, and their numbers as arrays."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np


def owner(params: mi.SceneParameters, key: str):
    """The object of the scene that holds the parameter."""
    return params.properties[key][2]


def held(holder: mi.Object) -> list[tuple[str, mi.Object]]:
    """The objects that one holds, each by its name there."""
    found: list[tuple[str, mi.Object]] = []

    class Held(mi.TraversalCallback):
        def put(self, name, value, flags, cpptype=None) -> None:
            if isinstance(value, mi.Object):
                found.append((name, value))

        put_object = put_value = put

    holder.traverse(Held())
    return found


def read(params: mi.SceneParameters, key: str):
    """The parameter's value; None where the object has none at present, which Mitsuba lists all
    the same."""
    try:
        return params[key]
    except TypeError:
        return None


def moves_geometry(params: mi.SceneParameters, key: str) -> bool:
    """Whether the parameter changes what is visible. Mitsuba's flag alone would not do: it also
    marks roughness and a phase function's g, whose lobes are smooth inside the legal range, and
    environment maps."""
    if isinstance(owner(params, key), (mi.BSDF, mi.Texture, mi.PhaseFunction)):
        return False
    return bool(params.flags(key) & mi.ParamFlags.Discontinuous)


def is_float(value) -> bool:
    """Whether it holds floating-point numbers, at least one, and is no matrix."""
    if not (dr.is_array_v(value) and dr.is_float_v(value)):
        return False
    return not dr.is_matrix_v(value) and dr.width(value) > 0


def is_differentiable(params: mi.SceneParameters, key: str) -> bool:
    """Whether Mitsuba keeps derivatives by the parameter, and no camera owns it."""
    value = read(params, key)
    if not (is_float(value) and dr.is_diff_v(value)):
        return False
    if isinstance(owner(params, key), (mi.Sensor, mi.Film)):
        return False
    fixed = mi.ParamFlags.NonDifferentiable | mi.ParamFlags.ReadOnly
    return not params.flags(key) & fixed


def is_grid(params: mi.SceneParameters, key: str) -> bool:
    """Whether the parameter is the grid of a volume."""
    return isinstance(owner(params, key), mi.Volume) and dr.is_tensor_v(params[key])


def as_numpy(value) -> np.ndarray:
    """A parameter as a float32 array: tensors keep their shape, colours become (3,). A copy: a view
    would not keep Dr.Jit's memory."""
    array = np.array(value, dtype=np.float32)
    return array if dr.is_tensor_v(value) else array.reshape(-1)


def own(kind: type, array: np.ndarray):
    """A flat ``array`` as ``kind``, in memory of Dr.Jit's own: frozen kernels go on seeing earlier
    values of what is NumPy's."""
    found = kind(np.ascontiguousarray(array)) + dr.opaque(kind, 0, len(array))
    dr.eval(found)
    return found


def like(kind: type, array: np.ndarray):
    """``array`` as a Dr.Jit value of the type ``kind``, in memory of its own (``own``)."""
    if not dr.is_tensor_v(kind) and array.size == dr.size_v(kind) > 1:
        # Opaque: literals would compile a kernel for every value that a gradient takes.
        return kind(*[dr.opaque(mi.Float, float(x)) for x in array])
    entries = own(mi.Float, array.reshape(-1).astype(np.float32, copy=False))
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
