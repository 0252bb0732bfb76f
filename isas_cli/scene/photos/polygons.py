"""PLY and OFF, also of faces of unlike or many corners.

Of a binary PLY trimesh takes the first face's number of corners for that of all, and so refuses
triangles beside quadrilaterals, which Blender writes. Of OFF it refuses more than four corners, and
takes a comment's line for others.
"""

from __future__ import annotations

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


def load(file: Path):
    """Its scene as trimesh has it. Raises what its readers raise."""
    import trimesh

    if file.suffix.lower() == ".off":
        vertices, faces, uv = _off(file.read_text(encoding="utf-8", errors="replace"))
    else:
        try:
            return trimesh.load_scene(file, process=False)
        except ValueError:
            if b"format binary" not in (data := file.read_bytes())[:100]:
                raise
        vertices, faces, uv = _ply(data)
    visual = None if uv is None else trimesh.visual.TextureVisuals(uv=uv)
    return trimesh.Scene(trimesh.Trimesh(vertices, faces, visual=visual, process=False))


def _ply(data: bytes) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Places ``(V, 3)``, triangles ``(F, 3)``, and texture coordinates ``(V, 2)``, v upwards, or
    None."""
    read = _elements(data)
    vertex, face = read["vertex"], read["face"]
    places = np.stack([vertex[axis] for axis in "xyz"], axis=1)
    faces, corners = _cut(places, face[next(name for name in _CORNERS if name in face)])
    if _OF_FACES in face:
        own = np.concatenate(face[_OF_FACES]).reshape(-1, 2)[corners.ravel()]
        return places[faces.ravel()], np.arange(faces.size).reshape(-1, 3), own
    pair = next((pair for pair in _OF_VERTICES if set(pair) <= set(vertex)), None)
    return places, faces, None if pair is None else np.stack([vertex[n] for n in pair], axis=1)


def _elements(data: bytes) -> dict[str, dict[str, Sequence]]:
    """What a binary PLY file has, by elements and their properties: an array, or of lists one
    each. Raises ValueError for one that ends too soon."""
    end = re.search(rb"^end_header\r?\n", data, re.MULTILINE)
    if end is None:
        raise ValueError("has no end_header")
    head = data[: end.start()].decode(errors="replace")
    order, at, listed = ">" if "binary_big_endian" in head else "<", end.end(), {}
    for line in map(str.split, head.splitlines()):
        if line[:1] == ["element"]:
            listed[line[1]] = int(line[2]), (properties := [])
        elif line[:1] == ["property"]:
            types = [np.dtype(order + _TYPES[word]) for word in line[1:-1] if word != "list"]
            properties.append((line[-1], types))

    def taken(kind: np.dtype, count: int) -> np.ndarray:
        nonlocal at
        if count < 0:  # which NumPy takes for all there is
            raise ValueError(f"has a list of {count} entries")
        at += kind.itemsize * count
        return np.frombuffer(data, kind, count, at - kind.itemsize * count)

    found = {}
    for name, (count, properties) in listed.items():
        if all(len(types) == 1 for _, types in properties):
            rows = taken(np.dtype([(own, types[0]) for own, types in properties]), count)
            found[name] = {own: rows[own] for own, _ in properties}
            continue
        found[name] = {own: [] for own, _ in properties}
        for _ in range(count):
            for own, (*counted, kind) in properties:
                several = int(taken(counted[0], 1)[0]) if counted else 1
                found[name][own].append(taken(kind, several))
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
