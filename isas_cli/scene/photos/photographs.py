"""All that is known before a renderer is asked: cameras, pictures, the object."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ...config.photographs import PhotosConfig
from ...runtime import images, memory
from ...runtime.errors import InputError
from ...scenes.meshes import Surface
from . import (
    alike,
    borders,
    brightness,
    finding,
    hull,
    importing,
    material,
    outlines,
    precision,
    reading,
    rims,
    shape,
    surroundings,
    turns,
)
from .base import Capture
from .camera import Camera
from .importing import Photograph

_NAMED = 5  # of pictures that are missing
# Bytes a pixel: its colour, its mask and what the object fills of it, and the targets that they
# become; and maps of edges, where these count. And how many times as much what is advised leaves
# free, for all else.
_BYTES, _OF_EDGES, _SPARE = 56, 96, 2


@dataclass
class Photographs:
    """``shown``: views to learn from, at least one; ``held``: views held out; ``capture``: all that
    their file says; ``parts``: of the object, by shape (``shape.parts``), or None; ``settings``:
    what was asked for; ``warnings``: what should be said of the files; ``colour``: the object's,
    where it is known (``material.colour``), or None."""

    shown: list[Photograph]
    held: list[Photograph]
    capture: Capture
    parts: dict[str, Surface] | None
    settings: PhotosConfig
    warnings: list[str] = field(default_factory=list)
    colour: np.ndarray | None = None

    @cached_property
    def surface(self) -> Surface | None:
        """The whole object's."""
        return None if self.parts is None else shape.joined(list(self.parts.values()))

    @cached_property
    def exposures(self) -> tuple[np.ndarray, float] | None:
        """``brightness.told`` of the views to learn from, where exposures are unknown."""
        channels = {"scale": 1, "channels": 3}.get(self.settings.exposure)
        if channels is None or self.surface is None:
            return None
        return brightness.told(self.shown, self.surface, channels)

    @property
    def all(self) -> list[Photograph]:
        return [*self.shown, *self.held]


def load(settings: PhotosConfig, shapeless: bool = False) -> Photographs:
    """Read and resample. ``shapeless``: whether there may be no object. Raises InputError for all
    that is wrong with cameras, pictures, object."""
    root = reading.folder_of(settings.path)
    if settings.environment is not None and not Path(settings.environment).is_file():
        raise InputError(f"photos.environment={settings.environment}: no such picture file")
    colour, doubts = material.colour(settings)
    with finding.looking(settings, root) as sources:
        capture = reading.read(settings.path, settings.test, settings.cameras, settings.world)
    capture.cameras = reading.without(capture.cameras, settings.without, sources.missing)
    check(capture, sources)
    capture.notes += elsewhere(capture, sources)
    capture.cameras, told = finding.masked(capture.cameras, root, sources)
    over, more = turns.turned(capture.cameras, capture, settings.orientation)
    across, unsure = turns.across(capture.cameras, over)
    more += unsure
    shown, held = reading.split(capture, settings.test)
    parts, described = None, shape.described(settings, capture)
    endless = None if described or settings.start else _endless(capture.cameras)
    hulled = settings.start is not None or not described and endless is None
    if hulled and settings.colour is not None:
        raise InputError(
            f"photos.texture={settings.colour} is laid on by texture coordinates that a hull has "
            "not: give photos.mesh"
        )
    if hulled:
        for name, without in (("background", False), ("materials", "each")):
            given = getattr(settings, name)
            if given not in (without, importing.BLACK):
                raise InputError(
                    f"photos.{name}={str(given).lower()} has no effect on a hull, "
                    "which has one material and black around it: leave it out"
                )
        settings = replace(settings, start="hull", background=importing.BLACK)
    elif described:
        parts = shape.parts(settings, capture)
    elif not shapeless:
        raise InputError(
            "photos.mesh is not given: give a file (OBJ, PLY, STL, glTF), "
            "photos.plane=[x0,y0,x1,y1], photos.sphere=[x,y,z,radius], or alpha or masks of all "
            f"pictures, of which a hull is made: {endless}"
        )
    else:
        capture.notes.append(f"no hull is made of alpha or masks: {endless}")
    _fit(capture.cameras, settings)
    made = [
        [importing.load(c, settings, c.name in over, c.name in across) for c in part]
        for part in (shown, held)
    ]
    if hulled:
        parts, said = _hull(made[0], settings, capture, shapeless)
        told = told + said
    told += [*left_out(sources), *more, *_doubts([*made[0], *made[1]]), *doubts]
    told += _off_middle(capture.cameras)
    told += [] if parts is None else material.check(settings, parts)
    found = Photographs(*made, capture, parts, settings, told, colour)
    told += outlines.doubts(found.all, found.surface, settings.mesh is None)
    if settings.mesh is not None and not (settings.pose or "focal" in settings.lens):
        named = {camera.name: camera for camera in capture.cameras}
        told += outlines.larger(found.all, named, found.surface)
    told += borders.doubts(found.all, found.surface)
    if settings.background == importing.BLACK:
        told += rims.doubts(capture.cameras, over, across)
    if settings.environment is not None:
        lit = Path(settings.environment)
        told += surroundings.doubts(lit, settings.up, capture.cameras)
        told += surroundings.unit(settings, found.all, found.surface)
    told += alike.doubts(found.all, found.surface, hulled)
    told += precision.doubts(found.all, found.surface)
    return found


