"""Discrete lobes: mirrors, clear glass and gaps beside smooth lobes, with their derivatives.

A BSDF's ``eval`` tells its smooth lobes alone. What a mirror reflects, clear glass lets through or
a mask leaves out is known to ``sample``, which divides it by the chance of having been drawn, and
so loses the derivative by that chance. Here a BSDF that holds such lobes, at any depth, is taken
apart into them:

    L_o = Σ_k v_k L(ω_k) + ∫ f_s(ω) L(ω) dω^⊥,

v_k and ω_k the value and the direction of the k-th discrete lobe, f_s all smooth ones together.
One lobe is drawn, with chances q that are known, none of them below ``_LEAST``, so that a lobe that
is off (an opacity of 1) still tells its derivative: a path's weight is v_k / q_k, or
f_s(ω) cos θ / Σ_s q_s p_s(ω), whose derivatives are those of v_k and f_s.

The values are Mitsuba's. That matters in a blend with a discrete lobe: ``blendbsdf`` of 3.9 weighs
such a lobe's chance against the other part's density by solid angle, and so mixes two units; v_k is
what comes of that, as all pictures are rendered by it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import drjit as dr
import mitsuba as mi

from ..runtime.errors import InputError
from ..unknowns.parameters import held, owner
from ..unknowns.ranges import fed
from ..unknowns.routes import discrete

# The least chance of a lobe, and what a path's weight is in a replay where its value is 0.
_LEAST, _OFF = 0.05, 1e-5
_BELOW_ONE = 1 - 2**-24


class Drawn(NamedTuple):
    """A direction from a surface point. ``wo``: in the local frame; ``eta``: the quotient of the
    indices of refraction; ``pdf``: of ``wo`` by ``BSDF.pdf``; ``delta``: whether by a discrete
    lobe; ``weight``: BSDF × cosine over the density, without derivatives; ``used``: the same, above
    0 where a derivative is to be learnt of what is 0; ``factor``: 1, its derivative that of the
    weight over ``used``."""

    wo: mi.Vector3f
    eta: mi.Float
    pdf: mi.Float
    delta: mi.Bool
    weight: mi.Spectrum
    used: mi.Spectrum
    factor: mi.Spectrum


def scattered(
    lobes: "Lobes | None",
    bsdf: mi.BSDFPtr,
    si: mi.SurfaceInteraction3f,
    sampler: mi.Sampler,
    active: mi.Bool,
    attach: bool,
) -> Drawn:
    """Where a path goes on, by detached sampling: as Mitsuba draws it, but where ``lobes`` has the
    BSDF. ``attach``: with the derivative of the BSDF's value. Traced; call it without derivatives.
    """
    context, numbers = mi.BSDFContext(), (sampler.next_1d(), sampler.next_2d())
    apart, rest = [], active
    for one in lobes.bsdfs if lobes is not None else ():
        mine = active & (bsdf == mi.BSDFPtr(one))
        apart.append((mine, _of(one, si, numbers, mine, attach)))
        rest = rest & ~mine
    sample, weight = bsdf.sample(context, si, *numbers, rest)
    delta = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
    factor = mi.Spectrum(1)
    with dr.resume_grad(when=attach):
        if attach:
            # Where nothing goes on there is no quotient of two values.
            on = rest & (dr.max(weight) != 0)
            factor = dr.relative_grad(bsdf.eval(context, si, sample.wo, on))
        found = Drawn(sample.wo, sample.eta, sample.pdf, delta, weight, weight, factor)
        for mine, own in apart:
            found = Drawn(*(dr.select(mine, a, b) for a, b in zip(own, found)))
    return found


def _of(bsdf: mi.BSDF, si, numbers: tuple, mine: mi.Bool, attach: bool) -> Drawn:
    """Where paths go on that are at a surface of ``bsdf``.

    As a branch of its own: the derivative by a single number would else be summed over the paths
    once for each use of it, each time by a kernel. (Of ``dr.dispatch`` a path could have but one:
    with a second there is no derivative forwards.)"""

    def there(si, number, pair):
        return tuple(_drawn(bsdf, si, number, pair, mi.Bool(True)))

    def elsewhere(si, number, pair):
        # Read by no one, and no constant: of two branches that end in the same one, Dr.Jit 1.5
        # leaves it in the second, where paths of the first do not come by.
        of_each = mi.Spectrum(number)
        return si.wi, number, number, number > 0, of_each, of_each, of_each

    with dr.resume_grad(when=attach):
        found = dr.if_stmt((si, *numbers), mine, there, elsewhere, mode="symbolic")
    return Drawn(*(dr.detach(each) for each in found[:-1]), found[-1])


@dataclass
class _Lobe:
    """``share``: how often it would be drawn by what it scatters, in [0, 1], without derivatives.

    Of a smooth one ``draw(number, numbers, active)``, a sample, and ``density(wo, active)``. Of a
    discrete one ``wo``, ``eta``, and with derivatives ``value``; by Mitsuba's ``sample`` it is
    drawn by ``chance``, which tells ``pdf``, and times that a weight of ``mass``."""

    share: mi.Float
    valid: mi.Bool
    value: mi.Spectrum | None = None
    wo: mi.Vector3f | None = None
    eta: mi.Float | None = None
    chance: mi.Float | None = None
    pdf: mi.Float | None = None
    mass: mi.Spectrum | None = None
    draw: Callable | None = None
    density: Callable | None = None

    def scale(self, by: mi.Float) -> None:
        """Let it be a part of a material, drawn by the chance ``by``."""
        self.share = self.share * dr.detach(by)
        if self.value is not None:
            self.value, self.chance = self.value * by, self.chance * by
            self.pdf, self.mass = self.pdf * by, self.mass * by


class Lobes(NamedTuple):
    """``bsdfs`` with discrete lobes, to be taken apart; ``keys`` of the unknowns in them."""

    bsdfs: tuple[mi.BSDF, ...]
    keys: tuple[str, ...]


def _drawn(bsdf: mi.BSDF, si, number: mi.Float, numbers: mi.Point2f, active: mi.Bool) -> Drawn:
    """A direction from a surface of one material, which is taken apart. Traced, with derivatives
    where they are on."""
    lobes = _apart(_named(bsdf), si, numbers, active)
    shares = [dr.select(each.valid, each.share, 0) for each in lobes]
    least = [dr.select(each.valid, mi.Float(_LEAST), 0) for each in lobes]
    total, floor = sum(shares), sum(least)
    chances = [
        dr.select(total > 0, share / total * (1 - floor) + low, low / dr.maximum(floor, _LEAST))
        for share, low in zip(shares, least)
    ]
    # The one in whose part of [0, 1) the number lies, and where in it.
    end, chosen, within = mi.Float(0), mi.UInt32(len(lobes)), mi.Float(0)
    for index, chance in enumerate(chances):
        here = (number >= end) & (chance > 0)
        chosen = dr.select(here, mi.UInt32(index), chosen)
        within = dr.select(here, (number - end) / chance, within)
        end += chance
    within = dr.clip(within, 0, _BELOW_ONE)

    wo, eta, delta = mi.Vector3f(0, 0, 1), mi.Float(1), mi.Bool(False)
    value, rate = mi.Spectrum(0), mi.Float(0)
    smooth = [(each, chance) for each, chance in zip(lobes, chances) if each.value is None]
    for index, (each, chance) in enumerate(zip(lobes, chances)):
        mine = active & (chosen == index)
        if each.value is None:
            with dr.suspend_grad():
                sample = each.draw(within, numbers, mine)
            wo, eta = dr.select(mine, sample.wo, wo), dr.select(mine, sample.eta, eta)
            continue
        wo, eta = dr.select(mine, each.wo, wo), dr.select(mine, each.eta, eta)
        value, rate = dr.select(mine, each.value, value), dr.select(mine, chance, rate)
        delta |= mine
    pdf = dr.select(delta, mi.Float(1), 0)
    if smooth:
        spread = active & ~delta
        own, density = bsdf.eval_pdf(mi.BSDFContext(), si, wo, spread)
        with dr.suspend_grad():
            whole = sum(chance * each.density(wo, spread) for each, chance in smooth)
        value, rate = dr.select(spread, own, value), dr.select(spread, whole, rate)
        pdf = dr.select(spread, dr.detach(density), pdf)
    alive = active & (rate > 0)
    value = dr.select(alive, value * dr.rcp(dr.select(alive, rate, 1)), 0)
    weight = dr.detach(value)
    used = dr.select(alive & (weight == 0), _OFF, weight)
    factor = 1 + (value - weight) * dr.rcp(dr.select(used == 0, 1, used))
    return Drawn(wo, eta, pdf, delta, weight, used, factor)


class _Named(NamedTuple):
    """A BSDF and its parts by the names that Mitsuba's plugins give them."""

    bsdf: mi.BSDF
    parts: dict[str, "object"]


