"""Photographs as a renderer can compare itself with: linear, without a lens, with square pixels."""

from __future__ import annotations

import hashlib
import math
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import map_coordinates

from ...config.photographs import PhotosConfig
from ...runtime import images, raw
from ...runtime.cache import cached, digest
from ...runtime.errors import InputError
from . import clipped, noise, outlines, turns
from .camera import Camera, Photograph

# Raised when what is kept means something else.
_FORMAT = 1
# Points a side of each new pixel at which a photograph is looked up, at most: one for each old
# pixel that it covers.
_MOST = 16
# Pixels, to which a camera is made small where it is only asked what resampling does to noise.
_SMALL = 256
# In place of whether the background counts: it does, and is black in photographs and renderings.
BLACK = "black"
# A weight of at least this much is whole: interpolation rounds.
_WHOLE = 0.999
# Of white, the noise that lossy files leave in a mask's black.
_NOISE = 0.1


def load(
    camera: Camera, settings: PhotosConfig, turned: bool = False, across: bool | None = None
) -> Photograph:
    """The photograph of a camera, from the cache where resampling it was dear. ``turned``: whether
    it is turned as its file asks; ``across``: whether its mask lies otherwise (``turns.across``;
    None: if their sizes tell).

    Raises InputError, naming the file, for one that cannot be read, is of another size than its
    camera or its mask, has no pixel that counts, or one that is no number and does.
    """
    as_linear = linear(camera.image, settings.encoding)
    picture = images.load(camera.image, finite=False, linear=as_linear, turned=turned)
    image, bad = picture.image, images.emptied(picture.image)
    images.emptied(picture.stored)
    camera = turns.resized(camera, image.shape[1::-1], settings)
    alpha, part = images.read_alpha(camera.image, turned), None
    given = None if camera.mask is None else _given_mask(camera, settings, turned, across)
    if given is not None and not camera.hides and opaque(alpha):
        alpha = None
    ending = None if camera.hides else given  # what may say where the object ends
    rim = None
    if settings.background == BLACK:
        if alpha is not None and ending is not None and outlines.framed(alpha, ending):
            rim, alpha = alpha >= _WHOLE, None  # it does not say so
        part, associated = _part(camera, alpha, ending)
        plain = part
        if alpha is None and np.isin(part, (0, 1)).all():
            image, part = outlines.softened(image, part)
        elif alpha is None:
            image = outlines.over_black(image, part)
        elif not associated:
            image = image * part[..., None]
        if rim is not None:
            part = np.where(rim, part, np.float32(-1))
        if outlines.empty(part):
            raise InputError(
                f"{camera.image}: by its alpha or mask it shows nothing of the object: leave this "
                "view out, or mend its mask"
            )
    ended = alpha if part is None else plain
    box = None if ended is None else outlines.box(ended)
    shown, full, lost = _mask(camera, picture, alpha, settings, given, part)
    mask = shown * ~full
    images.check_finite(camera.image, bad & (mask > 0) & (True if part is None else part > 0))
    if part is not None:
        mask *= part >= 0
    variance = None
    if camera.image.suffix.lower() not in noise.LOSSY:
        variance = noise.of_one(image, mask if part is None else mask * (part >= _WHOLE))
    # What is smaller than was asked for is not made larger, which adds pixels and no detail.
    wide = min(settings.width or camera.width, camera.width)
    target, counted = camera.pinhole(wide), mask.any()
    same = camera.ideal and (target.width, target.height) == (camera.width, camera.height)
    if not same:

        def resampled(seen: np.ndarray, weights: np.ndarray) -> dict[str, np.ndarray]:
            return cached(
                f"photograph-{_key(camera, seen, weights, target.width)}",
                lambda: dict(zip(("image", "mask"), resample(camera, target, seen, weights))),
            )

        if settings.edges:
            shown = resampled(image, shown)["mask"]
        made = resampled(image, mask)
        image, mask = made["image"], made["mask"]
        variance = None if variance is None else variance * _noise_kept(camera, target)
        if part is not None:
            known = (part >= 0).astype(np.float32)
            if target.width < camera.width:
                # Or each small pixel of the border would be unknown: the mask is right to half one.
                part = np.where(part < 0, plain, part)
                known = np.ones_like(known) if rim is None else rim.astype(np.float32)
            made = resampled(part[..., None], known)
            part = np.where(made["mask"] > 0, made["image"][..., 0], -1).astype(np.float32)
    if not mask.any():
        if counted and target.width < camera.width:
            raise InputError(
                f"photos.width={settings.width}: {camera.image} has no pixel of that size that "
                f"counts as a whole: take more; it is {camera.width} pixels wide"
            )
        told = ", ".join(f"{number} {why}" for why, number in lost.items() if number)
        raise InputError(
            f"{camera.image}: no pixel counts ({told or 'all outside after undistortion'}): "
            "leave this view out, or mend its mask"
        )
    white = None
    if ending is not None:
        lit = ending[ending > (_NOISE if camera.mask.suffix.lower() in noise.LOSSY else 0)]
        white = float(np.median(lit)) if lit.size else 0.0
    unsure = ending is not None and outlines.unsure(ending)
    edged = shown if settings.edges else None
    return Photograph(
        target, image, mask, lost, picture.doubt, variance, part, white, unsure, box, edged
    )


