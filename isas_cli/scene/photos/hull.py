"""The visual hull: the largest object that no mask contradicts, where there is no mesh."""

from __future__ import annotations

import hashlib
from dataclasses import fields

import numpy as np
from scipy.ndimage import label
from scipy.optimize import linprog

from ...config import grammar
from ...runtime import memory
from ...runtime.cache import cached, digest
from ...runtime.errors import InputError
from ..shape_error import enclosed
from . import coherence, outlines
from .importing import Photograph

# Raised when what is kept means something else.
_FORMAT = 10
# Voxels around the hull that are outside, and how far from the surface distances matter, in voxels.
_MARGIN, _BAND = 2, 3.0
# Of the largest piece's volume: smaller ones are specks of masks.
_SPECK = 0.01
# Between two charts, a share of the texture's side; and how unlike a plane a chart may be (2 makes
# 115 of a box of 14,620 triangles, 4 makes 7).
_GAP, _COST = 1 / 128, 4.0
_SMOOTHED = 10  # passes
_ONE_SIDE = 60.0  # degrees between views, below which the hull is a wedge


def made(photographs: list[Photograph], voxels: int) -> tuple[dict[str, np.ndarray], list[str]]:
    """``vertices (V, 3)``, ``faces (F, 3)`` and ``texcoords (V, 2)`` of the hull, closed but for
    the seams of its texture coordinates; and what should be said of it.

    ``photographs``: with ``part``. ``voxels``: of the grid on which it is cut out, along the hull's
    longest side. Raises InputError where the views do not enclose the object, and where nothing
    lies within all outlines, and for masks that are inverted.
    """
    _check_sides(photographs)
    key = digest("hull", _FORMAT, voxels, *map(_hashed, photographs))
    found = cached(f"hull-{key}", lambda: _made(photographs, voxels))
    fit = coherence.Coherence(*(found.pop(each.name) for each in fields(coherence.Coherence)))
    told = fit.told([each.camera.name for each in photographs])
    if dropped := int(found.pop("dropped")):
        told.append(f"photos.start=hull: {dropped} small pieces of the hull are left out")
    if (angle := _angle(photographs)) < _ONE_SIDE:
        told.append(
            f"photos.start=hull: all views look from one side, within {angle:.0f} degrees: how "
            "deep the object is they do not tell; take views from more sides, or give photos.mesh"
        )
    return found, told


def _check_sides(photographs: list[Photograph]) -> None:
    """Raises InputError where masks of most views fill the border of their pictures and leave out
    the middle."""
    over = [each.camera for each in photographs if outlines.inverted(each.part)]
    if len(over) > len(photographs) / 2:
        raise InputError(
            f"photos.start=hull: in {len(over)} of {len(photographs)} pictures, first "
            f"{over[0].name}, the object is all around, by alpha or masks, and not in the middle: "
            "masks are inverted; save the object as white and all else as black, or, if they say "
            "what does not count, give photos.mesh"
        )


def _angle(photographs: list[Photograph]) -> float:
    """Between the two views that look in the most unlike directions, degrees."""
    ways = np.array([each.camera.to_world[:3, 2] for each in photographs])
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    return float(np.degrees(np.arccos(np.clip(ways @ ways.T, -1, 1).min())))


def _hashed(photograph: Photograph) -> list:
    camera = photograph.camera
    numbers = [camera.fx, camera.fy, camera.cx, camera.cy, *camera.to_world.ravel().tolist()]
    part = np.ascontiguousarray(photograph.part)
    return [numbers, hashlib.blake2b(part.tobytes(), digest_size=16).hexdigest(), part.shape]


