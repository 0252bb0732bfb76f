"""How much probability mass each unknown should get."""

from __future__ import annotations

from collections.abc import Collection

import drjit as dr
import mitsuba as mi

from .sampler import Moments


def masses(
    sensitivity: dict,
    curvature: dict,
    moments: Moments | None,
    least: float,
    rates: dict | None = None,
    resting: Collection[str] = (),
) -> dict:
    """P_k ∝ (w η C_k / h_k)^⅔ (1 + x_k)^(-4/3) by key, flat; 0 for what nothing depends on, and for
    the keys that are ``resting`` until their stage.

    The minimiser of Σ_k w F_k over ΣP = 1 (``Progress`` derives F and defines all symbols):

        F_k = δ_k² x_k / (1 + x_k),   x_k = η s_k / (2 h_k δ_k²),   s_k = C_k / √P_k,

    w = 1/(n η²) of each key's n entries that anything depends on and its rate η (``rates`` where
    there are no ``moments``; None: alike): a mean over each key, in steps. So keys count alike,
    whatever their units, and a number is not starved by a texture of thousands.

    Its derivative must be alike for all: P_k^(3/2) ∝ (w η C_k/h_k) / (1 + x_k)². x_k depends on
    P_k: where there are ``moments`` s_k is the root of Adam's v̂_k, which the pmf so far has brought
    about, and each look is one step of a fixed-point iteration; before, x_k ≪ 1 is taken.

    ``sensitivity``: C_k; ``curvature``: h_k; both are held above ``least`` times their mean over
    the key's entries that anything depends on: one grazing path must not draw all samples.
    """
    found, rates = {}, rates if moments is None else moments.rate
    for key, c in sensitivity.items():
        h = curvature[key]
        known = (c > 0) & (h > 0) & dr.isfinite(c) & dr.isfinite(h)
        # Out of the sums that follow as well: one entry must not spoil its whole key.
        c, h = dr.select(known, c, 0), dr.select(known, h, 0)
        c, h = _held(c, known, least), _held(h, known, least)
        entries = dr.maximum(mi.Float(dr.count(known)), 1)
        rate = dr.opaque(mi.Float, (rates and rates[key]) or 1.0)
        mass = dr.power(c / (h * entries * rate), 2 / 3)
        if moments is not None:
            mass *= dr.power(1 + _excess(key, h, moments), -4 / 3)
        rests = key in resting or (moments is not None and not moments.rate[key])
        # Opaque, or a stage that begins would compile anew.
        found[key] = dr.select(known & dr.opaque(mi.Bool, not rests), mass, 0)
    return found


def tangents(
    sensitivity: dict,
    curvature: dict,
    moments: Moments | None,
    least: float,
    rates: dict | None = None,
    resting: Collection[str] | None = None,
) -> dict:
    """P_k / C_k by key, flat, the largest 1. Where no unknown is to have any mass, by ``moments``
    and what is ``resting`` (None: nothing ever rests), as if there were neither. Evaluates."""

    def along(moments: Moments | None, resting: Collection[str] = ()) -> dict:
        mass = masses(sensitivity, curvature, moments, least, rates, resting)
        return _over_sensitivity(mass, sensitivity, least)

    found = along(moments, resting or ())
    # Of a problem in stages always, or a stage that begins would compile anew.
    if moments is not None or resting is not None:
        most, plain = _most(found), along(None)
        found = {key: dr.select(most > 0, x, plain[key]) for key, x in found.items()}
    most = _most(found)
    scale = dr.select(most > 0, dr.rcp(most), 0)
    found = {key: x * scale for key, x in found.items()}
    dr.eval(found)
    return found


def _over_sensitivity(mass: dict, sensitivity: dict, least: float) -> dict:
    found = {}
    for key, c in sensitivity.items():
        known = mass[key] > 0
        found[key] = dr.select(known, mass[key] / _held(c, known, least), 0)
    dr.eval(found)
    return found


def _most(found: dict) -> mi.Float:
    most = mi.Float(0)
    for x in found.values():
        most = dr.maximum(most, dr.max(x))
    return most


def _held(x: mi.Float, known: mi.Bool, least: float) -> mi.Float:
    number = dr.maximum(mi.Float(dr.count(known)), 1)
    return dr.maximum(x, least * dr.sum(dr.select(known, x, 0)) / number)


def _excess(key: str, h: mi.Float, moments: Moments) -> mi.Float:
    """x_k = η s_k / (2 h_k δ²), with one δ² for the whole key.

    δ² = Σ_k (m_k² - noise_k) / Σ_k h_k², m the running mean of the gradient: entry by entry m is
    mostly noise. It is held above the standard deviation of that sum's noise, so that a scalar,
    whose error cannot be told from noise, is never taken for done.
    """
    first, noise = moments.first[key], moments.noise[key]
    signal = dr.sum(dr.square(first)) - dr.sum(noise)
    # Brought to order one, as h is: squares of squared gradients leave float32's range.
    top = dr.maximum(dr.max(noise), 1e-37)
    unsure = top * dr.sqrt(2 * dr.sum(dr.square(noise / top)))
    # From the held h: entries of next to no curvature say nothing about the error.
    most = dr.maximum(dr.max(h), 1e-37)
    h = h / most
    error = dr.maximum(signal, unsure) / dr.sum(dr.square(h))
    rate = dr.opaque(mi.Float, 0.5 * moments.rate[key] / moments.unit) * most
    return rate * dr.sqrt(moments.second[key]) / dr.maximum(h * error, 1e-37)
