"""A result from other places and under other lights, as Mitsuba's own path tracer renders it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import mitsuba as mi
import numpy as np

from ..config.photographs import CAMERA
from ..runtime import backend, images
from ..runtime.errors import InputError
from .photos import building, finding
from .photos.camera import Camera

_DEPTH = 8  # edges of paths under another light than the run's
# Samples of one rendering: Dr.Jit counts the lanes of a kernel in 32 bits, and all need memory.
_AT_ONCE = 2**24
# Renderings of a view, at least: of a pixel that has a path that is no number, one is left out.
_PARTS = 4


def views(
    result: tuple[mi.Scene, int, bool],
    cameras: list[Camera],
    lights: list[Path | None],
    up: str,
    turn: float,
    spp: int,
) -> Iterator[tuple[np.ndarray, int]]:
    """What each camera sees, ``(H, W, 3)``, linear, black where no surface is: under the
    environment in the file of the same place in ``lights``, in place of all lights of the scene;
    or under these, where it is None, by paths as its own. And of how many pixels paths are no
    numbers: these are left out, and a pixel is NaN where none is left. ``result``: as
    ``export.result`` has it. ``up``, ``turn``: see ``building.upright``; up may also be ``CAMERA``:
    the environment stands to the view's camera as Stanford-ORB's do, what lies straight ahead in
    its middle. Raises InputError for a scene with media."""
    scene, depth, hidden = result
    shapes = scene.shapes()
    grouped = (each for each in mi.traverse(scene).hierarchy if isinstance(each, mi.Shape))
    if any(shape.is_medium_transition() for shape in (*shapes, *grouped)):
        raise InputError("the scene has a medium: isas relight renders surfaces alone")
    middle, sides = (np.array(x).ravel() for x in (scene.bbox().center(), scene.bbox().extents()))
    extent = float(np.linalg.norm(sides))
    last, lit = object(), {}
    for number, (camera, light) in enumerate(zip(cameras, lights)):
        if light != last or up == CAMERA:
            world = building.facing(camera) if up == CAMERA else building.upright(up, turn)
            last, lit = light, _lit(scene, shapes, light, world)
            if light is None:
                # Lamps are in pictures as the run's; a sky behind the object is left out of all.
                hides = hidden or not any(shape.is_emitter() for shape in shapes)
                lit["integrator"] |= {"max_depth": depth, "hide_emitters": hides}
        with backend.loading():
            seen = {"camera": building.sensor(camera, middle, extent)}
            made = mi.load_dict(lit | seen, optimize=False)
        yield _rendered(made, spp, number)


def _lit(scene: mi.Scene, shapes: list, light: Path | None, world) -> dict:
    """All but the camera, as ``mitsuba.load_dict`` takes it; ``world``: what ``light`` is turned
    by."""
    kept = [shape for shape in shapes if light is None or not shape.is_emitter()]
    if light is None:
        # Those of surfaces come with these.
        surface = mi.EmitterFlags.Surface
        emitters = [each for each in scene.emitters() if not mi.has_flag(each.flags(), surface)]
    else:
        with backend.loading():
            emitters = [mi.load_dict(building.light(light, world))]
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": _DEPTH, "hide_emitters": True},
        **{f"light_{number}": each for number, each in enumerate(emitters)},
        **{f"shape_{number}": each for number, each in enumerate(kept)},
    }


def _rendered(scene: mi.Scene, spp: int, seed: int) -> tuple[np.ndarray, int]:
    film = scene.sensors()[0].film().size()
    most = max(1, min(_AT_ONCE // int(film[0] * film[1]), -(-spp // _PARTS)))
    total, known, done = 0.0, 0, 0
    while done < spp:
        count = min(most, spp - done)
        image = np.array(mi.render(scene, spp=count, seed=(seed << 16) + done), np.float64)
        finite = np.isfinite(image).all(axis=2, keepdims=True)
        total, known = total + np.where(finite, image, 0) * count, known + finite * count
        done += count
    mean = np.where(known > 0, total / np.maximum(known, 1), np.nan)
    return mean.astype(np.float32), int(np.count_nonzero(known < spp))


def cut(camera: Camera, width: int | None) -> Camera:
    """The camera that renders: without a lens, of pictures ``width`` pixels wide."""
    return camera if width is None and camera.ideal else camera.pinhole(width)


def write(folder: Path, name: str, image: np.ndarray) -> None:
    """Put the rendering of a view into ``folder``, as EXR. Raises InputError."""
    # A view may be called by a whole path, and by a name without an ending that has a dot.
    parts = [part for part in Path(name).parts if part not in ("..", Path(name).anchor)]
    path = folder.joinpath(*parts)
    plain = path.with_suffix("") if path.suffix.lower() in finding.PICTURES else path
    path = plain.with_name(f"{plain.name}.exr")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path.parent}: cannot be written: {error.strerror}") from error
    images.write_exr(path, image, [*"RGB"], {"what": "relit"})