def _made(photographs: list[Photograph], voxels: int) -> dict[str, np.ndarray]:
    from skimage.measure import marching_cubes

    low, high = bounds(photographs)
    fit = coherence.found(photographs, low, high)
    size = float((high - low).max()) / voxels
    counts = np.ceil((high - low) / size).astype(int) + 2 * _MARGIN
    origin = (low + high) / 2 - size * (counts - 1) / 2
    field = _distances(photographs, origin, size, counts)
    for axis in range(3):  # closed where the grid ends
        for end in (0, -1):
            np.moveaxis(field, axis, 0)[end] = -_BAND * size
    field, dropped = _cleaned(field, size, photographs, fit)
    vertices, faces, _, _ = marching_cubes(field, 0.0, allow_degenerate=False)
    vertices = origin + size * _evened(vertices, faces)
    if enclosed(vertices[faces]) < 0:
        faces = faces[:, ::-1]
    return {"dropped": np.array(dropped), **vars(fit), **_unwrapped(vertices, faces)}


def _evened(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Without the slivers that a grid leaves, which fold as soon as they move: Taubin's smoothing
    (1995), which shrinks nothing."""
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    return np.asarray(trimesh.smoothing.filter_taubin(mesh, iterations=_SMOOTHED).vertices)


def bounds(photographs: list[Photograph]) -> tuple[np.ndarray, np.ndarray]:
    """The box, ``(3,)`` each, around what lies within the rectangle around the object in every view
    and before every camera. Raises InputError."""
    planes = _planes(photographs)
    # In lengths of the cameras' own, around their middle: the solver's tolerances are absolute.
    places = np.array([each.camera.centre for each in photographs])
    origin = places.mean(axis=0)
    unit = float(np.abs(places - origin).max()) or 1.0
    rows, most = _within(planes, origin, unit)
    found = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            goal = np.zeros(3)
            goal[axis] = sign
            solved = linprog(goal, A_ub=rows, b_ub=most, bounds=(None, None))
            if solved.status == 2:
                raise InputError(
                    "photos.start=hull: no place lies within the object's outline in every view: "
                    f"{_unfit(photographs, _alone(planes, origin, unit))}"
                )
            if all((each.part[each.part >= 0] > 0.5).all() for each in photographs):
                raise InputError(
                    "photos.start=hull: by alpha the object fills all of every picture, so nothing "
                    "says where it ends: save masks of the pictures' names in masks/, or give "
                    "photos.mesh"
                )
            if solved.status != 0:
                raise InputError(
                    "photos.start=hull: the views do not enclose the object: take views from more "
                    "sides that show all of it, or give photos.mesh"
                )
            found.append(origin[axis] + unit * sign * solved.fun)
    return np.array(found[::2]), np.array(found[1::2])


def _within(
    planes: list[np.ndarray], origin: np.ndarray, unit: float
) -> tuple[np.ndarray, np.ndarray]:
    """Half spaces ``rows (N, 3) @ x <= limits (N,)`` of some views, in ``unit``s around
    ``origin``."""
    found = np.concatenate(planes)
    rows, limits = -found[:, :3], found[:, 3]
    return rows, (limits - rows @ origin) / unit


def _planes(photographs: list[Photograph]) -> list[np.ndarray]:
    """Of each view those, ``(n, 4)``, on whose one side lies what is before its camera, and within
    the rectangle around the object in it."""
    found = []
    for each in photographs:
        camera, inside = each.camera, each.part > 0.5
        inverse = np.linalg.inv(camera.to_world)
        x, y, depth = inverse[0], inverse[1], inverse[2]
        planes = [depth]
        for axis, of, focal, middle in ((1, x, camera.fx, camera.cx), (0, y, camera.fy, camera.cy)):
            seen = np.flatnonzero(inside.any(axis=1 - axis))
            if not seen.size:
                continue
            # Where it is cut off by the border of what is known nothing is known of it.
            known = each.part >= 0
            lines = (inside, known) if axis else (inside.T, known.T)
            if not _reaches(*lines):
                planes.append(of - (seen[0] - middle) / focal * depth)
            if not _reaches(*(line[:, ::-1] for line in lines)):
                planes.append((seen[-1] + 1 - middle) / focal * depth - of)
        found.append(np.array(planes))
    return found


def _reaches(inside: np.ndarray, known: np.ndarray) -> bool:
    """Whether in some row the first of what is known is the object's."""
    return bool((inside.any(axis=1) & (inside.argmax(axis=1) <= known.argmax(axis=1))).any())


def _alone(planes: list[np.ndarray], origin: np.ndarray, unit: float) -> list[int]:
    """The view without which something lies within the rectangles of all others, if it is one."""
    found = []
    for odd in range(len(planes)):
        rows, most = _within(planes[:odd] + planes[odd + 1 :], origin, unit)
        if linprog(np.zeros(3), A_ub=rows, b_ub=most, bounds=(None, None)).status == 0:
            found.append(odd)
    return found if len(found) == 1 else []


def _distances(
    photographs: list[Photograph], origin: np.ndarray, size: float, counts: np.ndarray
) -> np.ndarray:
    """About how deep each point of a grid lies inside all outlines, in scene units, at most
    ``_BAND`` voxels; negative outside one."""
    band = _BAND * size
    found = np.full(int(np.prod(counts)), band)
    for each in photographs:
        depths = outlines.signed(each.part)
        for part in memory.parts(len(found)):
            # What is far outside one outline stays outside.
            left = part.start + np.flatnonzero(found[part] > -band)
            points = origin + size * np.stack(np.unravel_index(left, counts), axis=1)
            deep = outlines.within(each, points, band, depths)
            found[left] = np.minimum(found[left], deep)
    return found.reshape(counts)


def _unfit(photographs: list[Photograph], odd: list[int]) -> str:
    """Why outlines do not fit each other. ``odd``: views that contradict all others."""
    dark = [each for each in photographs if each.white is not None and each.white < outlines.DARK]
    if dark:
        return (
            f"{dark[0].camera.mask} holds several values, as labels are, and "
            f"{outlines.labelled(dark[0])}: save the object as white and all else as black"
        )
    if odd:
        names = [photographs[view].camera.name for view in odd]
        return (
            f"{' and '.join(names)} contradicts the others: its pose, mask or picture is probably "
            f"wrong; mend it, or {grammar.listed('photos.without', names)}"
        )
    return "poses do not fit the pictures, or masks are inverted (white is the object)"


def _cleaned(
    field: np.ndarray, size: float, photographs: list[Photograph], fit: coherence.Coherence
) -> tuple[np.ndarray, int]:
    """Without pieces that are specks, and how many these were. Raises InputError where nothing is
    left inside."""
    pieces, count = label(field > 0)
    if not count:
        raise InputError(
            "photos.start=hull: nothing lies within the object's outline in every view: "
            f"{_unfit(photographs, fit.odd.tolist())}"
        )
    volumes = np.bincount(pieces.ravel())[1:]
    specks = np.flatnonzero(volumes < _SPECK * volumes.max()) + 1
    return np.where(np.isin(pieces, specks), -0.5 * size, field), len(specks)


def _unwrapped(vertices: np.ndarray, faces: np.ndarray) -> dict[str, np.ndarray]:
    """With texture coordinates in charts, as ``Surface`` counts them; vertices of seams repeat."""
    import xatlas

    # Of size 1 at the origin: areas of small triangles are nothing to it, and no charts are made.
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    sized = (vertices - low) / (high - low).max()
    atlas = xatlas.Atlas()
    atlas.add_mesh(sized.astype(np.float32), np.ascontiguousarray(faces, np.uint32))
    packing = xatlas.PackOptions()
    packing.resolution = round(1 / _GAP)
    packing.padding = 1
    packing.bilinear = packing.bruteForce = True
    charts = xatlas.ChartOptions()
    charts.max_cost = _COST
    atlas.generate(charts, packing)
    which, faces, texcoords = atlas[0]
    return {
        "vertices": vertices[which].astype(np.float32),
        "faces": faces.astype(np.uint32),
        "texcoords": np.clip(texcoords, 0, 1).astype(np.float32),
    }
