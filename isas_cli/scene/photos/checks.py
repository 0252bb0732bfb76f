"""What can be told of photographs and their object before anything is rendered."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...scenes.meshes import Surface
from . import corners
from .camera import Camera
from .importing import Photograph
from .outlines import scattered
from .photographs import Photographs

# Of points of the surface, the share that a view should see at least; and of a picture's area, what
# they should span.
SEEN, SPANNED = 0.1, 0.01
OFF = 2  # pixels that a known point may lie off


@dataclass
class View:
    """``inside``: share of the object's surface within the picture and before the camera, whatever
    hides it; ``before``: before the camera; ``spanned``: of the picture, by the box around those
    inside; ``distance``: from the object's middle, scene units (all None without an object);
    ``points``: numbers of known points that were found and where, in the resampled picture;
    ``apart``: root mean square distance of these from where the camera sees them, pixels."""

    photograph: Photograph
    held: bool
    inside: float | None = None
    before: float | None = None
    spanned: float | None = None
    distance: float | None = None
    points: tuple[np.ndarray, np.ndarray] | None = None
    apart: float | None = None


def views(photographs: Photographs) -> list[View]:
    """One each, in order."""
    described = {camera.name: camera for camera in photographs.capture.cameras}
    points = None if photographs.surface is None else scattered(photographs.surface)
    result = []
    for number, each in enumerate(photographs.all):
        view = View(each, number >= len(photographs.shown))
        if points is not None:
            _place(view, each.camera, points)
        _reproject(view, described[each.camera.name], photographs)
        result.append(view)
    return result


def _place(view: View, camera: Camera, points: np.ndarray) -> None:
    pixels, depth, within = camera.seen(points)
    view.before, view.inside = float((depth > 0).mean()), float(within.mean())
    box = np.ptp(pixels[within], axis=0) if within.any() else np.zeros(2)
    view.spanned = float(box.prod() / (camera.width * camera.height))
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    view.distance = float(np.linalg.norm(camera.centre - middle))


def _reproject(view: View, described: Camera, photographs: Photographs) -> None:
    """``described``: the camera as its file has it."""
    points, shown = photographs.capture.points, view.photograph.camera
    if points is None:
        return
    observed = photographs.capture.observed.get(described.name)
    expected, depth = shown.project(points)
    if observed is None:
        if photographs.capture.plane is None or not (depth > 0).all():
            return
        observed = corners.found(view.photograph.image.mean(axis=2), expected)
        apart = observed[1] - expected[observed[0]]
    else:
        # Where they were found lies behind the lens, as the photograph does.
        seen, _ = described.project(points[observed[0]])
        apart = observed[1] - seen
        scale = np.array([shown.fx / described.fx, shown.fy / described.fy])
        observed = observed[0], expected[observed[0]] + apart * scale
    if len(observed[0]):
        view.points = observed
        view.apart = float(np.sqrt((apart**2).sum(axis=1).mean()))


def warnings(checked: list[View], photographs: Photographs) -> list[str]:
    """What is probably wrong."""
    found = list(photographs.warnings)
    if len(checked) == 1:
        found.append("one view only: what it does not see, and light against colour, stay open")
    worst = [v for v in checked if v.apart is not None and v.apart > OFF]
    if worst:
        name = max(worst, key=lambda v: v.apart).photograph.camera.name
        found.append(
            f"known points lie more than {OFF} pixels off in {len(worst)} views, most in {name}"
        )
    if photographs.surface is None:
        return [*found, "no object is given: photos.mesh=FILE shows how it lies in the pictures"]
    many = len(checked) / 2
    behind = [v for v in checked if v.before < 0.5]
    outside = [v for v in checked if v.before >= 0.5 and v.inside < SEEN]
    tiny = [v for v in checked if v.inside >= SEEN and v.spanned < SPANNED]
    around = [v.photograph.camera.name for v in checked if _encloses(photographs.surface, v)]
    if len(behind) > many and len(around) <= many:
        found.append(
            f"the object lies behind {len(behind)} of {len(checked)} cameras: they look the other "
            "way; the axes of their file are other than its format's"
        )
    if len(outside) > many:
        found.append(
            f"the object lies outside the picture of {len(outside)} of {len(checked)} views: mesh "
            "and cameras have other axes, another scale or another origin"
        )
    if len(tiny) > many:
        found.append(
            f"the object fills less than {SPANNED:.0%} of {len(tiny)} of {len(checked)} views: "
            "its scale is probably not the cameras'"
        )
    if around:
        scale = ": its scale is probably not the cameras'" if len(around) > many else ""
        found.append(
            f"{len(around)} cameras stand inside the mesh, first that of {around[0]}{scale}"
        )
    return found


def _encloses(surface: Surface, view: View) -> bool:
    """Whether a closed mesh goes around the camera: the angles that its triangles span, seen from
    there, add up to 4π (van Oosterom & Strackee 1983)."""
    place = view.photograph.camera.centre
    vertices = surface.vertices.astype(np.float64)
    if (place < vertices.min(axis=0)).any() or (place > vertices.max(axis=0)).any():
        return False
    a, b, c = (vertices[surface.faces[:, corner]] - place for corner in range(3))
    la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
    above = np.einsum("fk,fk->f", a, np.cross(b, c))
    dots = [np.einsum("fk,fk->f", x, y) for x, y in ((a, b), (a, c), (b, c))]
    below = la * lb * lc + dots[0] * lc + dots[1] * lb + dots[2] * la
    return bool(abs(np.arctan2(above, below).sum() * 2) > 2 * np.pi)
