"""The visual hull: the largest object that no mask contradicts, where there is no mesh."""

from __future__ import annotations

import hashlib

import numpy as np
from scipy.ndimage import distance_transform_edt, label, map_coordinates
from scipy.optimize import linprog

from ...runtime.cache import cached, digest
from ...runtime.errors import InputError
from . import outlines
from .importing import Photograph

# Raised when what is kept means something else.
_FORMAT = 5
# Voxels around the hull that are outside, and how far from the surface distances matter, in voxels.
_MARGIN, _BAND = 2, 3.0
# Of the largest piece's volume: smaller ones are specks of masks.
_SPECK = 0.01
# Between two charts, a share of the texture's side; and how unlike a plane a chart may be (2 makes
# 115 of a box of 14,620 triangles, 4 makes 7).
_GAP, _COST = 1 / 128, 4.0
_SMOOTHED = 10  # passes
_LARGE = 512  # pixels: finer pictures say no more to a grid
# Whether one view contradicts the others is asked where there are so many, by a grid of so many
# points over twice the hull's size: it does where it alone takes away so much, as a share of what
# is left, and so many times what any other takes.
_SEVERAL, _COARSE, _ALONE, _TIMES = 5, 48, 0.2, 4.0


def made(photographs: list[Photograph], voxels: int) -> tuple[dict[str, np.ndarray], list[str]]:
    """``vertices (V, 3)``, ``faces (F, 3)`` and ``texcoords (V, 2)`` of the hull, closed but for
    the seams of its texture coordinates; and what should be said of it.

    ``photographs``: with ``part``. ``voxels``: of the grid on which it is cut out, along the hull's
    longest side. Raises InputError where the views do not enclose the object, and where nothing
    lies within all outlines.
    """
    key = digest("hull", _FORMAT, voxels, *map(_hashed, photographs))
    found = cached(f"hull-{key}", lambda: _made(photographs, voxels))
    dropped, (odd, share) = int(found.pop("dropped")), found.pop("odd")
    told = []
    if odd >= 0:
        told.append(
            f"photos.start=hull: {photographs[int(odd)].camera.name} alone takes away {share:.0%} "
            "of what all other views leave of the object: its pose, mask or picture is probably "
            "wrong; mend it, or leave the view out"
        )
    if dropped:
        told.append(f"photos.start=hull: {dropped} small pieces of the hull are left out")
    return found, told


def _hashed(photograph: Photograph) -> list:
    camera = photograph.camera
    numbers = [camera.fx, camera.fy, camera.cx, camera.cy, *camera.to_world.ravel().tolist()]
    part = np.ascontiguousarray(photograph.part)
    return [numbers, hashlib.blake2b(part.tobytes(), digest_size=16).hexdigest(), part.shape]


def _made(photographs: list[Photograph], voxels: int) -> dict[str, np.ndarray]:
    from skimage.measure import marching_cubes

    low, high = bounds(photographs)
    size = float((high - low).max()) / voxels
    counts = np.ceil((high - low) / size).astype(int) + 2 * _MARGIN
    origin = (low + high) / 2 - size * (counts - 1) / 2
    field = _distances(photographs, origin, size, counts)
    for axis in range(3):  # closed where the grid ends
        for end in (0, -1):
            np.moveaxis(field, axis, 0)[end] = -_BAND * size
    field, dropped = _cleaned(field, size, photographs)
    vertices, faces, _, _ = marching_cubes(field, 0.0, allow_degenerate=False)
    vertices = origin + size * _evened(vertices, faces)
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    if np.einsum("fk,fk->", np.cross(b, c), a - vertices.mean(axis=0)) < 0:
        faces = faces[:, ::-1]
    odd = np.array(_contradicting(photographs, low, high))
    return {"dropped": np.array(dropped), "odd": odd, **_unwrapped(vertices, faces)}


def _contradicting(
    photographs: list[Photograph], low: np.ndarray, high: np.ndarray
) -> tuple[float, float]:
    """The number of the view that contradicts all others, or -1, and the share that it alone takes
    away of what they leave, in and around a box."""
    if len(photographs) < _SEVERAL:
        return -1.0, 0.0
    side = np.linspace(-1, 1, _COARSE)
    cube = np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1).reshape(-1, 3)
    points = (low + high) / 2 + cube * (high - low)
    outside, by = np.zeros(len(points), int), np.zeros(len(points), int)
    for number, each in enumerate(photographs):
        cut = _within(each, points, 1.0) < 0
        outside += cut
        by[cut] = number
    alone = np.bincount(by[outside == 1], minlength=len(photographs))
    left = np.count_nonzero(outside == 0)
    *_, other, most = np.sort(alone)
    if not left or most < max(_ALONE * (left + most), _TIMES * other):
        return -1.0, 0.0
    return float(alone.argmax()), most / (left + most)