def _named(bsdf: mi.BSDF) -> _Named:
    return _Named(bsdf, dict(held(bsdf)))


def _apart(node: _Named, si, numbers: mi.Point2f, active: mi.Bool) -> list[_Lobe]:
    """The lobes of a material. Traced."""
    take = _OF_CLASS.get(node.bsdf.class_name(), _leaf)
    return take(node, si, numbers, active)


def _part(node: _Named, name: str) -> _Named:
    return _named(node.parts[name])


def _mask(node: _Named, si, numbers, active) -> list[_Lobe]:
    opacity = dr.clip(node.parts["opacity"].eval_1(si, active), 0, 1)
    found = _apart(_part(node, "nested_bsdf"), si, numbers, active)
    for each in found:
        each.scale(opacity)
    gap, whole = 1 - opacity, mi.Spectrum(1 - opacity)
    where = -si.wi, mi.Float(1)
    return [*found, _Lobe(dr.detach(gap), mi.Bool(active), whole, *where, gap, gap, whole)]


def _blend(node: _Named, si, numbers, active) -> list[_Lobe]:
    second, context = dr.clip(node.parts["weight"].eval_1(si, active), 0, 1), mi.BSDFContext()
    found = []
    for own, other, by in (("bsdf_0", "bsdf_1", 1 - second), ("bsdf_1", "bsdf_0", second)):
        for each in _apart(_part(node, own), si, numbers, active):
            each.scale(by)
            if each.value is not None:
                # As if its pdf were by solid angle, like the other part's.
                aside, density = node.parts[other].eval_pdf(context, si, each.wo, active)
                each.mass, each.pdf = each.mass + (1 - by) * aside, each.pdf + (1 - by) * density
                apart = dr.detach(density) > 0
                mixed = each.chance * each.mass / dr.select(apart, each.pdf, 1)
                each.value = dr.select(apart, mixed, each.value)
            found.append(each)
    return found


