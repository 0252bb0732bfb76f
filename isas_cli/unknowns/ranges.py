"""Which values mean something: ranges that physics, or a plugin of Mitsuba, gives its parameters.

A range belongs to what takes the number: a texture's is that of the parameter that it feeds, and a
mesh attribute's that of the material that reads it.
"""

from __future__ import annotations

import math
import re

import mitsuba as mi
import numpy as np

from .parameters import as_numpy, held, owner

_UNIT, _SIGNED = (0.0, 1.0), (-1.0, 1.0)
_POSITIVE, _ANY = (0.0, np.inf), (-np.inf, np.inf)
# Below about that a glossy lobe's derivative dies.
_GLOSS = (0.03, 1.0)
# An index of refraction on this side of 1, where the surface would vanish, or on the other.
_DENSER, _THINNER = (1.001, np.inf), (0.1, 0.999)

# Attribute of a scene's parameters.
_KEPT = "_isas_uses"

# By the class of what holds the parameter and its name there, or by the name alone.
_OF_BSDFS = {
    **dict.fromkeys(("base_color", "reflectance", "diffuse", "specular"), _UNIT),
    **dict.fromkeys(("diffuse_reflectance", "specular_reflectance"), _UNIT),
    **dict.fromkeys(("specular_transmittance", "transmittance"), _UNIT),
    **dict.fromkeys(("opacity", "weight"), _UNIT),
    **dict.fromkeys(("metallic", "anisotropic", "spec_tint", "spec_trans", "flatness"), _UNIT),
    **dict.fromkeys(("sheen", "sheen_tint", "clearcoat", "clearcoat_gloss"), _UNIT),
    "diff_trans": (0.0, 2.0),
    **dict.fromkeys(("roughness", "alpha", "alpha_u", "alpha_v"), _GLOSS),
    "eta": _DENSER,
    # Metals' lie on both sides of 1.
    ("SmoothConductor", "eta"): _POSITIVE,
    ("RoughConductor", "eta"): _POSITIVE,
    "k": _POSITIVE,
    # The index that it stands for has an infinite derivative at 0.
    ("Principled", "specular"): (0.001, 1.0),
    # Directions as colours.
    "normalmap": _UNIT,
    **dict.fromkeys(("longitudinal_roughness", "azimuthal_roughness"), _GLOSS),
    "scale_tilt": (-90.0, 90.0),
    **dict.fromkeys(("eumelanin", "pheomelanin", "sigma_a"), _POSITIVE),
}
_OF_EMITTERS = dict.fromkeys(("cutoff_angle", "beam_width"), (0.0, 90.0))
# Degrees between a spot's beam and its cutoff, at least: light falls off in between alone, and
# where nothing lies there its derivative is none.
_FALLOFF = 0.1
_OF_MEDIA = {"albedo": _UNIT}
_OF_PHASES = {
    "g": (-0.99, 0.99),
    "weight": _UNIT,
    # Second moments of the projected area of flakes, at most 1.
    "S": _SIGNED,
    "values": _POSITIVE,
}
_OF_SHAPES = {"opacities": _UNIT, "color": _UNIT}
_TABLES = (
    ("BSDF", _OF_BSDFS, _ANY),
    # None of what is left is negative: colours, strengths, densities.
    ("Emitter", _OF_EMITTERS, _POSITIVE),
    ("Medium", _OF_MEDIA, _POSITIVE),
    ("PhaseFunction", _OF_PHASES, _ANY),
    ("Shape", _OF_SHAPES, _ANY),
)
# How far values stay off the ends of a range, the lower and the upper, where the derivative is none
# or not all: Mitsuba clips weights, at black a path ends, and what is never sampled tells nothing.
_HAIR, _SHARE = 1e-6, 1e-3
_BARE = {
    **dict.fromkeys(("opacity", "weight"), (_HAIR, _HAIR)),
    **dict.fromkeys(("base_color", "reflectance", "diffuse_reflectance"), (_HAIR, 0.0)),
    **dict.fromkeys(("specular_reflectance", "specular_transmittance"), (_HAIR, 0.0)),
    **dict.fromkeys(("transmittance", "diffuse"), (_HAIR, 0.0)),
    **dict.fromkeys(("clearcoat", "sheen"), (_HAIR, 0.0)),
    **dict.fromkeys(("spec_trans", "diff_trans"), (_SHARE, _SHARE)),
    "metallic": (0.0, _SHARE),
    "albedo": (0.01, 0.0),
    "sigma_t": (_SHARE, 0.0),
    "eta": (_SHARE, 0.0),  # of a metal at 0
}
_UNITS = {
    **{word: word for word in ("radiance", "intensity", "irradiance", "scale")},
    "sigma_t": "1 / scene unit",
    **dict.fromkeys(("cutoff_angle", "beam_width", "scale_tilt"), "degrees"),
}

