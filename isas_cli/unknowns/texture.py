"""Bitmap textures: numbers or colours laid out on surfaces."""

from __future__ import annotations

import re

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime.errors import InputError
from .kind import Kind, Loaded, picture
from .parameters import is_differentiable, like, owner
from .ranges import fed

# What materials take of a texture as one number: of three channels Mitsuba has the luminance.
_NUMBERS = frozenset(
    ("roughness", "alpha", "alpha_u", "alpha_v", "metallic", "anisotropic", "specular")
    + ("spec_tint", "spec_trans", "diff_trans", "flatness", "sheen", "sheen_tint", "clearcoat")
    + ("clearcoat_gloss", "opacity", "weight", "nested_texture")
)
_GREY = 0.01  # by which channels of a grey picture may differ
# Of a to_uv of a lesser determinant all coordinates lie on a line.
_FLAT = 1e-12


class Texture(Kind):
    """The texels of a bitmap, ``(H, W, channels)``, linear."""

    name = "texture"

    @classmethod
    def matches(cls, params: mi.SceneParameters, key: str) -> bool:
        if not (isinstance(owner(params, key), mi.Texture) and dr.is_tensor_v(params[key])):
            return False
        return is_differentiable(params, key) and len(params[key].shape) == 3

    def __init__(self, key: str, loaded: Loaded):
        super().__init__(key, loaded)
        self.texture = owner(loaded.params, key)
        if min(self.present.shape[:2]) < 2 and self.texture.class_name().startswith("Bitmap"):
            raise InputError(
                f"'{key}' is {self.present.shape}, and Mitsuba changes no texture of a single row "
                "or column: give it twice"
            )
        told = str(self.texture)
        self.raw = "raw = 1" in told
        # Said of no file, but of a program's numbers, that is that they are linear.
        self._held = self.raw and 'name = ""' in told
        self.turned = not re.search(r'name = "[^"]', told)
        self.colours = bool(self.role)
        whole, _, name = key.rpartition(".")
        to_uv = np.eye(3)
        if f"{whole}.to_uv" in loaded.params:
            to_uv = np.array(loaded.params[f"{whole}.to_uv"].matrix, np.float64)
        wraps = _repeats(self.texture, name, self.present.shape, to_uv)
        self.axes = ((0, wraps), (1, wraps))
        holders = (holder for holder, _, _ in fed(loaded.params, key))
        self._lamp = any(isinstance(each, mi.Emitter) and _area(each) for each in holders)

    @property
    def decoded(self) -> bool:
        """As Mitsuba does with the texture's own file, whatever is in it."""
        return bool(self.role) if self._held else not self.raw

    def refusal(self, array: np.ndarray) -> str | None:
        if array.any() or not self._lamp:
            return None
        return "a lamp's picture that is zero everywhere cannot be sampled; above 0 somewhere"

    def warnings(self) -> list[str]:
        # Of other materials ``specular`` is a colour.
        single = self.words and self.words <= _NUMBERS and not self.role
        if not single or np.ptp(self.present, axis=2).max() <= _GREY:
            return []
        takes = f"{', '.join(sorted(self.words))} take{'s' if len(self.words) == 1 else ''}"
        return [
            f"'{self.key}': {takes} the brightness of three channels, which images do not tell "
            "apart: give a picture of one channel"
        ]

    def pictures(self, array: np.ndarray) -> dict[str, np.ndarray]:
        return picture(array)


def _area(light: mi.Emitter) -> bool:
    return mi.has_flag(light.flags(), mi.EmitterFlags.Surface)


def _repeats(texture: mi.Texture, name: str, shape: tuple[int, ...], to_uv: np.ndarray) -> bool:
    """Whether the bitmap goes on with its first texels behind the last, Mitsuba's default.

    Its wrap mode cannot be asked, so it is looked up a little beyond two edges: a repeated bitmap
    shows the opposite edge's texels there (most of them, where texels are blended), any other the
    edge's own. Meanwhile its texels, the parameter ``name`` of this ``shape``, are others, which
    differ from edge to edge. Waits.
    """
    height, width, channels = shape
    if channels not in (1, 3) or abs(np.linalg.det(to_uv)) < _FLAT:
        return True
    ramp = np.add.outer(np.arange(height, dtype=np.float32), np.arange(width, dtype=np.float32))
    texels = np.repeat((ramp[..., None] + 1) / (height + width), channels, axis=2)
    rows, columns = (np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width
    u = np.concatenate([np.full(height, -0.25 / width), columns])
    v = np.concatenate([rows, np.full(width, -0.25 / height)])
    at = np.linalg.solve(to_uv, np.stack([u, v, np.ones_like(u)]))
    si = dr.zeros(mi.SurfaceInteraction3f, len(u))
    si.uv = mi.Point2f(at[:2].astype(np.float32))
    values = mi.traverse(texture)
    kept = type(values[name])(values[name])  # what is read itself follows the texture
    values[name] = like(type(kept), texels)
    values.update()
    shown = texture.eval(si) if channels == 3 else mi.Vector1f(texture.eval_1(si))
    shown = np.array(shown).T.reshape(len(u), channels)
    values[name] = kept
    values.update()
    own = np.concatenate([texels[:, 0], texels[0]])
    opposite = np.concatenate([texels[:, -1], texels[-1]])
    return bool(np.abs(shown - opposite).sum() <= np.abs(shown - own).sum())
