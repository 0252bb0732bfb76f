"""OBJ as trimesh reads it, but for its file of materials and for faces with notches.

trimesh cuts every face into a fan about its first corner, which covers the notches of one that is
not convex, and counts corners below 0 from the end of the file.
"""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np

_SEVERAL = re.compile(r"^[ \t]*f(?:[ \t]+[^ \t\r\n]+){4}", re.MULTILINE)
_REMARK = re.compile(r"^([ \t]*(?:f|v|vt|vn)[ \t][^#\r\n]*)#.*", re.MULTILINE)
_BACKWARDS = re.compile(r"^[ \t]*f[ \t][^\r\n]*-", re.MULTILINE)
_FLAT = 1e-6  # of a face's area: what a corner may be turned inwards


class _Materials:
    """In place of a file of materials, which may be missing, or name pictures that cannot be read,
    and of which names alone are asked."""

    def __init__(self, names: list[str]):
        # One more that nothing uses: of a single one trimesh does not tell the rest apart.
        self._text = "".join(f"newmtl {name}\nKd 1 1 1\n" for name in [*filter(None, names), "-"])

    def __getitem__(self, name: str) -> bytes:
        return self._text.encode()


def load(file: Path):
    """Its scene as trimesh has it, and the names of its materials in order. Raises what that
    raises, and ValueError."""
    import trimesh

    text = _counted(_joined(file.read_text(encoding="utf-8", errors="replace")))
    names = _check_some(text)
    text = _cut(text)
    if len(names) > 1:
        # Materials part a file only where it names a file of them.
        text = f"mtllib materials.mtl\n{text}"
    stream = io.BytesIO(text.encode())
    scene = trimesh.load_scene(stream, file_type="obj", process=False, resolver=_Materials(names))
    return scene, names


def _joined(text: str) -> str:
    """The same without remarks behind numbers, with lines whole that go on in the next after a
    backslash. One at the end of a comment, as of a folder's name, means nothing."""
    text = _REMARK.sub(r"\1", text)
    if "\\\n" not in text:
        return text
    text = re.sub(r"^[ \t]*#.*", "", text, flags=re.MULTILINE)
    return re.sub(r"\\\n", " ", text)


def _counted(text: str) -> str:
    """The same, with corners by their numbers from the file's beginning: one below 0 counts from
    the face that names it backwards, and trimesh counts from the end of the file."""
    if _BACKWARDS.search(text) is None:
        return text
    lines, counts = text.splitlines(), {"v": 0, "vt": 0, "vn": 0}
    for number, line in enumerate(lines):
        word, *rest = line.split() or [""]
        if word in counts:
            counts[word] += 1
        elif word == "f" and "-" in line:
            lines[number] = " ".join([word, *(_corner(each, counts) for each in rest)])
    return "\n".join(lines) + "\n"


def _corner(corner: str, counts: dict[str, int]) -> str:
    parts = zip(corner.split("/"), counts.values())
    return "/".join(str(int(n) + count + 1) if n.startswith("-") else n for n, count in parts)


def _check_some(text: str) -> list[str]:
    """The materials of an OBJ file's faces. Raises ValueError where of one some faces have texture
    coordinates and others none: they would be left away."""
    material, kinds = "", {}
    for line in text.splitlines():
        word, *rest = line.split() or [""]
        if word == "usemtl":
            material = line.split(maxsplit=1)[1].strip() if rest else ""
        elif word == "f" and rest:
            corner = rest[0].split("/")
            kinds.setdefault(material, set()).add(len(corner) > 1 and corner[1] != "")
    for name, found in kinds.items():
        if len(found) > 1:
            raise ValueError(
                f"of {f'material {name}' if name else 'its faces'} only some have texture "
                "coordinates: unwrap all of them, or none"
            )
    return list(kinds)


def _cut(text: str) -> str:
    """The same, with triangles in place of faces that are not convex."""
    if _SEVERAL.search(text) is None:
        return text
    lines, places, faces = text.splitlines(), [], {}
    for number, line in enumerate(lines):
        word, *rest = line.split() or [""]
        if word == "v":
            places.append([float(x) for x in rest[:3]])
        elif word == "f" and len(rest) > 3:
            at = [int(corner.split("/")[0]) - 1 for corner in rest]
            faces.setdefault(len(at), []).append((number, rest, at))
    for of_size in faces.values():
        corners = np.array(places)[[at for *_, at in of_size]]  # (F, N, 3)
        flat, notched = _flattened(corners)
        for face in np.flatnonzero(notched):
            number, words, _ = of_size[face]
            lines[number] = "\n".join(
                f"f {' '.join(words[corner] for corner in ear)}" for ear in _ears(flat[face])
            )
    return "\n".join(lines) + "\n"


def triangles(corners: np.ndarray) -> np.ndarray:
    """Which corners of each of faces ``(F, N, 3)`` its triangles have, ``(F, N - 2, 3)``."""
    count = corners.shape[1]
    fan = np.stack([np.zeros(count - 2, int), np.arange(1, count - 1), np.arange(2, count)], axis=1)
    found = np.tile(fan, (len(corners), 1, 1))
    flat, notched = _flattened(corners)
    for face in np.flatnonzero(notched):
        found[face] = _ears(flat[face])
    return found


def _flattened(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Faces ``(F, N, 3)`` in their own planes, ``(F, N, 2)``, counter-clockwise, and which of them
    are not convex, ``(F,)``. The plane: Newell's."""
    corners = corners - corners.mean(axis=1, keepdims=True)
    normal = np.cross(corners, np.roll(corners, -1, axis=1)).sum(axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    # The axis that lies most aside of it.
    aside = np.eye(3)[np.abs(normal).argmin(axis=1)]
    across = np.cross(aside, normal)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-30)
    axes = np.stack([across, np.cross(normal, across)], axis=2)
    flat = corners @ axes
    turn = _turn(np.roll(flat, 1, axis=1), flat, np.roll(flat, -1, axis=1))
    area = np.abs(_turn(np.zeros_like(flat), flat, np.roll(flat, -1, axis=1)).sum(axis=1))
    return flat, (turn < -_FLAT * area[:, None]).any(axis=1)


def _turn(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Twice the area of triangles in a plane, positive counter-clockwise."""
    one, other = b - a, c - a
    return one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]


def _ears(flat: np.ndarray) -> list[tuple[int, int, int]]:
    """The triangles of a face ``(N, 2)``, by cutting off one corner after another that has no other
    in it (Meisters 1975)."""
    left, found = list(range(len(flat))), []
    while len(left) > 3:
        for k in range(len(left)):
            ear = left[k - 1], left[k], left[(k + 1) % len(left)]
            a, b, c = flat[list(ear)]
            rest = flat[[n for n in left if n not in ear]]
            # A slit to a hole comes back to its corners.
            rest = rest[(rest[:, None] != flat[list(ear)]).any(axis=2).all(axis=1)]
            inside = (_turn(a, b, rest) >= 0) & (_turn(b, c, rest) >= 0) & (_turn(c, a, rest) >= 0)
            if _turn(a, b, c) > 0 and not inside.any():
                break
        else:  # crosses itself: as trimesh does
            k, ear = 1, tuple(left[:3])
        found.append(ear)
        del left[k]
    return [*found, tuple(left)]
