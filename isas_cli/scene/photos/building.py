"""A Mitsuba scene of photographs: their cameras, the object, the light."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from ...config.schema import PhotosConfig, PoseConfig, UnknownConfig
from ...runtime import images
from ...runtime.errors import InputError
from ...scenes import meshes
from ...unknowns.exposure import Exposure
from ...unknowns.optics import Together
from ...unknowns.parameters import own
from ...unknowns.unknowns import Unknown
from ..views import PARTS, Glass, Views
from . import material, outlines
from .camera import Camera
from .importing import BLACK, Photograph
from .photographs import Photographs
from .shape import OBJECT

SKY = "sky"
EXPOSURE, CAMERAS, LENS = "exposure", "cameras", "lens"  # the keys of what is the views' own
SIZE = "size"  # of the pose that photographs ask for
_CHANNELS = {"fixed": None, "scale": 1, "channels": 3}
# Rates: of lenses, in pixels; of exposures that start anywhere, and where they are told, as a part
# of what these may be off.
_PIXELS, _FROM_ONE, _ACROSS = 0.1, 0.05, 0.3
# Times as fast where the object takes their focal length up in its size: a pixel moves less then.
_WITH_SIZE = 3
# What an unknown environment starts at; where pictures are darker or brighter by more than these,
# it starts as bright as they are beside the grey that colours start at.
_LIGHT, _USUAL, _GREY = 1.0, (1 / 16, 4.0), 0.5
# Rates: of a shape's vertices, of a shift and a size, as shares of the object's size; of a turn, in
# degrees. And the share of the budget in which shapes and poses follow the outline alone.
GROWTH, _STEP, _DEGREES, _BY_OUTLINE = 0.002, 0.003, 0.3, 0.25
_DEPTH = 3
# From Mitsuba's environments, whose up is y, to another axis: axis and angle of a rotation.
_TURNS = {
    "y": ([1, 0, 0], 0),
    "z": ([1, 0, 0], 90),
    "-y": ([1, 0, 0], 180),
    "-z": ([1, 0, 0], -90),
    "x": ([0, 0, 1], -90),
    "-x": ([0, 0, 1], 90),
}


def description(photographs: Photographs, max_depth: int | None) -> dict[str, Any]:
    """As ``mitsuba.load_dict`` takes it; sensors in the order of ``Photographs.all``."""
    settings, surface = photographs.settings, photographs.surface
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    middle = (low + high) / 2
    sensors = {
        f"sensor_{number:05d}": sensor(each.camera, middle, float(np.linalg.norm(high - low)))
        for number, each in enumerate(photographs.all)
    }
    return {
        "type": "scene",
        "integrator": {
            "type": "prb",
            "max_depth": _DEPTH if max_depth is None else max_depth,
            "hide_emitters": settings.background == BLACK,
        },
        SKY: _sky(settings),
        **{
            name: meshes.shape(name, part, material.described(settings, photographs.colour, part))
            for name, part in photographs.parts.items()
        },
        **sensors,
    }


def sensor(camera: Camera, middle: np.ndarray, extent: float) -> dict[str, Any]:
    """Mitsuba's camera for a pinhole camera with square pixels; ``middle``, ``extent``: of what it
    looks at, within which it may stand.

    Mitsuba's camera has x to the left and y up, and its principal point is told as what the middle
    of the film lies to the right of it and below it, in sizes of the film.
    """
    distance = max(float(np.linalg.norm(camera.centre - middle)), 1e-6)
    far = 1e3 * max(distance, extent)
    return {
        "type": "perspective",
        "fov": float(np.degrees(2 * np.arctan(camera.width / 2 / camera.fx))),
        "fov_axis": "x",
        "principal_point_offset_x": 0.5 - camera.cx / camera.width,
        "principal_point_offset_y": 0.5 - camera.cy / camera.height,
        "near_clip": max(1e-3 * distance, 1e-7 * far),
        "far_clip": far,
        "to_world": mi.ScalarTransform4f(straightened(camera) @ np.diag([-1.0, -1.0, 1.0, 1.0])),
        "film": {
            "type": "hdrfilm",
            "width": camera.width,
            "height": camera.height,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
        },
    }


def straightened(camera: Camera) -> np.ndarray:
    """``to_world`` with the nearest true rotation: files round, and Mitsuba refuses scale."""
    u, _, v = np.linalg.svd(camera.to_world[:3, :3])
    found = camera.to_world.copy()
    found[:3, :3] = u @ v
    return found


def unknowns(taken: Photographs, own: dict, poses: dict[str, PoseConfig]) -> dict[str, Any]:
    """What is unknown: ``own``, or the shape of a hull, the base colour of each part and the light,
    where they are not given; always what the settings ask for besides: roughness, metallic,
    normals, the object's ``poses``, exposures and poses of views. Raises InputError for keys that
    speak of one part where there are several, and for nothing."""
    settings, parts = taken.settings, taken.parts
    found = dict(own)
    if len(parts) > 1:
        _check_parts(settings, list(parts), found)
    size = float(np.linalg.norm(np.ptp(taken.surface.vertices, axis=0)))
    if not own and settings.start is not None:
        found[f"{OBJECT}.vertices"] = UnknownConfig(lr=GROWTH * size)
    for name, part in parts.items():
        usual = {} if own else material.unknown(settings, name, part)
        for key, spec in (usual | material.asked(settings, name)).items():
            found.setdefault(key, spec)
    if not own and settings.environment is None:
        found[f"{SKY}.data"] = _lit(taken)
    for name, each in poses.items() if settings.pose else ():
        rate = _DEGREES if each.kind == "rotation" else _STEP
        rate *= size if each.kind == "translation" else 1
        found.setdefault(name, UnknownConfig(start=0.0, lr=rate))
    if settings.exposure != "fixed" and EXPOSURE not in found:
        found[EXPOSURE] = _exposure(taken)
    if settings.refine:
        found.setdefault(CAMERAS, UnknownConfig(start=0.0))
    if settings.lens:
        rate = _PIXELS * (_WITH_SIZE if _sized(settings) else 1)
        found.setdefault(LENS, UnknownConfig(start=0.0, lr=rate))
    if not found:
        raise InputError(
            f"photos.texture={settings.texture} and photos.environment={settings.environment} are "
            "known, and nothing else is unknown: photos.roughness, photos.metallic (true, map), "
            "photos.normals=map, photos.pose=true, photos.exposure=scale, photos.refine=true or "
            "photos.lens=[focal] says what to find, or scene.unknowns"
        )
    return found


def _lit(taken: Photographs) -> UnknownConfig:
    """An unknown environment, in the unit of the pictures."""
    shown = []
    for each in taken.shown:
        counts = (each.mask > 0) & (True if each.part is None else each.part > 0.5)
        shown.append(each.image[counts].mean(axis=1) / np.mean(each.camera.exposure))
    shown = np.concatenate(shown)
    light = float(np.median(shown)) / _GREY if shown.size else _LIGHT
    usual = light <= 0 or _USUAL[0] <= light <= _USUAL[1]
    return UnknownConfig(start=_LIGHT if usual else light)


def rates(found: list[Unknown]) -> None:
    """Let a light that photographs made unknown move as fast as it is bright."""
    for unknown in found:
        if unknown.key == f"{SKY}.data" and not unknown.asked:
            unknown.speed = float(unknown.start.max()) / _LIGHT


def _exposure(taken: Photographs) -> UnknownConfig:
    """Exposures that begin where the same places are as bright in all views, if that can be."""
    if taken.exposures is None:
        return UnknownConfig(start=1.0, lr=_FROM_ONE)
    start, near = taken.exposures
    low, high = (f"{float(each):.3g}" for each in (start.min(), start.max()))
    taken.capture.notes.append(
        f"exposures between {low} and {high} of the first view's, at which the views show the same "
        f"places of the object alike: they stay within {near:.0%} of that"
    )
    usual = Exposure.usual  # which may be too narrow for what is told
    ends = [min(usual[0], float(start.min()) / 2), max(usual[1], 2 * float(start.max()))]
    return UnknownConfig(start=start.tolist(), lr=_ACROSS * near, range=ends)


def poses(taken: Photographs, own: dict[str, PoseConfig]) -> dict[str, PoseConfig]:
    """``own`` and, where ``photos.pose`` asks for them, turns about the world's axes through the
    object's middle, a size and a shift, of all its parts together."""
    if not taken.settings.pose:
        return own
    objects, vertices = list(taken.parts), taken.surface.vertices
    middle = [float(x) for x in (vertices.min(axis=0) + vertices.max(axis=0)) / 2]
    axes = np.eye(3).tolist()
    found = {
        f"turn_{name}": PoseConfig("rotation", objects, axis=axis, origin=middle)
        for name, axis in zip("xyz", axes)
    }
    found[SIZE] = PoseConfig("scale", objects, origin=middle)
    return found | {"shift": PoseConfig("translation", objects)} | own


