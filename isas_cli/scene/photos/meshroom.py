"""Meshroom's cameras: AliceVision's SfMData as JSON, `cameras.sfm`, `sfm.sfm`, `sfm.json`.

By AliceVision's source, 2.0 to 3.2, and its samples up to version 1.2.14: ``rotation``, column
after column, goes from world to camera (x right, y down, z forward), ``center`` is where the camera
stands; views of a rig whose poses are not independent hang on that of the rig. Pixels count from
the *middle* of the first, ``principalPoint`` from half the picture's size (before version 1.2.1
from 0). Focal lengths are pixels before 1.2.2, then millimetres of a sensor whose width is the
picture's, from 1.2.11 on its longer side's; ``pixelRatio`` is fx / fy, from 1.2.5 on fy / fx, and
from 1.2.11 on the millimetres are of fy. Lenses are OpenCV's, and COLMAP's FOV; those that take the
distortion out instead (3DEqualizer's) are refused.

From version 1.2.3 on, AliceVision 3.0 (its pull request 1030), meshes have y and z negated, and
poses in JSON have not: they are turned alike, unless ``photos.world=file``.
"""

from __future__ import annotations

import posixpath
from pathlib import Path, PurePosixPath

import numpy as np

from ...runtime.errors import InputError
from . import layouts, models
from .base import Asked, Capture, inside, load_json, number, numbers, objects, read_text, whole
from .finding import present, viewed
from .lens import Lens

_NAMES = ("cameras.sfm", "sfm.sfm", "sfm.json")
_WORDS = ('"version"', '"views"', '"intrinsics"')
# From these versions on: what the docstring says, and what nobody knows yet.
_MIDDLE, _TURNED, _RATIO, _LONGER, _UNKNOWN = (1, 2, 1), (1, 2, 3), (1, 2, 5), (1, 2, 11), (1, 3, 0)
# The kinds of lens, as COLMAP's models, and their other names from 1.2.8 on.
_LENSES = {
    "pinhole": ("PINHOLE", ""),
    "radial1": ("RADIAL", "k1"),
    "radial3": ("OPENCV", "k1 k2 k3"),
    "brown": ("OPENCV", "k1 k2 k3 p1 p2"),
    "fisheye4": ("OPENCV_FISHEYE", "k1 k2 k3 k4"),
    "fisheye1": ("FOV", "omega"),
}
_SAME = {"none": "pinhole", "radialk1": "radial1", "radialk3": "radial3", "fisheye": "fisheye4"}
_WAY_OUT = "export for COLMAP (aliceVision_exportColmap)"
# Of the world, half about x.
_TURN = np.diag([1.0, -1.0, -1.0, 1.0])


def claims(file: Path) -> bool:
    if file.suffix.lower() != ".json":
        return file.suffix.lower() == ".sfm"
    text = read_text(file)
    return all(word in text for word in _WORDS)


def find(folder: Path) -> Path | None:
    return next((folder / name for name in _NAMES if (folder / name).is_file()), None)


def read(file: Path, asked: Asked) -> Capture:
    """Raises InputError, naming view or intrinsic, for what is missing, wrong or not known."""
    top = load_json(file)
    version = tuple(int(x) for x in numbers(top.get("version"), 3, f"{file}: version"))
    if version >= _UNKNOWN:
        told = ".".join(map(str, version))
        raise InputError(f"{file}: version {told}: none beyond 1.2 is known; {_WAY_OUT}")
    views, rigs = objects(top, "views", str(file)), objects(top, "rigs", str(file))
    inner = {str(each.get("intrinsicId")): each for each in objects(top, "intrinsics", str(file))}
    poses = {str(each.get("poseId")): each for each in objects(top, "poses", str(file))}
    subs = {
        (str(rig.get("rigId")), str(n)): sub
        for rig in rigs
        for n, sub in enumerate(objects(rig, "subPoses", f"{file}: rig {rig.get('rigId')}"))
    }
    above, names = _names([str(view.get("path", "")) for view in views])
    folders = [file.parent / above, *layouts.pictures(file.parent, asked.root)]
    turn = version >= _TURNED and asked.world == "mesh"
    cameras, lost = [], []
    for view, name in zip(views, names):
        where = f"{file}: view {name}"
        pose = _pose(view, poses, subs, where)
        if pose is None:
            lost.append(name)
            continue
        number_ = str(view.get("intrinsicId"))
        if number_ not in inner:
            raise InputError(f"{where}: its intrinsic {number_} is not in the file")
        told = _inner(inner[number_], version, f"{file}: intrinsic {number_}")
        pose = _TURN @ pose if turn else pose
        camera = present(viewed, name, folders, pose, told, file, where)
        if camera is not None:
            cameras.append(camera)
    if len(lost) == len(views):
        raise InputError(f"{file}: no view has a pose: take what StructureFromMotion wrote")
    notes = [f"{file}: {len(lost)} views have no pose, first {lost[0]}"] if lost else []
    if turn:
        notes.append(
            f"{file}: poses turned by half a turn about x, as Meshroom turns what it writes as a "
            "mesh; photos.world=file takes them as they stand"
        )
    return Capture(cameras, "Meshroom", notes=notes, worlds=version >= _TURNED)


