"""OpenMVG's `sfm_data.json`, as it and cereal write it.

By OpenMVG's source, 1.4 to 2.1: ``rotation``, row after row, goes from world to camera (x right,
y down, z forward), ``center`` is where the camera stands. Pixels count from the *middle* of the
first. Lenses are OpenCV's. What kind a camera is stands with the first of its kind, as
``polymorphic_name``; the others have the number of that alone, without its topmost bit.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path, PurePosixPath

import numpy as np

from ...runtime.errors import InputError
from . import layouts, models
from .base import Asked, Capture, inside, load_json, number, numbers, objects, read_text, whole
from .finding import present, viewed

_NAME, _WORD = "sfm_data.json", '"sfm_data_version"'
# The kinds of camera: as COLMAP's models, and what their numbers stand under.
_LENSES = {
    "pinhole": ("PINHOLE", "", ""),
    "pinhole_radial_k1": ("RADIAL", "disto_k1", "k1"),
    "pinhole_radial_k3": ("OPENCV", "disto_k3", "k1 k2 k3"),
    "pinhole_brown_t2": ("OPENCV", "disto_t2", "k1 k2 k3 p1 p2"),
    "fisheye": ("OPENCV_FISHEYE", "fisheye", "k1 k2 k3 k4"),
}
_TOP = 1 << 31
_WAY_OUT = (
    "openMVG_main_openMVGSpherical2Cubic makes pinholes of spherical ones, "
    "openMVG_main_openMVG2Colmap exports for COLMAP"
)


def claims(file: Path) -> bool:
    return file.suffix.lower() == ".json" and _WORD in read_text(file)[:200]


def find(folder: Path) -> Path | None:
    return folder / _NAME if (folder / _NAME).is_file() else None


def read(file: Path, asked: Asked) -> Capture:
    """Raises InputError, naming view or intrinsic, for what is missing, wrong or not known."""
    top = load_json(file)
    views = [
        inside(each, f"{file}: view {each.get('key')}", "value", "ptr_wrapper", "data")
        for each in objects(top, "views", str(file))
    ]
    inner = _kinds(objects(top, "intrinsics", str(file)), str(file))
    poses = {str(each.get("key")): each for each in objects(top, "extrinsics", str(file))}
    above = str(top.get("root_path", "")).replace("\\", "/")
    folders = [file.parent / above, *layouts.pictures(file.parent, asked.root)]
    cameras, lost = [], []
    for view in views:
        local = str(view.get("local_path", "")).replace("\\", "/").lstrip("/")
        name = str(PurePosixPath(local) / str(view.get("filename", "")))
        where, key = f"{file}: view {name}", str(view.get("id_intrinsic"))
        entry = poses.get(str(view.get("id_pose")))
        if entry is None:
            lost.append(name)
            continue
        if key not in inner:
            raise InputError(f"{where}: its intrinsic {key} is not in the file")
        pose = partial(_pose, inside(entry, f"{where}: its pose", "value"), where)
        told = partial(_inner, *inner[key], f"{file}: intrinsic {key}")
        camera = present(viewed, name, folders, pose, told, file, where)
        if camera is not None:
            cameras.append(camera)
    if len(lost) == len(views):
        raise InputError(f"{file}: no view has a pose: take what was written after reconstruction")
    notes = [f"{file}: {len(lost)} views have no pose, first {lost[0]}"] if lost else []
    return Capture(cameras, "OpenMVG", notes=notes)


def _pose(told: dict, where: str) -> np.ndarray:
    """Camera to world, ``(4, 4)``."""
    rows = told.get("rotation")
    if not isinstance(rows, list) or len(rows) != 3:
        raise InputError(f"{where}: rotation: no 3 rows of 3 numbers")
    pose = np.eye(4)
    pose[:3, :3] = np.array([numbers(row, 3, f"{where}: rotation") for row in rows]).T
    pose[:3, 3] = numbers(told.get("center"), 3, f"{where}: center")
    return pose


def _kinds(entries: list[dict], file: str) -> dict[str, tuple[str, dict]]:
    """Of each intrinsic, by its number: what kind of camera it is, and what holds its numbers."""
    kinds, found = {}, {}
    for entry in entries:
        where = f"{file}: intrinsic {entry.get('key')}"
        value = inside(entry, where, "value")
        number_ = int(number(value.get("polymorphic_id"), f"{where}: polymorphic_id")) % _TOP
        kind = str(kinds.setdefault(number_, value.get("polymorphic_name")))
        found[str(entry.get("key"))] = kind, value
    return found


def _inner(kind: str, value: dict, where: str) -> dict:
    """Size, focal length, principal point and lens of an intrinsic."""
    if kind not in _LENSES:
        raise InputError(f"{where}: camera {kind}; valid: {', '.join(_LENSES)}; {_WAY_OUT}")
    told = inside(value, where, "ptr_wrapper", "data")
    model, under, names = _LENSES[kind]
    values = numbers(told.get(under, []), len(names.split()), f"{where}: {under}")
    focal = number(told.get("focal_length"), f"{where}: focal_length")
    cx, cy = numbers(told.get("principal_point"), 2, f"{where}: principal_point")
    return {
        "width": whole(told.get("width"), f"{where}: width"),
        "height": whole(told.get("height"), f"{where}: height"),
        "fx": focal,
        "fy": focal,
        "cx": cx + 0.5,
        "cy": cy + 0.5,
        "lens": models.lens(model, dict(zip(names.split(), values))),
    }