def stage(taken: Photographs, wanted: dict[str, Any], found: list[Unknown]) -> None:
    """Let shapes and poses find their outline, where the photographs tell it, before anything else
    moves of which ``wanted`` does not say when: what colours and light have been made to fit them
    wrongly holds them where they are. Raises InputError where edges are to be followed, and by
    nothing, and where lenses bend them."""
    moving = [unknown for unknown in found if unknown.kind.moves_geometry]
    if moving and "radial" in taken.settings.lens:
        raise InputError(
            f"photos.lens: radial distortion bends the outline of what moves ('{moving[0].key}'), "
            "which is followed along straight lines: take photos.lens=[focal,centre]"
        )
    if taken.settings.edges and not moving:
        raise InputError(
            "photos.edges=true: nothing that is unknown moves: photos.pose=true makes the object's "
            f"pose unknown, scene.unknowns its shape ({OBJECT}.vertices)"
        )
    masked = taken.settings.background == BLACK
    if not (masked or taken.settings.edges) or not any(unknown.moves(0.0) for unknown in moving):
        return
    for unknown in found:
        # Once the object lies where it is seen: before, it has the wrong perspective as well.
        told = masked and unknown.kind.outlined
        if wanted[unknown.key].during is None and not unknown.kind.moves_geometry:
            unknown.during = (_BY_OUTLINE / 2 if told else _BY_OUTLINE), 1.0


