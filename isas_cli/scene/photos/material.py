"""What the object is made of, and what of that is unknown: base colour, roughness, metallic,
normals."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from ...config.photographs import MAP, SIDE, PhotosConfig
from ...config.schema import UnknownConfig
from ...runtime import images
from ...runtime.errors import InputError
from ...scenes import library
from ...scenes.meshes import Surface
from ..mesh_checks import LARGEST_OVERLAP, overlap

# What an unknown base colour, roughness, metallic start at. A metallic that is known is 0.
_GREY, _ROUGHNESS, _METALLIC = 0.5, 0.5, 0.2
# A normal map's texel that bends nothing; and its rate: a step of it turns a normal by less than a
# degree, of more the noise of small pictures is fitted.
_FLAT, _LEAN = (0.5, 0.5, 1.0), 0.005
# Settings, words of keys as well, of what may be a number or a texture.
_EITHER = {"roughness": _ROUGHNESS, "metallic": _METALLIC}
_MAPS = *_EITHER, "normals"


def colour(settings: PhotosConfig) -> tuple[np.ndarray | None, list[str]]:
    """The base colour that is known, ``(H, W, 3) float32``, linear, or None, and what should be
    said of its file. Raises InputError for a file that holds none."""
    if settings.colour is None:
        return None, []
    if not Path(settings.colour).is_file():
        raise InputError(
            f"photos.texture={settings.colour}: no such picture file; a number is texels a side of "
            "a base colour that is unknown"
        )
    try:
        found = images.load(settings.colour)
    except InputError as error:  # which begins with the file's name
        raise InputError(f"photos.texture={error}") from None
    if images.counted(settings.colour):  # a profile's white may be a hair beyond ours
        found.image = np.clip(found.image, 0, 1)
    most = float(found.image.max())
    if not 0 <= float(found.image.min()) <= most <= 1:
        raise InputError(
            f"photos.texture={settings.colour}: holds values from {found.image.min():.3g} to "
            f"{most:.3g}: a base colour lies between 0 and 1"
        )
    return found.image, images.unheeded([settings.colour], [found.doubt])


def check(settings: PhotosConfig, parts: dict[str, Surface]) -> list[str]:
    """What should be said of pictures on the object's ``parts``. Raises InputError where one has
    no texture coordinates, by which a picture lies on it, and none a texture that is asked for."""
    bare = [name for name, part in parts.items() if not len(part.texcoords)]
    asked = {name: MAP for name in _MAPS if getattr(settings, name) == MAP}
    if settings.colour is not None:
        asked = {"texture": settings.colour} | asked
    if len(bare) == len(parts) and settings.texture != SIDE:  # which may as well be nobody's word
        asked.setdefault("texture", settings.texture)
    which = "" if len(parts) == 1 else f" ({', '.join(bare)})"
    lacks = f"{settings.mesh or 'the object'}{which} has no texture coordinates"
    if bare and asked:
        setting, value = next(iter(asked.items()))
        number = f", or take photos.{setting}=true, one number for all of it"
        number = number if setting in _EITHER else ""
        raise InputError(
            f"photos.{setting}={value}: {lacks}, by which a picture lies on it: unwrap it{number}"
        )
    if bare:
        each = "for all of it" if len(bare) == 1 else "each"
        return [f"{lacks}: one colour {each}; unwrap it for a texture"]
    if settings.colour is None or len(parts) == 1:
        return []
    charts = [part.texcoords[part.faces] for part in parts.values()]
    share = overlap(np.concatenate(charts))
    if share <= max(map(overlap, charts)) + LARGEST_OVERLAP:
        return []
    return [
        f"photos.texture={settings.colour} lies on all {len(parts)} materials of {settings.mesh}, "
        f"which share {share:.0%} of its texels: where each has a picture of its own, bake one of "
        "all, and export the mesh with that"
    ]


def described(settings: PhotosConfig, known: np.ndarray | None, surface: Surface) -> dict[str, Any]:
    """As ``mitsuba.load_dict`` takes it. Seen from both sides: scanned meshes often do not know
    which is out. ``known``: its base colour, linear, or None."""

    def laid(texels: np.ndarray) -> dict[str, Any]:
        found = library.texture(texels)
        if surface.texcoords.min() < 0 or surface.texcoords.max() > 1:
            found["wrap_mode"] = "repeat"
        return found

    maps = settings.texels or (SIDE if settings.colour is not None else settings.texture)

    def alike(*value: float, side: int = maps) -> dict[str, Any]:
        return laid(np.full((side, side, len(value)), value, np.float32))

    if known is not None:
        paint = laid(known)
    elif len(surface.texcoords):
        paint = alike(_GREY, _GREY, _GREY, side=settings.texture)
    else:
        paint = {"type": "rgb", "value": [_GREY] * 3}
    found = {"type": "principled", "base_color": paint, "roughness": _ROUGHNESS}
    if settings.roughness == MAP:
        found["roughness"] = alike(_ROUGHNESS)
    if settings.metallic:
        found["metallic"] = alike(_METALLIC) if settings.metallic == MAP else _METALLIC
    if settings.normals == MAP:
        found = {"type": "normalmap", "normalmap": alike(*_FLAT), "bsdf": found}
    return {"type": "twosided", "bsdf": found}


def unknown(settings: PhotosConfig, name: str, surface: Surface) -> dict[str, UnknownConfig]:
    """Of the part ``name``, where nothing else is said: its base colour, unless it is known."""
    if settings.colour is not None:
        return {}
    word = "data" if len(surface.texcoords) else "value"
    spec = UnknownConfig(start=_GREY, range=[0.0, 1.0])
    return {f"{_inside(settings, name)}.base_color.{word}": spec}


def asked(settings: PhotosConfig, name: str) -> dict[str, UnknownConfig]:
    """Of the part ``name``, what the settings say is unknown besides."""
    found = {}
    for setting, start in _EITHER.items():
        if value := getattr(settings, setting):
            word = "data" if value == MAP else "value"
            found[f"{_inside(settings, name)}.{setting}.{word}"] = UnknownConfig(start=start)
    if settings.normals == MAP:
        spec = UnknownConfig(start=list(_FLAT), lr=_LEAN)
        found[f"{_outside(name)}.normalmap.data"] = spec
    return found


def traded(settings: PhotosConfig, keys: Iterable[str], light: str) -> list[str]:
    """A line where images hardly tell unknowns of the surface from others; ``light``: the key that
    begins the environment's. It says what stays as it is."""
    words = [key.split(".") for key in keys]
    lit = any(each[0] == light for each in words)
    has = {w: any(w in each for each in words) for w in ("base_color", "normalmap", *_EITHER)}
    pairs = [
        told
        for told, both in (
            ("metallic from base colour", has["metallic"] and has["base_color"]),
            ("roughness from light", has["roughness"] and lit),
            ("normals from light", has["normalmap"] and lit),
        )
        if both
    ]
    if not pairs:
        return []
    fixed = {
        "base colour": None if has["base_color"] else settings.colour or f"{_GREY:g}",
        "roughness": None if has["roughness"] else f"{_ROUGHNESS:g}",
        "metallic": None if has["metallic"] else "0",
        "normals": None if has["normalmap"] else "the mesh's",
        "light": None if lit else settings.environment or "of one colour",
    }
    stay = ", ".join(f"{name} ({value})" for name, value in fixed.items() if value is not None)
    laid = settings.start is None and any(each[-2:] == ["base_color", "data"] for each in words)
    ways = ["photos.texture=FILE"] * laid + ["photos.environment=FILE"] * lit
    return [
        f"images hardly tell {', '.join(pairs)}, which are unknown together: what is known, give "
        f"({', '.join(ways)}); fixed: {stay or 'nothing'}"
    ]


def _outside(name: str) -> str:
    return f"{name}.bsdf.brdf_0"


def _inside(settings: PhotosConfig, name: str) -> str:
    """Where the keys of the material begin, which a normal map goes around."""
    return f"{_outside(name)}.nested_bsdf" if settings.normals == MAP else _outside(name)
