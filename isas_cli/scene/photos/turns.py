"""Whether a photograph with an Orientation tag is read as stored or as turned, and at which size;
and which way up its mask lies.

COLMAP and what writes `transforms.json` know the pixels as they are stored; OpenCV's `imread`, with
which `cameras.json` is usually made, turns them. Where the sizes of pictures and cameras tell, they
say it for all pictures of a set. So do those of masks without a tag of their own, which programs
write as they read the pictures.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ...config.photographs import PhotosConfig
from ...runtime import heif, images, raw
from ...runtime.errors import InputError
from .base import Capture
from .camera import Camera

AUTO = "auto"
# What undoes a tag's turn; the others undo themselves.
_BACK = {6: 8, 8: 6}


def turned(cameras: list[Camera], capture: Capture, asked: str) -> tuple[set[str], list[str]]:
    """Names of the views whose pictures are read as turned, and what should be said. ``asked``:
    ``photos.orientation``. Raises InputError for a picture that cannot be read."""
    tags = {camera.name: images.orientation(camera.image) for camera in cameras}
    tagged = [camera for camera in cameras if tags[camera.name] != 1]
    if asked != AUTO:
        return {c.name for c in tagged} if asked == "turned" else set(), []
    told = {camera.name: _told(camera) for camera in tagged}
    votes = {vote for vote in told.values() if vote is not None}
    found, assumed = set(), []
    for camera in tagged:
        vote = told[camera.name]
        if vote is None and len(votes) == 1:
            vote = next(iter(votes))
        if vote is None:
            # Programs that make pictures of raw files turn them.
            vote = capture.turned or raw.names(camera.image)
            if vote:
                assumed.append(camera)
        if vote:
            found.add(camera.name)
    if not assumed:
        return found, []
    first = assumed[0]
    return found, [
        f"{len(assumed)} pictures are to be turned by their Orientation tag, first {first.image} "
        f"({tags[first.name]}), and no size tells whether their cameras are of them as stored or "
        "as turned: taken as turned, as OpenCV's imread does; if that is wrong, "
        "photos.orientation=stored"
    ]


def _told(camera: Camera) -> bool | None:
    """Whether a camera is of its picture as turned, if their sizes tell."""
    fits = [
        factor(images.size(camera.image, over), (camera.width, camera.height)) is not None
        for over in (False, True)
    ]
    return fits[1] if fits[0] != fits[1] else None


def across(cameras: list[Camera], over: set[str]) -> tuple[set[str], list[str]]:
    """Names of the views whose masks lie otherwise than their pictures are read, and what should be
    said. ``over``: names of those whose pictures are read as turned. Raises InputError for a file
    that cannot be read."""
    masked = [c for c in cameras if c.mask is not None and images.orientation(c.image) != 1]
    told = {c.name: _across(c.mask, c.image, c.name in over) for c in masked}
    found = {name for name, otherwise in told.items() if otherwise}
    bare = [c for c in masked if images.orientation(c.mask) == 1]
    unsure = [c for c in bare if told[c.name] is None]
    votes = {told[c.name] != (c.name in over) for c in bare if c not in unsure}
    if len(votes) == 1:
        (upright,) = votes
        return found | {c.name for c in unsure if upright != (c.name in over)}, []
    if not unsure:
        return found, []
    first = unsure[0]
    lie = "turned" if first.name in over else "stored"
    return found, [
        f"{len(unsure)} masks have no Orientation tag, first {first.mask}, their pictures have "
        f"({images.orientation(first.image)}), and no size tells which way up they lie: taken as "
        f"their pictures are, as {lie}; if that is wrong, turn the masks"
    ]


def _across(mask: Path, picture: Path, turned: bool) -> bool | None:
    """Whether a mask lies otherwise than its picture is read, ``turned`` or not, if their sizes
    tell."""
    if images.orientation(picture) < 5:
        return None
    size, wanted = images.size(mask, turned), images.size(picture, turned)
    fits = [factor(each, wanted) is not None for each in (size, size[::-1])]
    return fits[1] if fits[0] != fits[1] else None


def mask(
    file: Path, picture: Path, turned: bool = True, otherwise: bool | None = None
) -> np.ndarray:
    """A mask, as ``images.read_mask`` has it, that lies as its picture, ``turned`` or not.
    ``otherwise``: whether the file's lies in the other way (None: if sizes tell). Raises
    InputError."""
    found, tag = images.read_mask(file, turned), images.orientation(picture)
    if otherwise is None:
        otherwise = _across(file, picture, turned)
    return images.upright(found, tag if turned else _BACK.get(tag, tag)) if otherwise else found


def factor(size: tuple[int, int], wanted: tuple[int, int]) -> float | None:
    """By which plain factor a picture of ``size`` is larger than one of the size ``wanted``, along
    both axes, but for the rounding to whole pixels; None where there is none."""
    across, down = (have / want for have, want in zip(size, wanted))
    if size == wanted:
        return 1.0
    off = abs(size[0] - wanted[0] * down), abs(size[1] - wanted[1] * across)
    longer = 0 if wanted[0] >= wanted[1] else 1
    # That of the longer side is the more exact. A size off by a pixel was cut, not made smaller.
    plain = off[1 - longer] <= 1 and max(abs(h - w) for h, w in zip(size, wanted)) > 1
    return (across, down)[longer] if plain else None


def resized(camera: Camera, size: tuple[int, int], settings: PhotosConfig) -> Camera:
    """The camera of a picture of that ``size``. Raises InputError where it has another, unless
    ``photos.scale`` says so."""
    own, scale = (camera.width, camera.height), settings.scale
    plain = found = factor(size, own)
    if found is not None and isinstance(scale, (int, float)):
        least = 1 / min(own)  # what rounding to a pixel may change
        found = found if abs(found - scale) <= max(least, 1e-3 * scale) else None
    elif scale is None and size != own:
        found = None
        if plain is not None:
            raise InputError(
                f"{_sizes(camera, size)}: {plain:.4g} times as large: photos.scale=auto where it "
                "was resized after calibration"
            )
    if found is None:
        told = "resize the picture, or scale the camera's numbers"
        if scale is not None:
            told = f"photos.scale={scale}, and no one factor of both axes is that"
            if plain is not None:
                told = f"photos.scale={scale}, but it is {plain:.4g} times as large"
        elif heif.names(camera.image):
            told = "HEIC pictures are turned as they are decoded: convert them as the cameras' were"
        raise InputError(f"{_sizes(camera, size)}: {told}")
    return scaled(camera, size)


def scaled(camera: Camera, size: tuple[int, int]) -> Camera:
    """The camera of a picture of that ``size``, which shows the same."""
    across, down = (have / want for have, want in zip(size, (camera.width, camera.height)))
    return replace(
        camera,
        width=size[0],
        height=size[1],
        fx=camera.fx * across,
        fy=camera.fy * down,
        cx=camera.cx * across,
        cy=camera.cy * down,
    )


def _sizes(camera: Camera, size: tuple[int, int]) -> str:
    here = f"{size[0]}×{size[1]} pixels, its camera {camera.width}×{camera.height}"
    return f"{camera.image} is {here}"