def _evened(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Without the slivers that a grid leaves, which fold as soon as they move: Taubin's smoothing
    (1995), which shrinks nothing."""
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    return np.asarray(trimesh.smoothing.filter_taubin(mesh, iterations=_SMOOTHED).vertices)


def bounds(photographs: list[Photograph]) -> tuple[np.ndarray, np.ndarray]:
    """The box, ``(3,)`` each, around what lies within the rectangle around the object in every view
    and before every camera. Raises InputError."""
    rows, limits = [], []
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
            known = np.flatnonzero((each.part >= 0).any(axis=1 - axis))
            if seen[0] > known[0]:
                planes.append(of - (seen[0] - middle) / focal * depth)
            if seen[-1] < known[-1]:
                planes.append((seen[-1] + 1 - middle) / focal * depth - of)
        rows += [-plane[:3] for plane in planes]
        limits += [plane[3] for plane in planes]
    # In lengths of the cameras' own, around their middle: the solver's tolerances are absolute.
    places = np.array([each.camera.centre for each in photographs])
    origin = places.mean(axis=0)
    unit = float(np.abs(places - origin).max()) or 1.0
    planes, most = np.array(rows), (np.array(limits) - np.array(rows) @ origin) / unit
    found = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            goal = np.zeros(3)
            goal[axis] = sign
            solved = linprog(goal, A_ub=planes, b_ub=most, bounds=(None, None))
            if solved.status == 2:
                raise InputError(
                    "photos.start=hull: no place lies within the object's outline in every view: "
                    f"{_unfit(photographs)}"
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


def _distances(
    photographs: list[Photograph], origin: np.ndarray, size: float, counts: np.ndarray
) -> np.ndarray:
    """About how deep each point of a grid lies inside all outlines, in scene units, at most
    ``_BAND`` voxels; negative outside one."""
    axes = [origin[axis] + size * np.arange(counts[axis]) for axis in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    band = _BAND * size
    found = np.full(len(points), band)
    for each in photographs:
        # What is far outside one outline stays outside.
        left = np.flatnonzero(found > -band)
        found[left] = np.minimum(found[left], _within(each, points[left], band))
    return found.reshape(counts)


def _within(photograph: Photograph, points: np.ndarray, band: float) -> np.ndarray:
    """How deep points lie inside one outline, in scene units, within ``band``; ``band`` where the
    view says nothing."""
    camera = photograph.camera
    deep, by = _signed(photograph.part)
    place, depth = camera.project(points)
    known = (depth > 0) & (place >= 0).all(axis=1)
    known &= (place < [camera.width, camera.height]).all(axis=1)
    at = place[known][:, ::-1].T / by - 0.5
    seen = map_coordinates(deep, at, order=1, mode="nearest")
    found = np.full(len(points), band)
    found[known] = np.clip(seen * by * depth[known] / camera.fx, -band, band)
    return found


def _signed(part: np.ndarray) -> tuple[np.ndarray, int]:
    """Of each pixel's middle, how many pixels it lies inside the outline, negative outside; of
    pixels that the object fills in part, by how much it fills them. Unknown ones are inside. Of
    large pictures made smaller, and by what."""
    filled = np.where(part < 0, 1.0, part)
    by = max(1, max(part.shape) // _LARGE)
    if by > 1:
        height, width = (n // by for n in part.shape)
        blocks = filled[: height * by, : width * by].reshape(height, by, width, by)
        filled = blocks.mean(axis=(1, 3))
    inside = filled >= 0.5
    if inside.all():
        return np.full(filled.shape, float(max(filled.shape))), by
    deep = distance_transform_edt(inside) - distance_transform_edt(~inside)
    deep -= np.sign(deep) * 0.5
    between = (filled > 0) & (filled < 1) & (np.abs(deep) < 1)
    return np.where(between, filled - 0.5, deep), by


def _unfit(photographs: list[Photograph]) -> str:
    """Why outlines do not fit each other."""
    dark = [each for each in photographs if each.white is not None and each.white < outlines.DARK]
    if dark:
        return (
            f"{dark[0].camera.mask} holds several values, none above {dark[0].white:.2g} of white, "
            "as labels are: save the object as white and all else as black"
        )
    return "poses do not fit the pictures, or masks are inverted (white is the object)"


def _cleaned(
    field: np.ndarray, size: float, photographs: list[Photograph]
) -> tuple[np.ndarray, int]:
    """Without pieces that are specks, and how many these were. Raises InputError where nothing is
    left inside."""
    pieces, count = label(field > 0)
    if not count:
        raise InputError(
            "photos.start=hull: nothing lies within the object's outline in every view: "
            f"{_unfit(photographs)}"
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