_LIGHTS = ("radiance", "intensity", "irradiance")
AIMS = ("direction", "_angle", "beam_width")  # where lights shine
_COLOURS = ("base_color", "reflectance", "albedo", "diffuse", "specular")
_COLOURS += ("diffuse_reflectance", "specular_reflectance")
_COLOURS += ("specular_transmittance", "transmittance")
_GREYS = {("Principled", "specular")}  # of these words, what is a number alone


def usual(params: mi.SceneParameters, key: str) -> tuple[float, float, str]:
    """Lowest and highest legal value and the unit of a parameter; -inf and inf where nothing is
    known of it."""
    low, high, unit = *_ANY, ""
    for holder, word, factor in fed(params, key):
        a, b = _of(holder, word, params[key])
        low, high = max(low, a / factor), min(high, b / factor)
        own = _UNITS.get(word, "")
        unit = unit or (own if factor == 1 or not own else f"{factor:g} × {own}")
    return (low, high, unit) if low < high else (*_ANY, unit)


def _of(holder: mi.Object, word: str, value) -> tuple[float, float]:
    if isinstance(holder, mi.Emitter) and word in _OF_EMITTERS:
        low, high = _OF_EMITTERS[word]
        beam, cutoff = (
            as_numpy(mi.traverse(holder)[each]).item() for each in ("beam_width", "cutoff_angle")
        )
        if beam >= cutoff:
            return low, high
        return (beam + _FALLOFF, high) if word == "cutoff_angle" else (low, cutoff - _FALLOFF)
    for kind, table, default in _TABLES:
        if isinstance(holder, getattr(mi, kind)):
            found = table.get((holder.class_name(), word), table.get(word, default))
            below = found is _DENSER and as_numpy(value).max() < 1
            return _THINNER if below else found
    return _ANY


def fed(params: mi.SceneParameters, key: str) -> list[tuple[mi.Object, str, float]]:
    """What takes the numbers of a parameter: materials, lights and the like, each with its name for
    what it takes, and the factor that they are multiplied with on the way."""
    holder = owner(params, key)
    name = key.rpartition(".")[2]
    if isinstance(holder, mi.Shape) and name.startswith(("vertex_", "face_")):
        return _by_attribute(params, holder, name) or [(holder, name, 1.0)]
    if not isinstance(holder, (mi.Texture, mi.Volume)):
        return [(holder, name, 1.0)]
    return [(*end, _multiplied(*end)) for end in _ends(_known(params), holder)]


def _multiplied(holder: mi.Object, word: str) -> float:
    """What a medium multiplies its density with."""
    if word != "sigma_t" or not isinstance(holder, mi.Medium):
        return 1.0
    scale = float(mi.traverse(holder)["scale"])
    return scale if scale > 0 else 1.0


def role(params: mi.SceneParameters, key: str) -> str:
    """``light`` or ``colour``, which brightness can move between, or nothing."""
    ends = fed(params, key)
    lit = [word for holder, word, _ in ends if isinstance(holder, mi.Emitter) or word in _LIGHTS]
    if lit:
        # Where a light points, and how wide, is no brightness.
        return "" if all(word.endswith(AIMS) for word in lit) else "light"
    own = [word for holder, word, _ in ends if (holder.class_name(), word) not in _GREYS]
    return "colour" if any(word in _COLOURS for word in own) else ""