def _names(paths: list[str]) -> tuple[str, list[str]]:
    """The folder that pictures lie below, perhaps on another machine, and their names from there,
    which are what views are called."""
    plain = [PurePosixPath(path.replace("\\", "/")) for path in paths]
    try:
        above = posixpath.commonpath([path.parent for path in plain])
        return above, [str(path.relative_to(above)) for path in plain]
    except ValueError:  # none, or some from the root and some not
        return "", [str(path) for path in plain]


def _pose(view: dict, poses: dict, subs: dict, where: str) -> np.ndarray | None:
    """Camera to world, ``(4, 4)``; None where that, or its place in its rig, is not known."""
    entry = poses.get(str(view.get("poseId")))
    if entry is None:
        return None
    found = _rigid(inside(entry, f"{where}: its pose", "pose", "transform"), where)
    if str(view.get("isPoseIndependant")).lower() not in ("0", "false"):
        return found
    sub = subs.get((str(view.get("rigId")), str(view.get("subPoseId"))))
    if sub is None or sub.get("status") == "uninitialized":
        return None
    return found @ _rigid(inside(sub, f"{where}: its sub-pose", "pose"), where)


def _rigid(told: dict, where: str) -> np.ndarray:
    """From the camera to what it hangs on, ``(4, 4)``."""
    found = np.eye(4)
    # Columns of the inverse.
    found[:3, :3] = np.reshape(numbers(told.get("rotation"), 9, f"{where}: rotation"), (3, 3))
    found[:3, 3] = numbers(told.get("center"), 3, f"{where}: center")
    return found


def _inner(told: dict, version: tuple[int, ...], where: str) -> dict:
    """Size, focal lengths, principal point and lens of an intrinsic."""
    size = tuple(whole(told.get(name), f"{where}: {name}") for name in ("width", "height"))
    fx, fy = _focal(told, size, version, where)
    centre = np.array(numbers(told.get("principalPoint"), 2, f"{where}: principalPoint")) + 0.5
    cx, cy = centre + np.array(size) / 2 if version >= _MIDDLE else centre
    return {
        "width": size[0],
        "height": size[1],
        "fx": fx,
        "fy": fy,
        "cx": float(cx),
        "cy": float(cy),
        "lens": _lens(told, where),
    }


def _focal(
    told: dict, size: tuple[int, ...], version: tuple[int, ...], where: str
) -> tuple[float, ...]:
    """Pixels, along x and y."""
    pixels = told.get("pxFocalLength")
    if isinstance(pixels, list):
        return numbers(pixels, 2, f"{where}: pxFocalLength")
    if pixels is not None:
        return (number(pixels, f"{where}: pxFocalLength"),) * 2

    def of(name: str, otherwise=None) -> float:
        found = number(told.get(name, otherwise), f"{where}: {name}")
        if not found > 0:
            raise InputError(f"{where}: {name} {found:g}: must be above 0")
        return found

    side = max(size) if version >= _LONGER else size[0]
    focal, ratio = of("focalLength") / of("sensorWidth") * side, of("pixelRatio", 1)
    if version >= _LONGER:
        return focal / ratio, focal
    return focal, focal * ratio if version >= _RATIO else focal / ratio


def _lens(told: dict, where: str) -> Lens:
    kind, inverse = str(told.get("type")), str(told.get("undistortionType", "none"))
    if kind == "pinhole":
        kind = str(told.get("distortionType", kind))
    kind = _SAME.get(kind, kind) if inverse == "none" else f"undistortion {inverse}"
    if kind not in _LENSES:
        raise InputError(
            f"{where}: lens {kind}; valid: {', '.join(_LENSES)}: choose one of these in "
            f"CameraInit and run it anew, or {_WAY_OUT}"
        )
    model, names = _LENSES[kind][0], _LENSES[kind][1].split()
    found = numbers(told.get("distortionParams") or [], len(names), f"{where}: distortionParams")
    return models.lens(model, dict(zip(names, found)))
