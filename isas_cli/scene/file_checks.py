"""What Mitsuba would not survive, found before it: damage in files that a scene names, and plugins
that cannot be rendered."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import mitsuba as mi
import numpy as np

from ..runtime.errors import InputError
from .mesh_checks import check_indices

# Of Mitsuba's .vol: magic bytes and version, type of the values, X, Y, Z, channels, bounding box.
_VOLUME = struct.Struct("<3sB5i6f")
_FLOAT32 = 1
# Plugins with which no picture can be made as here, and why.
_BEYOND = {
    "timed_sunsky": "Mitsuba cannot render it in this variant, as it asks what a variable holds "
    "while a kernel is traced: take sunsky, whose date and time can be given",
    "directionalarea": "no path from a camera finds its light, so images are the same without it: "
    "take it out",
}
# Skies whose to_world turns directions, and is taken to do nothing else.
_TURNED = "envmap", "sunsky"
# Of a rotation that is written with few digits.
_ROUNDED = 0.01


def check(state, where: str) -> None:
    """Raise InputError, which begins with ``where``, for what the parsed scene ``state`` cannot be
    loaded with. What is merely wrong is left to Mitsuba, which says so."""
    for node in state.nodes:
        kind, props = node.props.plugin_name(), node.props
        if kind in _BEYOND:
            raise InputError(f"{where}: emitter {kind}: {_BEYOND[kind]}")
        if kind in _TURNED and "to_world" in props:
            _check_turn(np.array(props["to_world"].matrix, np.float64)[:3, :3], where, kind)
        if kind == "bitmap" and not {"filename", "bitmap", "data"} & set(props.keys()):
            raise InputError(f"{where}: a bitmap texture has no filename")
        if kind in _CHECKS and "filename" in props and isinstance(props["filename"], str):
            path = Path(str(mi.file_resolver().resolve(props["filename"])))
            if path.is_file():
                _CHECKS[kind](path, f"{where}: {props['filename']}")


def _check_turn(linear: np.ndarray, where: str, kind: str) -> None:
    """Of a sky that is stretched Mitsuba draws directions that are not of length 1: its own ways to
    the light disagree, by factors, and no picture of it is right."""
    if np.abs(linear.T @ linear - np.eye(3)).max() > _ROUNDED:
        raise InputError(
            f"{where}: emitter {kind}: its to_world stretches or shears: it may only turn and "
            "mirror; an axis of <rotate> is to have the length 1, or it stretches too, and <scale> "
            "the values 1 and -1"
        )


def _mesh(path: Path, where: str) -> None:
    """Of triangles that name vertices which are not there, Mitsuba would compute normals."""
    import trimesh

    if not _line_by_line(path):
        return
    try:
        mesh = trimesh.load_mesh(
            path, file_type="ply", process=False, fix_texture=False, skip_materials=True
        )
        vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    except IndexError:
        raise InputError(f"{where}: triangles name vertices that are not there") from None
    except Exception:  # its reader may know less than Mitsuba's
        return
    check_indices(faces, len(vertices), where)


def _line_by_line(path: Path) -> bool:
    """Whether trimesh reads what Mitsuba does: of an ASCII file it takes a line for an element."""
    with open(path, "rb") as file:
        if b"format ascii" not in file.read(4096):
            return True
        file.seek(0)
        head, _, body = file.read().partition(b"end_header")
    lines = body.strip().splitlines()
    counts = re.findall(rb"^\s*element\s+\S+\s+(\d+)", head, re.MULTILINE)
    return all(map(bytes.strip, lines)) and len(lines) == sum(map(int, counts))


def check_volume(path: Path, where: str) -> None:
    """Raise InputError, which begins with ``where``, for a .vol file whose header says something
    else than it holds: Mitsuba would reserve, and read, what the header says."""
    size = path.stat().st_size
    with open(path, "rb") as file:
        head = file.read(_VOLUME.size)
    if len(head) < _VOLUME.size or head[:3] != b"VOL":
        raise InputError(f"{where}: no grid in Mitsuba's format (.vol)")
    kind, *sides, channels = _VOLUME.unpack(head)[2:7]
    values = (size - _VOLUME.size) // 4
    wanted = int(np.prod([*sides, channels], dtype=object))
    if kind != _FLOAT32 or min(*sides, channels) < 1 or wanted != values:
        raise InputError(
            f"{where}: its header says {' x '.join(map(str, sides))} points of {channels} values "
            f"of type {kind}, and the file holds {values} values: float32 (type 1), as many as "
            "the header says"
        )


def read_bounds(path: Path) -> tuple[float, ...]:
    """The box that a .vol file says its grid fills: its least corner, then its largest."""
    with open(path, "rb") as file:
        return _VOLUME.unpack(file.read(_VOLUME.size))[7:]


def write_bounds(path: Path, bounds: tuple[float, ...]) -> None:
    """Lets a .vol file say that its grid fills this box (``read_bounds``)."""
    with open(path, "r+b") as file:
        head = _VOLUME.unpack(file.read(_VOLUME.size))
        file.seek(0)
        file.write(_VOLUME.pack(*head[:7], *bounds))


_CHECKS = {"ply": _mesh, "gridvolume": check_volume}