def together(taken: Photographs, found: list[Unknown]) -> list[Together]:
    """The object's size and its lenses' focal lengths, where both are unknown."""
    if not _sized(taken.settings) or not {unknown.key for unknown in found} >= {LENS, SIZE}:
        return []
    (lens,) = (unknown.kind for unknown in found if unknown.key == LENS)
    return [Together(LENS, SIZE, lens.glass)]


def _sized(settings: PhotosConfig) -> bool:
    return settings.pose and "focal" in settings.lens


def _check_parts(settings: PhotosConfig, names: list[str], own: dict) -> None:
    for key in own:
        if key.partition(".")[0] == OBJECT:
            raise InputError(
                f"scene.unknowns: '{key}': {settings.mesh} has several materials, a shape each: "
                f"{', '.join(names)}; photos.materials=one makes one shape '{OBJECT}' of them"
            )


def traded(settings: PhotosConfig, keys: list[str]) -> list[str]:
    """That images hardly tell some of the unknowns ``keys`` apart."""
    found = material.traded(settings, keys, SKY)
    if _sized(settings) and settings.background != BLACK:
        found.append(
            "the object's size and the focal length ('lens') can trade with each other, and both "
            "may come out wrong: leave photos.pose or focal out"
        )
    if settings.refine and "centre" in settings.lens:
        found.append(
            "turns of the cameras and the principal point ('lens') can trade with each other: "
            "leave photos.refine or centre out"
        )
    return found


