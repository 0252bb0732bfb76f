"""The unknowns of a scene, and their place in it."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from ..config.schema import BlurConfig
from ..runtime.errors import InputError
from .kind import Kind
from .parameters import owner
from .ranges import fed

if TYPE_CHECKING:
    from .optics import Together


@dataclass
class Unknown:
    """One unknown. ``start`` and ``truth`` are float32 arrays of the shape of ``kind.present``
    (``truth`` is None for photographs); ``low``, ``high``: legal range, in its unit;
    ``lr``: its own learning rate, or None for the optimiser's; ``blur``: of ``sampler=plateau``, or
    None; ``during``: the shares of the budget at which it begins to move, rests, begins again, …;
    ``seen``: which entries some view sees (bool, same shape), filled in by ``coverage``;
    ``told``: the same as far as nothing of the truth tells it, or None where all entries count;
    ``unseen``: whether none sees any of it, so that it stays where it starts: ``seen`` has all;
    ``doubled``: the shares of the budget at which its resolution doubles until it is whole;
    ``schedule``, ``final``: of its rate, or None for what ``OptimizerConfig`` says; ``prior``: a
    factor on the prior's weights; ``speed``: a factor on the optimiser's rate, where it has none of
    its own; ``asked``: whether the configuration names it: what photographs make unknown by
    themselves may be seen by no view."""

    kind: Kind
    start: np.ndarray
    truth: np.ndarray | None
    low: float
    high: float
    lr: float | None
    blur: BlurConfig | None = None
    during: tuple[float, ...] = (0.0, 1.0)
    seen: np.ndarray | None = None
    doubled: tuple[float, ...] = ()
    schedule: str | None = None
    final: float | None = None
    prior: float = 1.0
    speed: float = 1.0
    asked: bool = True
    unseen: bool = False
    told: np.ndarray | None = None

    @property
    def key(self) -> str:
        return self.kind.key

    @property
    def scale(self) -> float:
        """The size, in the unknown's unit, of what it is added to in the scene."""
        return self.kind.scale

    @property
    def weighed(self) -> float:
        """The factor on the prior's weights, 0 where no view sees it."""
        return 0.0 if self.unseen else self.prior

    @property
    def paced(self) -> bool:
        """Whether its blur, levels or stages follow the budget."""
        return self.blur is not None or bool(self.doubled) or self.during != (0.0, 1.0)

    @property
    def lit(self) -> np.ndarray:
        """The start; of a light that is dark everywhere another value, where it is asked what any
        unknown shows: such a light shows nothing of what it will light."""
        if self.kind.role != "light" or self.start.any():
            return self.start
        return np.clip(np.ones_like(self.start), self.low, self.high)

    def moves(self, spent: float) -> bool:
        """Whether it is optimised at this share of the budget."""
        # Odd: it has begun once more than it has rested. An end at 1 never comes.
        passed = sum(share <= spent for share in self.during if share < 1)
        return passed % 2 == 1

    def error(self, array: np.ndarray) -> float:
        """How far ``array`` is from the known truth over what is seen, in the unknown's unit."""
        return self.kind.error(array, self.truth, self.seen)

    def scaled_error(self, array: np.ndarray) -> float:
        """The same after the factor for each channel, of the last axis, that makes the squares of
        the differences least."""
        axes = tuple(range(array.ndim - 1))
        above = np.sum(array * self.truth, axes, where=self.seen, dtype=np.float64)
        below = np.sum(array * array, axes, where=self.seen, dtype=np.float64)
        factor = np.divide(above, below, where=below > 0, out=np.ones_like(below))
        return self.kind.error(array * factor.astype(array.dtype), self.truth, self.seen)


def _overlooked(params: mi.SceneParameters, keys: Iterable[str]) -> list[mi.Medium]:
    """The media that take one of ``keys`` from a volume that stands outside of them: an update
    tells those alone that a parameter is found by way of, and a medium keeps its largest density.
    """
    found = []
    for key in (key for key in keys if key in params):
        told, above = [], owner(params, key)
        while above is not None:
            told.append(above)
            above = params.hierarchy[above][0]
        media = (holder for holder, _, _ in fed(params, key) if isinstance(holder, mi.Medium))
        found += [medium for medium in media if medium not in told]
    return list(dict.fromkeys(found))