def opaque(alpha: np.ndarray | None) -> bool:
    """Whether alpha ``(H, W)`` is 1 everywhere, as programs write it that know of none."""
    return alpha is not None and bool((alpha >= _WHOLE).all())


def linear(file: Path, encoding: str) -> bool | None:
    """Whether a file's numbers are linear, as ``photos.encoding`` says; None: as is usual of its
    kind. Raises InputError."""
    if encoding == "srgb" and (kind := of_light(file)) is not None:
        raise InputError(f"photos.encoding=srgb: {file} is {kind}, which is linear: take auto")
    return True if raw.names(file) else {"auto": None, "linear": True, "srgb": False}[encoding]


def of_light(file: Path) -> str | None:
    """What a file is, in words, whose numbers are light: no curve is theirs; None for others.
    Raises InputError."""
    if raw.names(file):
        return "a camera raw file"
    return None if images.counted(file) else "of floating point"


def _mask(
    camera: Camera,
    picture: images.Picture,
    alpha: np.ndarray | None,
    settings: PhotosConfig,
    given: np.ndarray | None,
    part: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray, dict[str, int]]:
    """Weights of the photograph's own pixels but for saturation, which of them are saturated, so
    that they have none, and how many lack one for each reason. ``given``: its
    mask, or None; ``part``: how much of each the object fills, where what it does not fill counts
    as black."""
    mask = np.ones(picture.image.shape[:2], np.float32)
    full, lost = np.zeros(mask.shape, bool), {}
    # The only thing that says where the object ends may not also say what counts.
    if given is not None and (part is None or alpha is not None or camera.hides):
        mask *= given
        lost["masked by its file"] = int(np.count_nonzero(given == 0))
    if alpha is not None and part is None:
        # A pixel that is partly transparent shows what is behind as well.
        mask *= alpha >= _WHOLE
        lost["transparent"] = int(np.count_nonzero(alpha < _WHOLE))
    if settings.saturated is not None:
        # Said of the file's numbers, not of light.
        counted = images.counted(camera.image)
        full = picture.brightest >= np.float32(settings.saturated)
        full = full if counted else clipped.cut_off(picture.stored)
        if part is not None:
            full &= part > 0
        if counted or full.any():
            lost["saturated"] = int(np.count_nonzero(full))
    return mask, full, lost


def _part(
    camera: Camera, alpha: np.ndarray | None, given: np.ndarray | None
) -> tuple[np.ndarray, bool]:
    """How much of each pixel the object fills ``(H, W) float32``, by the picture's alpha or else
    its mask, and whether the picture is multiplied by it already. Raises InputError."""
    if alpha is not None:
        return np.clip(alpha, 0, 1), images.multiplied(camera.image)
    if given is not None:
        # Whatever of it is brightest is the object.
        return given / max(float(given.max()), 1e-6), False
    raise InputError(
        f"photos.background=black: {camera.image} has neither alpha nor a mask, which would say "
        "where the object ends: photos.masks=FOLDER names masks"
    )


