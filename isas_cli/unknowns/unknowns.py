"""The unknowns of a scene, and their place in it."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..config.schema import BlurConfig
from ..runtime.errors import InputError
from .parameters import is_environment, like, loaded, wrapped
from .poses import Pose, Poses


@dataclass
class Unknown:
    """One unknown. ``start`` and ``truth`` are float32 arrays of the parameter's shape
    (``truth`` is None for photographs); ``low``, ``high``: legal range, parameter's unit;
    ``lr``: its own learning rate, or None for the optimiser's; ``seen``: which entries some view
    sees (bool, same shape), filled in by ``coverage``; ``blur``: of ``sampler=plateau``, or None;
    ``period``: after which a value means the same again (an angle's 360), or None; ``scale``: the
    size, in the unknown's unit, of what it is added to in the scene."""

    key: str
    start: np.ndarray
    truth: np.ndarray | None
    low: float
    high: float
    lr: float | None
    seen: np.ndarray | None = None
    blur: BlurConfig | None = None
    period: float | None = None
    scale: float = 1.0


def present(params: mi.SceneParameters, poses: Poses | None, key: str) -> np.ndarray:
    """The value that the scene was loaded with."""
    return poses.items[key].at if poses and key in poses else loaded(params, key)


class Unknowns:
    """The unknowns of one scene, and the only writer of the scene's parameters.

    ``leaves``: key → Dr.Jit value that the scene currently uses; after ``attach`` these carry
    gradients, and estimators add to them. (Of an environment map: the value that the scene's own
    is made from. Mitsuba makes it once more at each update, and only gradients at its origin stay.
    Likewise of a pose.)
    """

    def __init__(
        self, params: mi.SceneParameters, items: list[Unknown], poses: Poses | None = None
    ):
        self.params, self.items, self._poses = params, items, poses
        at_first = {u.key: present(params, poses, u.key) for u in items}
        self.poses = [u.key for u in items if poses and u.key in poses]
        own = [u.key for u in items if u.key not in self.poses]
        params.keep([*own, *(poses.keys(self.poses) if self.poses else ())])
        self._templates = {key: type(params[key])(params[key]) for key in own}
        self._templates |= {key: mi.Float(0) for key in self.poses}
        self._shapes = {key: params[key].shape for key in own if is_environment(params, key)}
        self._around = {key: wrapped(shape) for key, shape in self._shapes.items()}
        self.leaves = self.values_of(at_first)

    @property
    def moved(self) -> set[str]:
        """Ids of the objects that poses among the unknowns move."""
        return {id for key in self.poses for id in self._poses.items[key].ids}

    def written(self, key: str) -> list[str]:
        """The scene's parameters that the pose ``key`` writes."""
        return self._poses.keys([key])

    def place(self, key: str, where: str) -> tuple[Pose, np.ndarray]:
        """The translation ``key`` and where its parts were loaded (``Poses.middles``); raises
        InputError, naming ``where``, if it is none."""
        if key not in self.poses:
            raise InputError(f"{where}: only for what a pose moves")
        return self._poses.items[key], self._poses.middles(key, where)

    def __iter__(self):
        return iter(self.items)

    @property
    def keys(self) -> list[str]:
        return [u.key for u in self.items]

    def axes(self, key: str) -> tuple[tuple[int, bool], ...]:
        """Along which axes of an unknown's array entries are neighbours, and whether it closes on
        itself there."""
        if key in self._around:
            return ((0, False), (1, True))
        return ((0, False), (1, False)) if dr.is_tensor_v(self._templates[key]) else ()

    def values_of(self, arrays: dict[str, np.ndarray]) -> dict:
        """NumPy arrays by key → Dr.Jit values of the scene's types."""
        return {k: like(self._templates[k], a) for k, a in arrays.items()}

    def starts(self) -> dict:
        return self.values_of({u.key: u.start for u in self.items})

    def truths(self) -> dict | None:
        if any(u.truth is None for u in self.items):
            return None
        return self.values_of({u.key: u.truth for u in self.items})

    def write(self, values: dict) -> None:
        """Put values into the scene, without derivatives (for evaluation)."""
        self._update({key: dr.detach(value) for key, value in values.items()})

    def attach(self, values: dict) -> None:
        """Put values into the scene with fresh derivatives: the next backward pass adds to the
        gradients of ``leaves``. Must stay outside frozen kernels: inside, textures crash.

        While a scene is attached, forward passes through *another* scene of the process fail:
        Dr.Jit's virtual calls reach all materials there are. ``write`` ends it.
        """
        leaves = {key: type(value)(dr.detach(value)) for key, value in values.items()}
        dr.enable_grad(leaves)
        self._update(leaves)

    def _update(self, leaves: dict) -> None:
        origins = self.leaves | leaves
        for key, leaf in leaves.items():
            if key in self._around:
                entries = dr.gather(mi.Float, leaf.array, self._around[key])
                self.params[key] = type(leaf)(entries, self._shapes[key])
            elif key not in self.poses:
                self.params[key] = leaf
        if self.poses:
            placed = self._poses.placed({key: origins[key] for key in self.poses})
            dr.eval(placed)
            for key, value in placed.items():
                self.params[key] = value
        self.params.update()
        derived = [*self._around, *self.poses]
        self.leaves = {k: origins[k] if k in derived else self.params[k] for k in self.keys}

    def gradients(self) -> dict:
        """Gradients of the leaves, by key. Read after the frozen call, never returned from it."""
        return {k: dr.grad(v) for k, v in self.leaves.items()}

    def push_tangent(self, values: dict, tangents: dict) -> None:
        """Put values into the scene and push ``tangents`` (same shapes) towards the renderer.

        The edges are cleared on the way: only then may the integrator's loop pick the tangents
        up from the textures' own copies.
        """
        self.attach(values)
        for key, leaf in self.leaves.items():
            dr.set_grad(leaf, tangents[key])
            dr.enqueue(dr.ADMode.Forward, leaf)
        dr.traverse(dr.ADMode.Forward, dr.ADFlag.ClearEdges)