def _two_sided(node: _Named, si, numbers, active) -> list[_Lobe]:
    front = mi.Frame3f.cos_theta(si.wi) > 0
    if "brdf_1" not in node.parts or node.parts["brdf_1"] is node.parts["brdf_0"]:
        sides = [("brdf_0", ~front, mi.Bool(True))]
    else:
        sides = [("brdf_0", mi.Bool(False), front), ("brdf_1", mi.Bool(True), ~front)]
    found = []
    for name, turned, here in sides:
        flip = mi.Vector3f(1, 1, dr.select(turned, mi.Float(-1), 1))
        inner = mi.SurfaceInteraction3f(si)
        inner.wi = si.wi * flip
        for each in _apart(_part(node, name), inner, numbers, active & here):
            found.append(_turned(each, flip, here))
    return found


def _turned(lobe: _Lobe, flip: mi.Vector3f, here: mi.Bool) -> _Lobe:
    """A lobe whose directions are mirrored in the surface, and which is ``here`` alone."""
    lobe.valid = lobe.valid & here
    if lobe.value is not None:
        lobe.wo = lobe.wo * flip
        return lobe
    draw, density = lobe.draw, lobe.density

    def drawn(number, numbers, active):
        sample = draw(number, numbers, active & here)
        sample.wo = sample.wo * flip
        return sample

    lobe.draw = drawn
    lobe.density = lambda wo, active: dr.select(here, density(wo * flip, active & here), 0)
    return lobe