def _by_attribute(params, shape: mi.Shape, name: str) -> list[tuple[mi.Object, str, float]]:
    """Of what reads the attribute ``name`` of ``shape``."""
    uses, found = _known(params), []
    own = [part for part in (shape.bsdf(), shape.emitter()) if part is not None]
    for texture in uses:
        # It does not tell its attribute otherwise.
        read = texture.class_name() == "MeshAttribute" and re.search(
            r'name = "?([\w.]+)"?', str(texture)
        )
        if not read or read[1] != name:
            continue
        scale = float(mi.traverse(texture)["scale"])
        if scale > 0:
            ends = _ends(uses, texture)
            found += [(*end, scale) for end in ends if _within(uses, end[0], own)]
    return found


def _known(params: mi.SceneParameters) -> dict[mi.Object, list[tuple[mi.Object, str]]]:
    """``_uses``, kept with ``params``: all unknowns of a scene ask."""
    if _KEPT not in vars(params):
        setattr(params, _KEPT, _uses(params))
    return getattr(params, _KEPT)


def _within(uses: dict, thing: mi.Object, wholes: list[mi.Object]) -> bool:
    return thing in wholes or any(_within(uses, user, wholes) for user, _ in uses.get(thing, ()))


def _ends(uses: dict, thing: mi.Object) -> list[tuple[mi.Object, str]]:
    """Through all textures that hold it, such as a chequerboard: what is no texture."""
    found = []
    for holder, word in uses.get(thing, ()):
        nested = isinstance(holder, (mi.Texture, mi.Volume))
        found += _ends(uses, holder) if nested else [(holder, word)]
    return found


def _uses(params: mi.SceneParameters) -> dict[mi.Object, list[tuple[mi.Object, str]]]:
    """Of every object, which others hold it, each with its name for it. A scene that merely lists
    it does not."""
    found: dict = {}
    for holder in params.hierarchy:
        if isinstance(holder, mi.Scene):
            continue
        for word, thing in held(holder):
            found.setdefault(thing, []).append((holder, word))
    return found


def bare(params: mi.SceneParameters, key: str) -> tuple[float, float]:
    """How far values are kept from the lower and the upper end of ``usual``."""
    told = [(word, factor) for _, word, factor in fed(params, key)]
    ends = [
        _BARE.get(word, (0.0, 0.0)) for word, _ in told if word != "albedo" or not glows(params)
    ]
    factors = [factor for word, factor in told if word == "sigma_t"]
    if factors:
        # By a scene's unit of length, and by what its numbers are multiplied with: 1e-3 may be more
        # than there is.
        most = float(as_numpy(params[key]).max(initial=0.0))
        least = min([most if 0 < most < 1 else 1.0, *(1 / each for each in factors if each > 0)])
        ends = [(a * least, b) for a, b in ends]
    return max((a for a, _ in ends), default=0.0), max((b for _, b in ends), default=0.0)


def glows(params: mi.SceneParameters) -> bool:
    """Whether the scene's medium emits (``emission``): its albedo is a radiance, which may be 0."""
    scenes = (each for each in params.hierarchy if isinstance(each, mi.Scene))
    return any(only_emits(each.integrator()) for each in scenes)


def only_emits(integrator: mi.Integrator) -> bool:
    """Whether it is ``emission.Emission``, for which there is ``volume.emitted``."""
    return type(integrator).__name__ == "Emission"


def lowest(low: float, least: float, start: np.ndarray) -> float:
    """Above the end ``low`` of a range, what values stay above: ``least``, or a share of a
    ``start`` all of which is nearer to that end, if by more than a hair; so of a range's other end.
    """
    apart = float(start.max()) - low
    return low + _SHARE * apart if _HAIR < apart < least - low else least


def around(low: float, high: float, values: np.ndarray) -> str:
    """``[low, high]``, widened to hold ``values``, to three digits, or so many that it does not
    come to 1 or -1: with an index or a phase function's g of that, nothing can be rendered."""
    least, most = (_outward(float(x), up) for x, up in ((values.min(), 0), (values.max(), 1)))
    return f"[{min(low, least):.9g}, {max(high, most):.9g}]"


def _outward(x: float, up: bool, digits: int = 3) -> float:
    if x == 0 or not math.isfinite(x):
        return x
    unit = 10.0 ** (math.floor(math.log10(abs(x))) + 1 - digits)
    found = (math.ceil if up else math.floor)(x / unit) * unit
    return _outward(x, up, digits + 1) if abs(found) == 1 != abs(x) and digits < 9 else found