def of_views(taken: Photographs, views: Views, own: Iterable[str] = ()) -> dict:
    """What of ``Loaded`` is of photographs, where unknowns ``own`` have specs of their own. Raises
    InputError for a single view, whose exposure and pose nothing tells from light and surface. A
    lens is told by how the object looks."""
    asked, views.given = taken.settings, given(taken.shown)
    if views.count == 1 and asked.exposure != "fixed":
        raise InputError(
            f"photos.exposure={asked.exposure}: the first view's stays as it is, and there is no "
            "other: take photos.exposure=fixed"
        )
    if views.count == 1 and asked.refine:
        raise InputError(
            "photos.refine=true: of a single view nothing tells the camera's pose from the "
            "object's: photos.pose=true finds that"
        )
    return {
        "views": views,
        "channels": _CHANNELS[asked.exposure],
        "told": None if EXPOSURE in own else taken.exposures,
        "pixel": pixels(taken) if asked.refine else None,
        "glass": glass(taken) if asked.lens else None,
    }


def glass(photographs: Photographs) -> Glass:
    """The lenses of all views, those to learn from before those held out. One is shared by pictures
    whose cameras are alike in all numbers; those of views held out alone, or, of ``each`` picture
    its own, of all held out, are not unknown."""
    settings, cameras = photographs.settings, [each.camera for each in photographs.all]
    # As their files have them, before distortion was taken out.
    before = {c.name: c for c in photographs.capture.cameras}
    read = [before[c.name] for c in cameras]
    told = [(c.width, c.height, c.fx, c.fy, c.cx, c.cy, c.lens) for c in read]
    if settings.lenses == "each":
        told = [(c.name,) for c in cameras]
    shown = len(photographs.shown)
    kinds = list(dict.fromkeys(told[:shown]))
    names = [cameras[told.index(each)].name for each in kinds]
    return Glass(
        np.array([kinds.index(each) if each in kinds else -1 for each in told]),
        np.array([c.fx for c in cameras]),
        np.array([float(c.width) for c in cameras]),
        np.array([straightened(c)[:3, :3].T for c in cameras]),
        tuple(part for part in PARTS if part in settings.lens),
        tuple(names),
    )


def given(photographs: list[Photograph]) -> mi.Float | None:
    """The exposures that files say, as ``Views.given``; None where all are 1."""
    found = np.array([each.camera.exposure for each in photographs], np.float32)
    return None if (found == 1).all() else own(mi.Float, found.ravel())


def pixels(photographs: Photographs) -> np.ndarray:
    """Of each view to learn from, ``(V, 2)``: the turn (radians) and the shift (scene units) of its
    camera that move what it looks at by a pixel."""
    points, found = outlines.scattered(photographs.surface), []
    for camera in (each.camera for each in photographs.shown):
        _, depth, inside = camera.seen(points)
        away = np.median(depth[inside]) if inside.any() else np.abs(depth).mean()
        found.append([1 / camera.fx, away / camera.fx])
    return np.array(found)


def _sky(settings: PhotosConfig) -> dict[str, Any]:
    if settings.environment is not None:
        return light(Path(settings.environment), upright(settings.up, settings.turn))
    pixels = np.full((settings.sky, 2 * settings.sky, 3), _LIGHT)
    return _environment(pixels, upright(settings.up, 0.0))


def light(file: Path, world: mi.ScalarTransform4f) -> dict[str, Any]:
    """The environment in a picture file, turned by ``world``."""
    return _environment(np.maximum(images.read(file), 0), world)


def upright(up: str, turn: float) -> mi.ScalarTransform4f:
    """What turns an environment whose up is the world's axis ``up``, and then by ``turn`` degrees
    about that axis, counter-clockwise as seen from its tip."""
    axis, angle = _TURNS[up]
    tip = [float(name == up[-1]) * (-1 if up[0] == "-" else 1) for name in "xyz"]
    return mi.ScalarTransform4f().rotate(tip, turn) @ mi.ScalarTransform4f().rotate(axis, angle)


def facing(camera: Camera) -> mi.ScalarTransform4f:
    """What turns an environment so that its middle lies straight ahead of a camera."""
    turned = np.eye(4)
    turned[:3, :3] = straightened(camera)[:3, :3] @ np.diag([-1.0, -1.0, 1.0])
    return mi.ScalarTransform4f(turned)


def _environment(pixels: np.ndarray, world: mi.ScalarTransform4f) -> dict[str, Any]:
    return {
        "type": "envmap",
        "bitmap": mi.Bitmap(np.ascontiguousarray(pixels, np.float32)),
        "to_world": world,
    }