def _leaf(node: _Named, si, numbers, active) -> list[_Lobe]:
    """Of a material without parts, or of one that turns the frame of what it holds."""
    bsdf, found = node.bsdf, []
    sharp = discrete(bsdf)
    smooth = [k for k in range(bsdf.component_count()) if k not in sharp]
    rest = mi.Float(1)
    for component in sharp:
        sample, value = bsdf.sample(_only(component), si, mi.Float(0.5), numbers, active)
        valid = active & (dr.detach(sample.pdf) > 0)
        value = dr.select(valid, value, 0)
        # Which of two lobes Mitsuba draws the number tells: the first at its low end.
        number = mi.Float(0 if component == 0 else _BELOW_ONE)
        whole, _ = bsdf.sample(mi.BSDFContext(), si, number, numbers, active)
        chance = dr.select(valid & (whole.sampled_component == component), whole.pdf, 0)
        share = dr.detach(dr.clip(dr.mean(value), 0, 1))
        rest -= share
        wo, eta = dr.detach(sample.wo), dr.detach(sample.eta)
        found.append(_Lobe(share, valid, value, wo, eta, chance, chance, value))
    # What honours no component is one lobe, as it is drawn whole.
    every = [None] if not sharp else smooth
    for component in every if smooth else ():
        context = mi.BSDFContext() if component is None else _only(component)
        share = dr.detach(dr.maximum(rest, 0)) / len(every)
        found.append(_smooth(bsdf, context, si, share, active))
    return found


def _smooth(bsdf: mi.BSDF, context: mi.BSDFContext, si, share, active) -> _Lobe:
    def draw(number, numbers, active):
        return bsdf.sample(context, si, number, numbers, active)[0]

    def density(wo, active):
        return bsdf.pdf(context, si, wo, active)

    return _Lobe(share, mi.Bool(active), draw=draw, density=density)


def _only(component: int) -> mi.BSDFContext:
    return mi.BSDFContext(mi.TransportMode.Radiance, 0xFFFFFFFF, component)


_TURNING = "BumpMap", "NormalMap"
HIDDEN = (
    "of a material with mirrors, clear glass or gaps, whose mask, blendbsdf or twosided is under a "
    "bump or normal map: put the map inside, around each part's own material"
)
_OF_CLASS = {"MaskBSDF": _mask, "BlendBSDF": _blend, "TwoSidedBRDF": _two_sided}


def touched(params: mi.SceneParameters, keys: Iterable[str]) -> Lobes | None:
    """The materials with discrete lobes, at any depth, that the parameters ``keys`` are of; None
    where there are none. Raises InputError for one that cannot be taken apart."""
    keys = tuple(keys)
    if refused := hidden(params, keys):
        raise InputError(f"scene.unknowns: '{next(iter(refused))}': {HIDDEN}")
    found = list(_holding(params, keys))
    inside = {key for _, mine in found for key in mine}
    bsdfs = tuple(bsdf for bsdf, _ in found)
    return Lobes(bsdfs, tuple(k for k in keys if k in inside)) if found else None


def hidden(params: mi.SceneParameters, keys: Iterable[str]) -> list[str]:
    """Those of ``keys`` whose material cannot be taken apart (``HIDDEN``): a map that turns the
    frame hides what the material under it is made of."""
    refused = []
    for bsdf, mine in _holding(params, keys):
        under = _named(bsdf).parts.get("nested_bsdf")
        if bsdf.class_name() in _TURNING and under.class_name() in _OF_CLASS:
            refused += mine
    return list(dict.fromkeys(refused))


def _holding(params: mi.SceneParameters, keys: Iterable[str]) -> Iterator[tuple]:
    """Materials with discrete lobes, at any depth, and the keys of the parameters in each, or that
    it reads from its mesh."""
    wanted = {key: [owner(params, key), *(h for h, _, _ in fed(params, key))] for key in keys}
    for thing in params.hierarchy:
        if isinstance(thing, mi.BSDF) and discrete(thing):
            own = mi.traverse(thing).hierarchy
            mine = [key for key, holders in wanted.items() if any(h in own for h in holders)]
            if mine:
                yield thing, mine
