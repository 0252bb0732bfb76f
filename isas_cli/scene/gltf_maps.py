"""Mitsuba's textures as pictures and factors, as glTF has them; what a file says of a scene."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import mitsuba as mi
import numpy as np
from scipy import ndimage

from ..unknowns.parameters import as_numpy
from .instances import references

# Takes, in words, what cannot be said in glTF.
Leave = Callable[[str], None]
_LUMINANCE = np.array([0.212671, 0.715160, 0.072169])  # of Rec. 709
# Pictures of unlike size become one that holds all texels, up to so many times the larger one.
_LARGER = 4
_UNTOLD = 0.5


@dataclass(frozen=True)
class Said:
    """What the file of a scene, whose nodes are ``state``'s, says of its objects. ``made_from``: by
    object the number of the node that it was made from."""

    made_from: dict
    state: mi.parser.ParserState

    def __call__(self, thing: mi.Object) -> mi.Properties | None:
        """None where it does not name the object."""
        number = self.made_from.get(thing)
        return None if number is None else self.state.nodes[number].props

    def kind(self, thing: mi.Object) -> str:
        """As the file calls it, or else Mitsuba."""
        said = self(thing)
        return thing.class_name() if said is None else said.plugin_name()

    def name(self, thing: mi.Object) -> str | None:
        """Where it stands beside the scene's other things, for several to share."""
        return thing.id() if self.made_from.get(thing) in self._beside else None

    @cached_property
    def _beside(self) -> set[int]:
        return set(references(self.state.root.props).values())


@dataclass(frozen=True)
class Map:
    """``texels (H, W, C)``, linear; of a constant ``(1, 1, C)``, and ``turn`` is None.

    turn: the 3 × 3 matrix, row by row, from a mesh's texture coordinates to the picture's, whose
        row i of n covers v in [i/n, (i+1)/n]
    wrap, filter: as Mitsuba calls them
    """

    texels: np.ndarray
    turn: tuple[float, ...] | None = None
    wrap: str = "repeat"
    filter: str = "bilinear"

    @property
    def stands(self) -> tuple:
        """What pictures have in common that can be one."""
        return self.turn, self.wrap, self.filter

    def mean(self) -> Map:
        return Map(self.texels.mean(axis=(0, 1), keepdims=True))

    def of(self, channels: int) -> Map:
        """With as many channels; of a colour, how bright it is."""
        texels = self.texels
        if texels.shape[2] > channels:
            texels = (texels @ _LUMINANCE.astype(texels.dtype))[..., None]
        return replace(self, texels=np.broadcast_to(texels, (*texels.shape[:2], channels)))


def constant(*numbers: float) -> Map:
    return Map(np.array(numbers, np.float32).reshape(1, 1, -1))


@dataclass(frozen=True)
class Picture:
    """``factors``: by which each channel of ``pixels (H, W, n)``, linear and in [0, 1], is to be
    multiplied; without ``pixels`` the channels themselves."""

    factors: np.ndarray
    pixels: np.ndarray | None = None
    turn: tuple[float, ...] | None = None
    wrap: str = "repeat"
    filter: str = "bilinear"


def read(texture: mi.Texture, what: str, leave: Leave, said: Said) -> Map:
    """What ``texture`` shows; ``what`` it is, in words."""
    values, named = mi.traverse(texture), said(texture)
    if "data" in values and "to_uv" in values:
        texels = as_numpy(values["data"])
        texels = texels[..., None] if texels.ndim == 2 else texels
        modes = {} if named is None else {k: named[k] for k in _MODES if k in named}
        modes = {_MODES[name]: value for name, value in modes.items()}
        return Map(texels, _turn(values["to_uv"]), **modes)
    if "value" in values:
        return constant(*as_numpy(values["value"]).ravel())
    if {"color0.value", "color1.value"} <= set(values.keys()):
        colours = [constant(*as_numpy(values[f"color{n}.value"]).ravel()).of(3) for n in (0, 1)]
        even, odd = (each.texels[0, 0] for each in colours)
        return Map(np.array([[even, odd], [odd, even]]), _turn(values["to_uv"]), filter="nearest")
    try:
        mean = float(as_numpy(texture.mean()).mean())
    except RuntimeError:  # some tell none
        leave(f"the '{said.kind(texture)}' of the {what}, which is {_UNTOLD} there,")
        return constant(_UNTOLD)
    leave(f"the '{said.kind(texture)}' of the {what}, but for its mean,")
    return constant(mean)


_MODES = {"wrap_mode": "wrap", "filter_type": "filter"}


def _turn(matrix) -> tuple[float, ...]:
    return tuple(np.array(matrix.matrix, np.float64).ravel().tolist())


def packed(leave: Leave, **maps: Map) -> Picture:
    """``maps``, by what they are, as channels of one picture. Constants become factors, and white
    in the picture: 8 bits would round them. A picture that stands otherwise than the first is left
    at its mean."""
    drawn = [each for each in maps.values() if each.turn is not None]
    if not drawn:
        factors = np.concatenate([each.texels.ravel() for each in maps.values()])
        return Picture(_legal(factors.astype(np.float64), leave, maps))
    height, width = (_shared(*(each.texels.shape[axis] for each in drawn)) for axis in (0, 1))
    factors, planes = [], []
    for what, each in maps.items():
        if each.turn is not None and each.stands != drawn[0].stands:
            leave(f"the picture of the {what}, which stands otherwise, but for its mean,")
            each = each.mean()
        ones = np.ones(each.texels.shape[2])
        if each.turn is None:
            factors.append(each.texels.ravel())
            planes.append(np.broadcast_to(ones, (height, width, len(ones))))
        else:
            factors.append(ones)
            planes.append(_enlarged(each, height, width))
    pixels = np.concatenate(planes, axis=2, dtype=np.float32)  # of which 8 bits are kept
    factors = _legal(np.concatenate(factors, dtype=np.float64), leave, maps)
    return Picture(factors, _legal(pixels, leave, maps), *drawn[0].stands)


def _shared(*sizes: int) -> int:
    found = math.lcm(*sizes)
    return found if found <= _LARGER * max(sizes) else max(sizes)


def _legal(values: np.ndarray, leave: Leave, maps: dict[str, Map]) -> np.ndarray:
    if values.min() < -1e-4 or values.max() > 1 + 1e-4:
        leave(f"what lies outside 0 to 1 in the {' and '.join(maps)}")
    return np.clip(values, 0, 1)


def _enlarged(map_: Map, height: int, width: int) -> np.ndarray:
    """Its texels between those that it has, ``(height, width, C)``."""
    if map_.texels.shape[:2] == (height, width):
        return map_.texels
    texels, order = map_.texels.astype(np.float64), int(map_.filter != "nearest")
    zoom = height / texels.shape[0], width / texels.shape[1], 1
    mode = "grid-wrap" if map_.wrap == "repeat" else "nearest"
    return ndimage.zoom(texels, zoom, order=order, mode=mode, grid_mode=True)
