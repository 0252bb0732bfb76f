"""The unknowns as one vector, moved by offsets, and the widths that they are blurred with."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..runtime.errors import InputError
from . import smoothing
from .parameters import as_numpy

if TYPE_CHECKING:
    from ..scene.problem import Problem


# Of one pair of renderings for each entry: all their offsets are held at once, D² numbers.
_MOST_SINGLE = 2048


class Blur:
    """All unknowns' D entries, one after the other, and their σ. On the host, in double precision;
    the scene gets single.

    Raises InputError for an unknown without a ``blur``, naming ``method``, which needs it.
    """

    def __init__(self, problem: "Problem", method: str):
        self.unknowns = problem.unknowns
        for unknown in self.unknowns:
            if unknown.blur is None:
                raise InputError(
                    f"scene.unknowns['{unknown.key}'] has no blur, which {method} needs: "
                    "give blur: {start: …, end: …}, widths of a Gaussian in the unknown's unit"
                )
        self._sizes = [unknown.start.size for unknown in self.unknowns]
        self._low = np.repeat([u.low for u in self.unknowns], self._sizes)
        self._high = np.repeat([u.high for u in self.unknowns], self._sizes)

    @property
    def size(self) -> int:
        """D."""
        return sum(self._sizes)

    def check_single(self, setting: str) -> None:
        """Raises InputError, naming ``setting``, where there are too many entries for a pair of
        renderings each."""
        if self.size > _MOST_SINGLE:
            raise InputError(
                f"{setting} takes a pair of renderings for each of the unknowns' {self.size} "
                f"entries, and at most {_MOST_SINGLE}: leave textures out, or take "
                "estimator=plateau with estimator.scheme=joint, one pair for all"
            )

    def vector(self, values: dict) -> np.ndarray:
        """``(D,) float64`` from values by key. Waits for them."""
        pieces = [as_numpy(values[key]).reshape(-1) for key in self.unknowns.keys]
        return np.concatenate(pieces).astype(np.float64)

    def values(self, vector: np.ndarray) -> dict:
        """The inverse of ``vector``: Dr.Jit values of the scene's types."""
        pieces = np.split(vector.astype(np.float32), np.cumsum(self._sizes)[:-1])
        return self.unknowns.values_of(
            {u.key: piece.reshape(u.start.shape) for u, piece in zip(self.unknowns, pieces)}
        )

    def widths(self, θ: np.ndarray, spent: float) -> np.ndarray:
        """σ of every entry, ``(D,)``, at the share ``spent`` of the budget."""
        blurs = [u.blur for u in self.unknowns]
        now = [smoothing.width(b.start, b.end, b.hold, b.until, spent) for b in blurs]
        return self.resolved(np.repeat(now, self._sizes), θ)

    def moving(self, spent: float) -> np.ndarray:
        """Which entries are optimised at the share ``spent`` of the budget, ``(D,) bool``: what
        rests is neither blurred nor rendered for."""
        return np.repeat([u.moves(spent) for u in self.unknowns], self._sizes)

    def resolved(self, σ: np.ndarray, θ: np.ndarray) -> np.ndarray:
        """``σ`` raised to what single precision resolves at ``θ``, both ``(D,)``."""
        return smoothing.stable(σ, θ, np.repeat([u.scale for u in self.unknowns], self._sizes))

    def inside(self, θ: np.ndarray) -> np.ndarray:
        """Which entries lie in their legal range, ``(D,) bool``."""
        return (θ >= self._low) & (θ <= self._high)

    def ends(self, θ: np.ndarray) -> np.ndarray:
        """``θ`` clamped to the legal ranges, ``(D,)``."""
        return np.clip(θ, self._low, self._high)

    def clamped(self, θ: np.ndarray) -> dict:
        """Values at ``θ`` clamped to the legal ranges: a negative reflectance cannot be rendered.
        What is smoothed is then f(clamp(θ)), a function of all θ like any other."""
        return self.values(self.ends(θ))

    def write(self, θ: np.ndarray) -> None:
        """Put ``θ`` into the scene, clamped."""
        self.unknowns.write(self.clamped(θ))