def _endless(cameras: list[Camera]) -> str | None:
    """Why alpha or masks do not say where the object ends, in words; None where they do."""
    bare = [camera for camera in cameras if camera.mask is None or camera.hides]
    for camera in bare:
        if not images.has_alpha(camera.image):
            return f"{camera.image} has neither"
    if len(bare) < len(cameras):
        return None
    kinds = set()
    for camera in bare:
        alpha = images.read_alpha(camera.image)
        kinds.add(importing.opaque(alpha))
        # Of both kinds the object may well fill the pictures of one.
        if len(kinds) > 1 or not outlines.whole(alpha):
            return None
    told = "is 1 everywhere" if True in kinds else "leaves out a frame along the border"
    return f"there are no masks, and the alpha of all pictures {told}"


def _hull(
    made: list[Photograph], settings: PhotosConfig, capture: Capture, shapeless: bool
) -> tuple[dict[str, Surface] | None, list[str]]:
    """The object as the hull of alpha or masks, and what should be said; where there may be none,
    why there is none. Raises InputError."""
    try:
        cut, said = hull.made(made, settings.voxels)
    except InputError as error:
        if not shapeless:
            raise
        return None, [str(error)]
    capture.notes.append(
        "the object begins as the hull of alpha or masks, of "
        f"{len(cut['faces'])} triangles; photos.mesh=FILE takes a mesh instead"
    )
    return shape.of_hull(cut), said


def check(capture: Capture, sources: finding.Sources) -> None:
    """Raises InputError where no picture is left, one is missing that may not be, or one is that of
    two views."""
    if sources.missing and not sources.skip:
        raise InputError(
            f"the picture or mask of {sources.missing[0]} does not exist, and photos.without means "
            "another view of its name: give both with their folders"
        )
    if not capture.cameras:
        raise InputError(
            f"photos.missing=skip: none of {len(sources.missing)} pictures exists, first "
            f"{sources.missing[0]}: say where they lie by photos.images=FOLDER"
        )
    first: dict[Path, str] = {}
    for camera in capture.cameras:
        other = first.setdefault(camera.image, camera.name)
        if other != camera.name:
            raise InputError(
                f"{camera.image} is the picture of two views, {other} and {camera.name}: give a "
                "photos.images in which each has its own"
            )


def elsewhere(capture: Capture, sources: finding.Sources) -> list[str]:
    """What is said of pictures that are not in ``photos.images``. Raises InputError where none
    is."""
    names = [camera.name for camera in capture.cameras]
    # Others are left out for other reasons.
    missed = [each for each in sources.elsewhere if any(n.endswith(each) for n in names)]
    if not missed:
        return []
    first = missed[0]
    if len(missed) >= len(names):
        raise InputError(
            f"photos.images={sources.images}: none of the pictures is there, first {first}: those "
            "that the cameras' file names are read without it"
        )
    return [
        f"{len(missed)} of {len(names)} pictures are not in "
        f"{sources.images}, first {first}: read from where the cameras' file has them"
    ]


def _fit(cameras: list[Camera], settings: PhotosConfig) -> None:
    """Raises InputError where all views do not go into memory."""
    sizes = [images.size(camera.image) for camera in cameras]
    each = _BYTES + (_OF_EDGES if settings.edges else 0)
    needed = each * sum(w * h * min(1.0, (settings.width or w) / w) ** 2 for w, h in sizes)
    free = memory.available()
    if needed > free:
        fits = max(1, int((free / _SPARE / each / sum(h / w for w, h in sizes)) ** 0.5))
        raise InputError(
            f"photos.path={settings.path}: {len(cameras)} views need {memory.gib(needed)} of "
            f"memory, and {memory.gib(free)} are free: photos.width={fits} makes them smaller"
        )


def _off_middle(cameras: list[Camera]) -> list[str]:
    """Of views whose principal point is far off the middle of their pictures."""
    off = [
        c
        for c in cameras
        if abs(c.cx - c.width / 2) > c.width / 4 or abs(c.cy - c.height / 2) > c.height / 4
    ]
    if not off:
        return []
    first = off[0]
    return [
        f"{len(off)} views have their principal point more than a quarter of the picture off its "
        f"middle, first {first.name}: ({first.cx:.4g}, {first.cy:.4g}) of {first.width} × "
        f"{first.height} pixels. Where pictures were resized after calibration and their file "
        "tells no size, photos.scale says by how much"
    ]


def left_out(sources: finding.Sources) -> list[str]:
    """What is said of views whose pictures are missing."""
    if not sources.missing:
        return []
    names = ", ".join(sources.missing[:_NAMED])
    more = len(sources.missing) - _NAMED
    return [
        f"photos.missing=skip: {len(sources.missing)} of the views are left out, whose pictures do "
        f"not exist: {names}{f' and {more} more' if more > 0 else ''}"
    ]


def _doubts(every: list[Photograph]) -> list[str]:
    """Once for all pictures that say the same."""
    found: dict[tuple[str, str, str], list[Path]] = {}
    for each in every:
        if each.doubt is not None:
            file = each.camera.image
            light = importing.of_light(file) is not None
            taken = ("linear Rec. 709", "linear") if light else ("sRGB", "srgb")
            found.setdefault((each.doubt, *taken), []).append(file)
    return [
        f"{doubt} of {len(files)} pictures, first {files[0]}, cannot be heeded, and their numbers "
        f"are taken as {taken}: convert them to {taken}, or say photos.encoding={encoding}"
        for (doubt, taken, encoding), files in found.items()
    ] + images.partly(each.camera.image for each in every)
