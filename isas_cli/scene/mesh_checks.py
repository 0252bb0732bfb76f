"""Meshes as they were loaded: what cannot be rendered, and what makes a texture ambiguous.

A renderer takes broken meshes in silence: a vertex that is no number shows only as a hole or as
NaN pixels, which then poison the optimiser. Where parts of a surface share texels, a texture found
from images is a compromise between them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..runtime.errors import InputError

if TYPE_CHECKING:
    import mitsuba as mi

# A triangle is degenerate when its area is below this fraction of the squared diagonal of the
# bounding box: the rounding of float32 positions alone gives areas of this order.
SMALLEST_AREA = 1e-12
_BARE = ("SDFGrid",)  # shapes of Mitsuba's without texture coordinates
# Repeats of an unknown texture beyond this count are taken for damage, not for tiling; of others,
# and before to_uv, coordinates may be in metres, up to where float32 tells no fraction of a texel.
LARGEST_TEXCOORD, LARGEST_UNUSED = 1000.0, 1e6
# Of an OBJ file that has coordinates for only some faces, Mitsuba leaves the others' as they lie in
# memory.
_PARTLY = "unwrap the mesh, all of its faces, and export it anew"
# How far vertices' normals lie from the mean of the triangles' where Mitsuba has made them of it.
# Rounding may turn them where less is left in that mean, or where a triangle is thinner (its height
# over its longest edge).
_MADE, _CANCELLED, _THIN = 1e-3, 0.01, 1e-3
# Share of the used texels that belong to several places, from which on a reader should know.
LARGEST_OVERLAP = 0.01
# Overlap is counted on a grid of this many points a side, whatever size a texture has,
_GRID = 512
# or on a coarser one for charts that tile so often that there were more rows of points than this.
_MOST_SPANS = 1 << 24
_SPANS_AT_ONCE = 1 << 22


def check(vertices: np.ndarray, texcoords: np.ndarray, faces: np.ndarray, name: str) -> None:
    """Raise InputError, naming the first offender, for an asset that is not sound in all respects.

    ``vertices (V, 3)``, ``texcoords (V, 2)``, ``faces (F, 3)``.
    """
    check_values(vertices, texcoords, faces, name)
    flat = degenerate(vertices, faces)
    if flat.size:
        raise InputError(
            f"mesh {name}: triangle {flat[0]} has no area "
            f"({flat.size} of {len(faces)} are degenerate)"
        )


def check_values(
    vertices: np.ndarray,
    texcoords: np.ndarray,
    faces: np.ndarray,
    name: str,
    largest_texcoord: float = LARGEST_TEXCOORD,
) -> None:
    """Raise InputError, naming the first offender, for a mesh that cannot be rendered.

    ``texcoords``: ``(0, 2)`` for a mesh without; ``largest_texcoord``: what they may be.
    """
    if not faces.size:
        raise InputError(f"mesh {name} has no triangles")
    check_indices(faces, len(vertices), f"mesh {name}")
    for what, values, largest, hint in (
        ("position", vertices, np.inf, "export the mesh anew"),
        ("texture coordinate", texcoords, largest_texcoord, _PARTLY),
    ):
        bad = np.flatnonzero(~(np.isfinite(values) & (np.abs(values) <= largest)).all(axis=1))
        if bad.size:
            value = values[bad[0]]
            wrong = "not finite" if not np.isfinite(value).all() else f"beyond ±{largest:g}"
            raise InputError(
                f"mesh {name}: the {what} of vertex {bad[0]} is {wrong}: {value.tolist()} "
                f"({bad.size} of {len(values)} are such): {hint}"
            )


def check_indices(faces: np.ndarray, count: int, where: str) -> None:
    """Raise InputError, which begins with ``where``, where a triangle of ``faces (F, 3)`` names
    none of ``count`` vertices."""
    beyond = np.flatnonzero(((faces < 0) | (faces >= count)).any(axis=1))
    if beyond.size:
        bad = faces[beyond[0]]
        bad = bad[(bad < 0) | (bad >= count)][0]
        raise InputError(
            f"{where}: triangle {beyond[0]} has the vertex {bad}, and there are {count} vertices: "
            "export the mesh anew"
        )


def degenerate(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Indices of the triangles without area."""
    diagonal = np.ptp(vertices, axis=0).astype(np.float64)
    a, b, c = (vertices[faces[:, corner]].astype(np.float64) for corner in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    return np.flatnonzero(areas <= SMALLEST_AREA * (diagonal @ diagonal))


def made_normals(vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray) -> int:
    """Whether a mesh has the normals that Mitsuba makes where a file has none, each the mean of the
    triangles' around by their angles there: 1 where it has, -1 where they are turned round, 0 where
    it has others, or rounding hides it. ``vertices``, ``normals (V, 3)``; ``faces (F, 3)``."""
    if normals.shape != vertices.shape or not faces.size or faces.max() >= len(vertices):
        return 0
    sums, angles = np.zeros((3, len(vertices))), np.zeros(len(vertices))
    sure = np.ones(len(vertices), bool)
    with np.errstate(all="ignore"):  # of vertices that are no numbers
        corners = vertices.astype(np.float64)[faces]
        edges = np.roll(corners, -1, axis=1) - corners
        across = np.cross(edges[:, 0], edges[:, 1])
        area, lengths = np.linalg.norm(across, axis=1), np.linalg.norm(edges, axis=2)
        sure[faces[area <= _THIN * lengths.max(axis=1) ** 2]] = False
        unit = across / np.maximum(area, 1e-300)[:, None]
        for k in range(3):
            cosine = -np.einsum("fk,fk->f", edges[:, k], edges[:, k - 1])
            cosine /= np.maximum(lengths[:, k] * lengths[:, k - 1], 1e-300)
            angle = np.arccos(np.clip(cosine, -1, 1))
            added = [np.bincount(faces[:, k], x, len(vertices)) for x in (angle, *angle * unit.T)]
            angles, sums = angles + added[0], sums + added[1:]
        left = np.linalg.norm(sums, axis=0)
        sure &= left > _CANCELLED * angles
        mean, given = (sums[:, sure] / left[sure]).T, normals[sure]
        for turn in (1, -1) if sure.any() else ():
            if (np.abs(given - turn * mean) < _MADE).all():
                return turn
    return 0


def check_scene(scene: mi.Scene, textures: dict[str, mi.Texture]) -> list[str]:
    """Warnings about the meshes of a loaded scene, the user's as well as a builder's.

    ``textures``: key of an unknown → the texture whose texels it is. Raises InputError, naming
    mesh and first offender, for a mesh that cannot be rendered or lacks the coordinates that an
    unknown texture needs. Triangles without area are common in files, and harmless: no ray meets
    them.
    """
    import mitsuba as mi

    warnings, charts, places = [], {key: {} for key in textures}, {}
    every = scene.shapes()
    if any(shape.class_name() == "Instance" for shape in every):
        # With those of groups, which are no shapes of the scene.
        every = [each for each in mi.traverse(scene).hierarchy if isinstance(each, mi.Shape)]
    for shape in every:
        values = mi.traverse(shape)
        name = shape.id()
        if shape.class_name() == "SDFGrid" and _askew(values["to_world"]):
            warnings.append(
                f"shape {name}: Mitsuba shows a turned sdfgrid with holes: put it into a "
                "shapegroup as it is, and turn an instance of that"
            )
        if "vertex_positions" not in values:
            # A sphere, a rectangle, …: made by Mitsuba. Of a group's, others hold it.
            painted = _textures_of(values, textures) if shape.class_name() in _BARE else ()
            for key, _ in painted:
                raise InputError(
                    f"shape {name}: has no texture coordinates, which '{key}' needs: make a mesh "
                    "of it and unwrap that"
                )
            continue
        vertices, faces = (
            np.array(values[key]).reshape(-1, 3) for key in ("vertex_positions", "faces")
        )
        texcoords = np.zeros((0, 2), np.float32)
        if shape.has_vertex_texcoords():
            texcoords = np.array(values["vertex_texcoords"]).reshape(-1, 2)
        check_values(vertices, texcoords, faces, name, LARGEST_UNUSED)
        flat = degenerate(vertices, faces)
        if flat.size:
            warnings.append(
                f"mesh {name}: {flat.size} of {len(faces)} triangles have no area, the first is "
                f"triangle {flat[0]}: no view can show them"
            )
        for key, place in _textures_of(values, textures):
            if not len(texcoords):
                raise InputError(
                    f"mesh {name} has no texture coordinates, which '{key}' needs: unwrap it "
                    "before it is exported"
                )
            matrix = np.array(values[f"{place}.to_uv"].matrix, np.float64)
            placed = texcoords @ matrix[:2, :2].T + matrix[:2, 2]
            check_values(vertices, placed, faces, name)
            charts[key][name] = placed[faces]
            places[name] = vertices, faces
    return warnings + [text for keys, own in _alike(charts) for text in _shared(own, places, keys)]


def _askew(place: mi.Transform4f) -> bool:
    """Whether an axis of its own is none of the world's."""
    turn = np.abs(np.array(place.matrix, np.float64).reshape(4, 4)[:3, :3])
    return bool((np.count_nonzero(turn > 1e-5 * turn.max(), axis=1) > 1).any())


def _alike(charts: dict[str, dict]) -> list[tuple[list[str], dict[str, np.ndarray]]]:
    """Keys whose textures lie on the same meshes in the same way, and how."""
    found: dict[tuple, tuple[list[str], dict]] = {}
    for key, own in charts.items():
        same = tuple((name, corners.tobytes()) for name, corners in own.items())
        found.setdefault(same, ([], own))[0].append(key)
    return list(found.values())


def _textures_of(values: mi.SceneParameters, textures: dict) -> list[tuple[str, str]]:
    """Which of ``textures`` a shape's materials and lights hold, however deep: (key, prefix of its
    parameters among ``values``)."""
    return [
        (key, own.removesuffix(".data"))
        for key, texture in textures.items()
        for own in values.keys()
        if own.endswith(".data") and values.properties[own][2] is texture
    ]


def _shared(charts: dict[str, np.ndarray], places: dict[str, tuple], keys: list[str]) -> list[str]:
    """A warning where places of the surface share texels of the unknowns ``keys``. ``charts``: mesh
    → ``(F, 3, 2)``; ``places``: → its vertices and faces."""
    if not charts:
        return []
    corners = np.concatenate(list(charts.values()))
    mesh, it = ("mesh", "it uses") if len(charts) == 1 else ("meshes", "they use")
    told = ", ".join(f"'{key}'" for key in keys) + (" is" if len(keys) == 1 else " are")
    if np.abs(_areas(corners)).sum() < 1 / _GRID**2:
        return [
            f"{mesh} {', '.join(charts)}: the triangles' texture coordinates span no area, so that "
            f"each shows a single texel: {told} of one colour there: unwrap it"
        ]
    share = overlap(corners)
    if share >= LARGEST_OVERLAP:
        share = overlap(corners[_fronts(charts, places)])
    if share < LARGEST_OVERLAP:
        return []
    return [
        f"{mesh} {', '.join(charts)}: {share:.0%} of the texels that {it} belong to two or more "
        f"places of the surface: {told} a compromise there"
    ]


def _areas(corners: np.ndarray) -> np.ndarray:
    """Of triangles ``(F, 3, 2)``, ``(F,)``, negative clockwise."""
    (ax, ay), (bx, by) = np.moveaxis(corners[:, 1:] - corners[:, :1], 0, -1).swapaxes(0, 1)
    return (ax * by - ay * bx) / 2


def _fronts(charts: dict[str, np.ndarray], places: dict[str, tuple]) -> np.ndarray:
    """Which triangles of ``charts`` count, ``(F,)``: not those that are turned round in the texture
    and have all their corners, in space and there, in common with others that are not. Of faces
    that are there twice these are one side's, cut into triangles as they may be."""
    own = [np.dstack([places[name][0][places[name][1]], uv]) for name, uv in charts.items()]
    rows = np.concatenate(own)
    _, corner = np.unique(rows.reshape(-1, 5), axis=0, return_inverse=True)
    corner, turned = corner.reshape(-1, 3), _areas(rows[..., 3:]) < 0
    known = np.zeros(corner.max() + 1, bool)
    known[corner[~turned]] = True
    return ~(turned & known[corner].all(axis=1))


def overlap(corners: np.ndarray, size: int = _GRID) -> float:
    """Share of the texels inside some triangle that lie inside two or more.

    ``corners (F, 3, 2)``: texture coordinates, modulo one, as a texture repeats. Counted at the
    centres of ``size``² texels. Triangles that share an edge never share a centre: a row of
    centres meets a triangle in an interval, closed on the left and open on the right, whose ends
    come from the edges alone.
    """
    corners = corners.astype(np.float64) * size
    low, high = corners[..., 1].min(axis=1), corners[..., 1].max(axis=1)
    first, end = (np.ceil(y - 0.5).astype(np.int64) for y in (low, high))
    rows = end - first
    total = int(rows.sum())
    if total > _MOST_SPANS and size > 16:
        return overlap(corners / size, max(16, size * _MOST_SPANS // total))
    starts = np.zeros((size, 2 * size + 1), np.int64)  # +1 where an interval begins, -1 at its end
    wholes = np.zeros(size, np.int64)
    part = np.cumsum(rows) // _SPANS_AT_ONCE
    for chosen in np.split(np.arange(len(rows)), np.flatnonzero(np.diff(part)) + 1):
        triangle = np.repeat(chosen, rows[chosen])
        before = np.cumsum(rows[chosen]) - rows[chosen]
        row = first[triangle] + np.arange(len(triangle)) - np.repeat(before, rows[chosen])
        left, right = _interval(corners[triangle], row + 0.5)
        whole, rest = np.divmod(right - left, size)
        line, column = row % size, left % size
        for place, sign in ((column, 1), (column + rest, -1)):
            hits = np.bincount(line * (2 * size + 1) + place, minlength=starts.size)
            starts += sign * hits.reshape(starts.shape)
        wholes += np.bincount(line, whole, minlength=size).astype(np.int64)
    counts = np.cumsum(starts, axis=1)
    counts = counts[:, :size] + counts[:, size : 2 * size] + wholes[:, None]
    used = np.count_nonzero(counts)
    return np.count_nonzero(counts > 1) / used if used else 0.0


def _interval(corners: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Columns ``[left, right)`` whose centres lie inside the triangles ``(N, 3, 2)`` at ``y``."""
    left, right = np.full(len(y), np.inf), np.full(len(y), -np.inf)
    for i in range(3):
        p, q = corners[:, i], corners[:, (i + 1) % 3]
        # From below upwards: the neighbour's edge gives the very same number.
        upwards = (p[:, 1] <= q[:, 1])[:, None]
        p, q = np.where(upwards, p, q), np.where(upwards, q, p)
        met = (p[:, 1] <= y) & (y < q[:, 1])
        slope = (q[:, 0] - p[:, 0]) / np.where(met, q[:, 1] - p[:, 1], 1)
        x = p[:, 0] + (y - p[:, 1]) * slope
        left, right = (
            np.where(met, np.minimum(left, x), left),
            np.where(met, np.maximum(right, x), right),
        )
    return np.ceil(left - 0.5).astype(np.int64), np.ceil(right - 0.5).astype(np.int64)
