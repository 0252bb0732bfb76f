"""PLY and OFF, also of faces of unlike or many corners.

Of a binary PLY trimesh takes the first face's number of corners for that of all, and so refuses
triangles beside quadrilaterals, which Blender writes; faces with notches it cuts into fans. Of OFF
it refuses more than four corners, and takes a comment's line for others.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from . import obj

# PLY's words for types of numbers.
_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"},
}
# What a PLY file calls a face's corners, and texture coordinates of vertices and of faces.
_CORNERS = ("vertex_indices", "vertex_index")
_OF_VERTICES, _OF_FACES = (("texture_u", "texture_v"), ("u", "v"), ("s", "t")), "texcoord"
_COLOURS = ("red", "green", "blue")


def load(file: Path):
    """Its scene as trimesh has it. Raises what its readers raise."""
    import trimesh

    colours = None
    if file.suffix.lower() == ".off":
        vertices, faces, uv = _off(file.read_text(encoding="utf-8", errors="replace"))
    else:
        data = file.read_bytes()
        if not _counted(data):
            raise ValueError(
                "it has points and no triangles: make a mesh of them first, as COLMAP's "
                "poisson_mesher or MeshLab do"
            )
        with contextlib.suppress(ValueError):
            scene = trimesh.load_scene(file, process=False)
            if sum(len(each.faces) for each in scene.geometry.values()) <= _counted(data):
                return scene  # of triangles: others it cuts into fans
        vertices, faces, uv, colours = _ply(data)
    visual = None if uv is None else trimesh.visual.TextureVisuals(uv=uv)
    mesh = trimesh.Trimesh(vertices, faces, visual=visual, process=False, vertex_colors=colours)
    return trimesh.Scene(mesh)


def _counted(data: bytes) -> int:
    """The faces that a PLY file says it has."""
    found = re.search(rb"^element face (\d+)", data.partition(b"end_header")[0], re.MULTILINE)
    return int(found[1]) if found else 0


def _ply(data: bytes) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray | None]:
    """Places ``(V, 3)``, triangles ``(F, 3)``, and, or None, texture coordinates ``(V, 2)``, v
    upwards, and colours ``(V, 3)``."""
    read = _elements(data)
    vertex, face = read["vertex"], read["face"]
    places = np.stack([vertex[axis] for axis in "xyz"], axis=1)
    faces, corners = _cut(places, face[next(name for name in _CORNERS if name in face)])
    own = None
    if _OF_FACES in face:
        own = np.concatenate(face[_OF_FACES]).reshape(-1, 2)[corners.ravel()]
        vertex = {name: vertex[name][faces.ravel()] for name in _COLOURS if name in vertex}
        places, faces = places[faces.ravel()], np.arange(faces.size).reshape(-1, 3)

    def stacked(several: tuple[tuple[str, ...], ...]) -> np.ndarray | None:
        names = next((names for names in several if set(names) <= set(vertex)), None)
        return None if names is None else np.stack([vertex[name] for name in names], axis=1)

    return places, faces, stacked(_OF_VERTICES) if own is None else own, stacked((_COLOURS,))


def _elements(data: bytes) -> dict[str, dict[str, Sequence]]:
    """What a PLY file has, by elements and their properties: an array, or of lists one each. Raises
    ValueError for one that ends too soon."""
    end = re.search(rb"^end_header\r?\n", data, re.MULTILINE)
    if end is None:
        raise ValueError("has no end_header")
    head = data[: end.start()].decode(errors="replace")
    order = ">" if "binary_big_endian" in head else "<"
    words = data[end.end() :].split() if "format ascii" in head else None
    at, listed = 0 if words is not None else end.end(), {}
    for line in map(str.split, head.splitlines()):
        if line[:1] == ["element"]:
            listed[line[1]] = int(line[2]), (properties := [])
        elif line[:1] == ["property"]:
            types = [np.dtype(order + _TYPES[word]) for word in line[1:-1] if word != "list"]
            properties.append((line[-1], types))

    def taken(kinds: list[np.dtype], count: int) -> list[np.ndarray]:
        """The columns of so many rows of these types."""
        nonlocal at
        if count < 0:  # which NumPy takes for all there is
            raise ValueError(f"has a list of {count} entries")
        if words is not None:
            first, at = at, at + count * len(kinds)
            rows = np.array(words[first:at]).astype(np.float64).reshape(count, len(kinds))
            return [column.astype(kind) for column, kind in zip(rows.T, kinds)]
        row = np.dtype([(str(number), kind) for number, kind in enumerate(kinds)])
        first, at = at, at + count * row.itemsize
        rows = np.frombuffer(data, row, count, first)
        return [rows[name] for name in row.names]

    found = {}
    for name, (count, properties) in listed.items():
        if all(len(types) == 1 for _, types in properties):
            columns = taken([types[0] for _, types in properties], count)
            found[name] = {own: column for (own, _), column in zip(properties, columns)}
            continue
        found[name] = {own: [] for own, _ in properties}
        for _ in range(count):
            for own, (*counted, kind) in properties:
                several = int(taken(counted, 1)[0][0]) if counted else 1
                found[name][own].append(taken([kind], several)[0])
        for own in (own for own, types in properties if len(types) == 1):
            found[name][own] = np.ravel(found[name][own])
    return found


def _off(text: str) -> tuple[np.ndarray, np.ndarray, None]:
    text = re.sub("#.*", "", text).split("OFF", 1)[1]
    (count, faces, *_), *lines = filter(None, map(str.split, text.splitlines()))
    places = np.array([line[:3] for line in lines[: int(count)]], np.float64)
    if len(lines) < int(count) + int(faces):
        raise ValueError(f"has {len(lines)} lines, not {count} of vertices and {faces} of faces")
    listed = lines[int(count) : int(count) + int(faces)]
    listed = [np.array(line[1 : int(line[0]) + 1], np.int64) for line in listed]
    return places, _cut(places, listed)[0], None


def _cut(places: np.ndarray, faces: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of faces of any number of corners: their vertices, and their corners as these are
    counted through all faces, ``(T, 3)`` each."""
    counts = np.array([len(face) for face in faces], int)
    vertices, first = np.concatenate([[], *faces]).astype(np.int64), np.cumsum(counts) - counts
    found = [np.zeros((0, 3), int)]
    for count in np.unique(counts[counts >= 3]):
        corners = first[counts == count][:, None] + np.arange(count)
        cut = obj.triangles(places[vertices[corners]].astype(np.float64))
        found.append(np.take_along_axis(corners[:, None], cut, axis=2).reshape(-1, 3))
    corners = np.concatenate(found)
    return vertices[corners], corners