def _given_mask(
    camera: Camera, settings: PhotosConfig, turned: bool, across: bool | None
) -> np.ndarray:
    """Of the camera's size, ``(H, W) float32``, white where pixels count. Raises InputError."""
    given = turns.mask(camera.mask, camera.image, turned, across)
    wanted = camera.width, camera.height
    if camera.mask.suffix.lower() in noise.LOSSY and given.max(initial=0) > 1 - _NOISE:
        # Black and white but for its noise.
        given = np.where(given < _NOISE, np.float32(0), given)
        given = np.where(given > 1 - _NOISE, np.float32(1), given)
    if camera.hides:
        given = np.float32(given == 0)
    size = given.shape[1::-1]
    if size == wanted:
        return given
    told = "resize it"
    if turns.factor(size, wanted) is not None:
        if settings.scale is not None:
            shrunk = Image.fromarray(given).resize(wanted, Image.Resampling.BOX)
            return np.asarray(shrunk, np.float32)
        told = "resize it, or take photos.scale=auto"
    raise InputError(
        f"mask {camera.mask} is {size[0]}×{size[1]} pixels, its picture {wanted[0]}×{wanted[1]}: "
        f"{told}"
    )


def resample(
    camera: Camera, target: Camera, image: np.ndarray, mask: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """A photograph ``(H, W, C)`` of ``camera`` and its weights, as ``target`` sees it: the mean
    over each of its pixels' squares, looked up by linear interpolation. A pixel any of whose points
    lies outside or does not count has no weight: part of its square is unknown."""
    shrunk = max(camera.width / target.width, camera.height / target.height)
    finer = min(_MOST, max(1, math.ceil(shrunk - 1e-6)))
    total = np.zeros((target.height, target.width, image.shape[2]))
    least = np.ones((target.height, target.width), np.float32)
    steps = (np.arange(finer) + 0.5) / finer
    rows, columns = np.indices((target.height, target.width), np.float64)
    for down in steps:
        for right in steps:
            plane = np.stack(
                [
                    (columns + right - target.cx) / target.fx,
                    (rows + down - target.cy) / target.fy,
                ],
                axis=-1,
            )
            ordered = np.hypot(plane[..., 0], plane[..., 1]) < camera.lens.reach
            seen = camera.lens.distort(plane) * [camera.fx, camera.fy] + [camera.cx, camera.cy]
            # Half a pixel of the border is not between middles, and takes the outermost pixel.
            inside = ordered & (seen >= 0).all(axis=-1)
            inside &= (seen[..., 0] <= camera.width) & (seen[..., 1] <= camera.height)
            at = [
                np.clip(np.where(inside, seen[..., axis] - 0.5, 0), 0, limit - 1)
                for axis, limit in ((1, camera.height), (0, camera.width))
            ]
            for channel in range(image.shape[2]):
                total[..., channel] += map_coordinates(image[..., channel], at, order=1)
            weight = np.where(inside, map_coordinates(mask, at, order=1), 0)
            least = np.minimum(least, np.where(weight >= _WHOLE, 1, weight))
    # A weight between is a neighbour's that does not count, unless the mask itself has such.
    if np.isin(mask, (0, 1)).all():
        least = np.where(least >= _WHOLE, 1, 0)
    found = total / finer**2
    return found.astype(np.float32), least.astype(np.float32)


def _noise_kept(camera: Camera, target: Camera) -> float:
    """What resampling leaves of the variance of white noise: of both cameras made so small that it
    costs little."""
    by = max(1.0, max(camera.width, camera.height) / _SMALL)

    def small(one: Camera) -> Camera:
        sizes = {n: max(1, round(getattr(one, n) / by)) for n in ("width", "height")}
        return replace(one, **sizes, **{n: getattr(one, n) / by for n in ("fx", "fy", "cx", "cy")})

    seen = small(camera)
    shape = seen.height, seen.width
    white = np.random.default_rng(0).normal(size=(*shape, 3)).astype(np.float32)
    found, counts = resample(seen, small(target), white, np.ones(shape, np.float32))
    return float(np.mean(np.square(found[counts > 0]))) if counts.any() else 1.0


def _key(camera: Camera, image: np.ndarray, mask: np.ndarray, width: int) -> str:
    """By what the pictures hold, not by where they lie."""
    pixels = hashlib.blake2b(np.ascontiguousarray(image).tobytes(), digest_size=16)
    pixels.update(np.ascontiguousarray(mask).tobytes())
    numbers = {
        name: value
        for name, value in asdict(camera).items()
        if isinstance(value, (int, float)) or name == "lens"
    }
    return digest(_FORMAT, pixels.hexdigest(), numbers, width)
