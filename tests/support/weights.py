"""Weights of light and BSDF samples as Mitsuba's integrators have them."""

import drjit as dr

from isas_cli.rendering import attached, derivative_sampling, light, replayed


def power_heuristic(a, b):
    """Veach 1997."""
    a, b = dr.square(a), dr.square(b)
    w = a / (a + b)
    return dr.select(dr.isfinite(w), w, 0)


def as_mitsuba(monkeypatch) -> None:
    """isas's paths with Mitsuba's weights: the same path by path."""
    for module in (attached, derivative_sampling, light, replayed):
        monkeypatch.setattr(module, "mis_weight", power_heuristic)