class Unknowns:
    """The unknowns of one scene, and the only writer of the scene's parameters.

    ``leaves``: key → Dr.Jit value that the scene currently uses; after ``attach`` these carry
    gradients, and estimators add to them. (Where a kind makes the scene's parameters from its own,
    the value that they are made from: of an environment map, Mitsuba makes its own once more at
    each update, and only gradients at the origin stay.)
    """

    def __init__(
        self,
        params: mi.SceneParameters,
        items: list[Unknown],
        together: Sequence[Together] = (),
    ):
        """``params``: traversed anew, not those that the unknowns were read from: reading a
        parameter marks it as a candidate for an update. ``together``: of those that are stepped
        together."""
        self.params, self.items, self.together = params, items, together
        self._by_key = {u.key: u for u in items}
        self._in_order = sorted((u.kind for u in items), key=lambda kind: kind.order)
        written = dict.fromkeys(key for kind in self._in_order for key in kind.writes)
        self._media = _overlooked(params, written)
        # Mitsuba takes keys for patterns of beginnings, and ids may be any text: 'Cube (1)'.
        params.keep([re.escape(key) + r"\Z" for key in written])
        self.leaves = self.loaded()

    def replaced(self) -> list[tuple[str, str]]:
        """Keys of those whose truth is written otherwise than the file has it, and its hash."""
        return [
            (u.key, hashlib.blake2b(u.kind.present.tobytes(), digest_size=16).hexdigest())
            for u in self.items
            if u.kind.rewrites
        ]

    def __iter__(self):
        return iter(self.items)

    def __getitem__(self, key: str) -> Unknown:
        return self._by_key[key]

    def of(self, kind: type[Kind]) -> Unknown | None:
        """The first unknown of a kind, or None."""
        return next((u for u in self.items if isinstance(u.kind, kind)), None)

    @property
    def keys(self) -> list[str]:
        return [u.key for u in self.items]

    @property
    def moving(self) -> list[str]:
        """Keys of those that change what is visible, which path replay does not differentiate."""
        return [u.key for u in self.items if u.kind.moves_geometry]

    @property
    def moved(self) -> set[str]:
        """Ids of the objects that ``moving`` unknowns move."""
        return {written.rpartition(".")[0] for key in self.moving for written in self.written(key)}

    def sizes(self) -> tuple[int, ...]:
        """How many vertices the meshes have at present that become finer on the way."""
        finer = (u.key for u in self.items if u.kind.moves_geometry and u.kind.levels > 1)
        return tuple(self.leaves[key].shape[0] for key in finer)

    @property
    def textures(self) -> dict[str, mi.Texture]:
        """Of those laid out on surfaces, the texture that holds them, by key."""
        return {u.key: u.kind.texture for u in self.items if u.kind.texture is not None}

    @property
    def traded(self) -> list[str]:
        """Keys of lights and colours, where both are unknown: twice the light on half the colour
        is nearly the same image, and only what is known or reflects several times tells."""
        of = {u.key: u.kind.role for u in self.items if u.kind.role}
        return list(of) if len(set(of.values())) == 2 else []

    @property
    def unit(self) -> str | None:
        """The unit of all unknowns' errors, a word or nothing; None where units differ and no mean
        of errors means anything."""
        units = {u.kind.unit for u in self.items}
        return units.pop() if len(units) == 1 else None

    def written(self, key: str) -> list[str]:
        """The scene's parameters that the unknown ``key`` writes."""
        return self[key].kind.writes

    def place(self, key: str, where: str) -> tuple[Kind, np.ndarray]:
        """The translation ``key`` and the middles of its parts as they were loaded, ``(parts, 3)``;
        raises InputError, naming ``where``, if it is none, or if others move the same object."""
        found = self[key].kind.place(where)
        others = {name for kind in self._in_order if kind.key != key for name in kind.writes}
        if others & set(self.written(key)):
            raise InputError(f"{where}: only for a pose of one object that nothing else moves")
        return found

    @property
    def start_hash(self) -> str:
        """Of what each starts from."""
        found = hashlib.blake2b(digest_size=16)
        for unknown in self.items:
            found.update(f"{unknown.key} {unknown.start.shape}".encode() + unknown.start.tobytes())
        return found.hexdigest()

    def values_of(self, arrays: dict[str, np.ndarray]) -> dict:
        """NumPy arrays by key → Dr.Jit values of the scene's types."""
        return {key: self[key].kind.value(array) for key, array in arrays.items()}

    def recorded(self, arrays: dict[str, np.ndarray]) -> dict:
        """``values_of`` what a record holds. Raises InputError for what has another shape here."""
        for key, array in arrays.items():
            unknown = self[key]
            if not unknown.kind.doublings and array.shape != unknown.start.shape:
                raise InputError(
                    f"'{key}': the record has {array.shape}, where it is {unknown.start.shape} "
                    "now: the run is of another version of isas, or of other files"
                )
        return self.values_of(arrays)

    def starts(self, shapes: dict | None = None, lit: bool = False) -> dict:
        """``shapes``: by key, of those that are to be coarser; ``lit``: see ``Unknown.lit``."""
        coarse = shapes or {}
        return self.values_of(
            {
                u.key: u.kind.coarse(u.lit if lit else u.start, coarse.get(u.key, u.start.shape))
                for u in self.items
            }
        )

    def loaded(self) -> dict:
        """What the scene was loaded with."""
        return self.values_of({u.key: u.kind.present for u in self.items})

    def truths(self) -> dict | None:
        if any(u.truth is None for u in self.items):
            return None
        return self.values_of({u.key: u.truth for u in self.items})

    @property
    def switches(self) -> list[float]:
        """The shares of the budget at which levels begin: at each some unknown is finer than
        before. The first is 0."""
        return sorted({0.0}.union(*(u.doubled for u in self.items)))

    def level(self, spent: float) -> int:
        """The level at the share ``spent`` of the budget."""
        return sum(share <= spent for share in self.switches[1:])

    def shapes(self, level: int) -> dict[str, tuple[int, ...]]:
        """Of all leaves at a level, by key."""
        since = self.switches[level]
        return {u.key: u.kind.shape(sum(share > since for share in u.doubled)) for u in self.items}

    def arrays(self, values: dict) -> dict[str, np.ndarray]:
        """What values stand for, whole, by key. Waits for them."""
        return {key: self[key].kind.whole(value) for key, value in values.items()}

    def write(self, values: dict) -> None:
        """Put values into the scene, without derivatives (for evaluation). What is not among them
        stays."""
        self._update({key: dr.detach(value) for key, value in values.items()})

    def attach(self, values: dict) -> None:
        """Put values into the scene with fresh derivatives: the next backward pass adds to the
        gradients of ``leaves``. What is not among them stays as it is. Must stay outside frozen
        kernels: inside, textures crash.

        While a scene is attached, forward passes through *another* scene of the process fail:
        Dr.Jit's virtual calls reach all materials there are. ``write`` ends it.
        """
        leaves = {key: type(value)(dr.detach(value)) for key, value in values.items()}
        dr.enable_grad(leaves)
        self._update(leaves)

    def _update(self, leaves: dict) -> None:
        origins = self.leaves | leaves
        written: dict = {}
        for kind in self._in_order:
            kind.write(origins[kind.key], written)
        made = {k: v for k, v in written.items() if v is not origins.get(k)}
        own = written.keys() - made.keys()
        dr.eval(made)
        for key in (*made, *(own & leaves.keys())):
            self.params[key] = written[key]
        self.params.update()
        for medium in self._media:
            medium.parameters_changed([])
        self.leaves = {k: self._kept(k, origins[k]) if k in own else origins[k] for k in self.keys}

    def _kept(self, key: str, leaf):
        """``leaf`` as the scene keeps it; itself where Mitsuba keeps something else, made from it,
        such as the index of refraction that a principled material's ``specular`` stands for."""
        kept = self.params[key]
        return kept if _nodes(kept) == _nodes(leaf) else leaf

    def gradients(self) -> dict:
        """Gradients of the leaves, by key. Read after the frozen call, never returned from it."""
        return {k: dr.grad(v) for k, v in self.leaves.items()}

    def taken(self) -> dict:
        """``gradients``, which begin anew: what several frozen calls find is to be summed outside,
        since a call that reaches a leaf by way of what its kind has made replaces its gradient."""
        found = self.gradients()
        dr.eval(found)
        dr.clear_grad(self.leaves)
        return found

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


def _nodes(value) -> list[int]:
    """Where the entries of a value stand in the graph of derivatives; 0: nowhere."""
    value = value.array if dr.is_tensor_v(value) else value
    return [each.index_ad for each in (value if dr.size_v(value) > 1 else [value])]
