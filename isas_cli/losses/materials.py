"""What materials are like: maps are smooth, a surface is metal or is not, roughness is usual.

    R = smooth R_s + metallic Σ_m mean x (1 - x) + roughness Σ_r mean (x - expected)²

R_s as in ``priors.Smoothness``, over all unknowns with neighbours; m over the unknowns that a
material takes as its metallic, r over those that it takes as its roughness or alpha. The PBDR paper
has such a "material regularisation" and prints no formula: x (1 - x) stands for the entropy of a
share x, which is 0 at both ends too, and has a derivative there. Each term is left out at a weight
of 0; each unknown's part has a factor of its own (``Unknown.prior``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..config.schema import ROUGHNESSES, roughness_of
from ..runtime.errors import InputError
from ..unknowns.parameters import flat, unflat
from ..unknowns.unknowns import Unknowns
from .priors import OnUnknowns, Prior, Smoothness, check_factors

_ROUGH = {*ROUGHNESSES, "alpha_u", "alpha_v"}


@dataclass(frozen=True)
class Materials(Prior):
    """``smooth``, ``metallic``, ``roughness``: the terms' weights, at least 0; ``expected``: the
    roughness that is expected, in [0, 1]. Raises InputError for other numbers."""

    smooth: float = 0.01
    metallic: float = 0.01
    roughness: float = 0.01
    expected: float = 0.5

    def __post_init__(self) -> None:
        for name in ("smooth", "metallic", "roughness"):
            if not 0 <= getattr(self, name) < math.inf:
                raise InputError(
                    f"prior.{name}={getattr(self, name)}: must be a finite number, at least 0"
                )
        if not 0 <= self.expected <= 1:
            raise InputError(f"prior.expected={self.expected}: a roughness, in [0, 1]")

    def on(self, unknowns: Unknowns) -> "OnMaterials":
        # A texture may be called what it is not: by what reads it, where something does.
        named = {u.key: u.kind.words or {roughness_of(u.key)} for u in unknowns}
        rough = [key for key, words in named.items() if _ROUGH & words]
        metal = [u.key for u in unknowns if "metallic" in u.kind.words]
        wide = any(u.kind.axes for u in unknowns)
        if not (rough or metal or wide):
            raise InputError(
                "prior=materials: no unknown has neighbouring entries, and none is called metallic "
                "or roughness: say prior=none"
            )
        smooth = Smoothness(self.smooth).over(unknowns) if wide and self.smooth else None
        check_factors(unknowns, [*rough, *metal, *(u.key for u in unknowns if u.kind.axes)])
        factors = {u.key: u.weighed for u in unknowns}
        return OnMaterials(self, smooth, metal, rough, factors)


class OnMaterials(OnUnknowns):
    """``Materials`` at work."""

    def __init__(self, prior: Materials, smooth, metal: list[str], rough: list[str], factors: dict):
        self.smooth = smooth
        parts = {
            "smooth": (smooth, "no unknown has entries side by side"),
            "metallic": (metal, "no unknown is a material's metallic"),
            "roughness": (rough, "no unknown is a material's roughness"),
            "expected": (rough, "no unknown is a material's roughness"),
        }
        self.unheeded = [
            f"prior.{name}={asked:g} has no effect: {why}"
            for name, (part, why) in parts.items()
            if not part and (asked := getattr(prior, name)) not in (0, getattr(Materials, name))
        ]
        # By key: weight, and ρ and its derivative by an entry. Opaque: runs share kernels.
        expected = dr.opaque(mi.Float, prior.expected)
        self.terms = [
            (key, prior.metallic * factors[key], lambda x: x * (1 - x), lambda x: 1 - 2 * x)
            for key in metal
        ] + [
            (
                key,
                prior.roughness * factors[key],
                lambda x: dr.square(x - expected),
                lambda x: 2 * (x - expected),
            )
            for key in rough
        ]

    def value(self, values: dict) -> float:
        total = 0.0 if self.smooth is None else self.smooth.value(values)
        for key, weight, energy, _ in self.terms:
            x = flat(values[key])
            total += weight * float(dr.sum(mi.Float64(energy(x)))[0]) / dr.width(x)
        return total

    def add(self, values: dict, gradients: dict) -> dict:
        result = dict(gradients) if self.smooth is None else self.smooth.add(values, gradients)
        for key, weight, _, slope in self.terms:
            x = flat(values[key])
            part = slope(x) * dr.opaque(mi.Float, weight / dr.width(x))
            result[key] = unflat(result[key], flat(result[key]) + part)
        return result
