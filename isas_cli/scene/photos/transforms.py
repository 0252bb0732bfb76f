"""`transforms.json` of nerfstudio and instant-ngp, and `transforms_train.json` of Blender sets.

Their cameras have x to the right, y up and z backward (OpenGL's axes), and ``transform_matrix``
goes from camera to world. Intrinsics stand at the top or with a frame, as ``fl_x`` … or as an
angle of view. Ours alone is a frame's ``exposure``, a number or [red, green, blue]: how many times
as bright its picture is as at exposure 1.

nerfstudio turns the poses of COLMAP and others so that z is up, and says by which
``applied_transform`` (3 × 4, the new world from the old one) and ``applied_scale`` (of places,
afterwards). What is applied is undone, so that a mesh of the old world fits, unless
``photos.world=file``. Older versions wrote no ``applied_transform`` where they had turned COLMAP's
poses (``_BEFORE``): for such it takes sets that lack the word and keep COLMAP's model.
instant-ngp's ``scale``, ``offset`` and ``aabb_scale`` say where it puts the scene in its own unit
cube; they change no pose. What its `colmap2nerf.py` did to COLMAP's poses is written nowhere.

nerfstudio lists the views that it holds out as ``val_filenames`` and ``test_filenames``, and those
to learn from as ``train_filenames``; Blender sets have them in `transforms_test.json`.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...runtime.errors import InputError
from . import models
from .base import Asked, Capture, exposure, load_json, matrix, number, numbers, whole
from .camera import Camera
from .finding import called, listed_mask, missed, picture, present, size
from .lens import Lens

NAMES = ("transforms.json", "transforms_train.json")
TEST = "transforms_test.json"
# nerfstudio's other name for a lens without a word on which.
_PERSPECTIVE = "PERSPECTIVE"
# Of nerfstudio, instead: in this order.
_LISTED, _IN_LIST = "distortion_params", ("k1", "k2", "k3", "k4", "p1", "p2")
_NUMBERS = tuple(f"k{n}" for n in range(1, 7)) + ("p1", "p2")
# Of instant-ngp: these make a picture something else than a lens does, or move the camera.
_THETA, _OTHERS = "ftheta_p0", ("latlong", "equirectangular", "orthographic")
# The new world from COLMAP's, as nerfstudio's reader has it; where COLMAP's model is then; and what
# no file of those sets has: later ones do, and instant-ngp's.
_BEFORE = [[0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0]]
_MODEL, _SINCE = "colmap/sparse/0", ("applied_transform", "ply_file_path", "aabb_scale")
# From the camera's axes as the file has them to x right, y down, z forward.
TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


def claims(file: Path) -> bool:
    return file.suffix == ".json" and not file.name.startswith("cameras")


def find(folder: Path) -> Path | None:
    return next((folder / name for name in NAMES if (folder / name).is_file()), None)


def read(file: Path, asked: Asked) -> Capture:
    """Raises InputError, naming the frame, for what is missing or wrong."""
    top, cameras = _cameras(file)
    held = []
    if asked.given and file.name == NAMES[0]:
        held = _listed(file, top, "val_filenames", "test_filenames")
        if "train_filenames" in top:
            wanted = {*held, *_listed(file, top, "train_filenames")}
            cameras = [camera for camera in cameras if camera.name in wanted]
    elif asked.given and file.with_name(TEST).is_file():
        _, more = _cameras(file.with_name(TEST))
        cameras, held = cameras + more, [camera.name for camera in more]
    cameras, notes = _undone(file, top, cameras, asked.world)
    worlds = bool(notes)
    if not worlds and top.get("orientation_override") == "none":
        notes.append(
            f"{file}: may be nerfstudio's of Polycam or Metashape, whose axes it changes without "
            "an applied_transform: where the mesh is in the world of those programs, give "
            "Polycam's own folder or Metashape's XML"
        )
    if any("fisheye_crop_radius" in each for each in (top, *top["frames"])):
        notes.append(
            f"{file}: fisheye_crop_radius is not heeded: what lies beyond it counts, unless a mask "
            "says that it does not"
        )
    return Capture(cameras, file.name, held=held, notes=notes, worlds=worlds)


def _cameras(file: Path) -> tuple[dict, list[Camera]]:
    """What the file holds, and its frames. Raises InputError."""
    top = load_json(file)
    frames = top.get("frames")
    if not isinstance(frames, list) or not frames:
        raise InputError(f"{file}: has no list of frames")
    found = [present(_camera, file, n, top, frame) for n, frame in enumerate(frames)]
    return top, [camera for camera in found if camera is not None]


def _undone(
    file: Path, top: dict, cameras: list[Camera], world: str
) -> tuple[list[Camera], list[str]]:
    """Cameras in the ``world`` that is asked for, and what to say of it."""
    told = [name for name in ("applied_transform", "applied_scale") if top.get(name) is not None]
    turn, scale = np.eye(4), 1.0
    if "applied_transform" in told:
        turn = matrix(top["applied_transform"], f"{file}: applied_transform")
    elif file.name == NAMES[0] and _old(file.parent, top):
        turn = matrix(_BEFORE, _MODEL)
        told.insert(0, f"an older nerfstudio's turn of COLMAP's world ({_MODEL} is there)")
    if "applied_scale" in told:
        scale = number(top["applied_scale"], f"{file}: applied_scale")
    if not scale > 0 or not np.linalg.det(turn) > 1e-12:
        raise InputError(f"{file}: {' or '.join(told)} cannot be undone: mirrored, or scale 0")
    if scale == 1 and (turn == np.eye(4)).all():
        return cameras, []
    which = f"{file}: {' and '.join(told)}"
    if world == "file":
        return cameras, [f"{which} stay: the mesh has to be in the world of its poses"]
    back, larger = np.linalg.inv(turn), np.cbrt(np.linalg.det(turn))
    found = []
    for camera in cameras:
        pose = camera.to_world.copy()
        pose[:3, 3] /= scale
        pose = back @ pose
        pose[:3, :3] *= larger
        found.append(replace(camera, to_world=pose))
    note = (
        f"{which} undone: the mesh is taken to be in the world before them, COLMAP's or "
        "another's; photos.world=file takes poses as they stand in the file"
    )
    return found, [note]


def _old(folder: Path, top: dict) -> bool:
    """Whether a set is of COLMAP by a nerfstudio that did not say how it turned the poses."""
    return (folder / _MODEL).exists() and not any(name in top for name in _SINCE)


def _listed(file: Path, top: dict, *keys: str) -> list[str]:
    """Names of the views that nerfstudio lists so. Raises InputError for one that is no view."""
    views: dict[str, list[str]] = {}
    for frame in top["frames"]:
        views.setdefault(called(frame["file_path"]), []).append(placed(file, frame)[1])
    held: list[str] = []
    for key in keys:
        listed = top.get(key, [])
        if not isinstance(listed, list):
            raise InputError(f"{file}: {key} is no list of pictures")
        for name in listed:
            found = views.get(called(str(name)))
            if found is None:
                raise InputError(f"{file}: {key}: {name} is the file_path of no frame")
            held += [view for view in found if not missed(view)]
    return held


def placed(file: Path, frame: dict) -> tuple[Path, str]:
    """Where the pictures of a frame lie, and its view's name. A ``scene_name``, which Stanford-ORB
    has, says that they are of the set of that name beside this one."""
    name, scene = called(frame["file_path"]), frame.get("scene_name")
    if scene is None:
        return file.parent, name
    return file.absolute().parent.parent / str(scene), f"{scene}/{name}"


def _camera(file: Path, number_: int, top: dict, frame) -> Camera:
    where = f"{file}: frame {number_}"
    if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
        raise InputError(f"{where} has no file_path")
    if "transform_matrix" not in frame:
        raise InputError(f"{where} has no transform_matrix")
    both = {**top, **frame}
    lens = _lens(both, where)
    root, name = placed(file, frame)
    image = picture(root, frame["file_path"], where, first=True, view=name)
    width, height = size(image)
    width = whole(both["w"], f"{where}: w") if "w" in both else width
    height = whole(both["h"], f"{where}: h") if "h" in both else height

    def of(name: str, otherwise: float) -> float:
        return number(both[name], f"{where}: {name}") if name in both else otherwise

    # As instant-ngp has it: what a frame says of either axis stands before the top's of both.
    told = (_focals(each, where, width, height) for each in (frame, top))
    focals = next((each for each in told if each is not None), None)
    if focals is None:
        raise InputError(f"{where}: none of fl_x, camera_angle_x, x_fov says its focal length")
    return Camera(
        name=name,
        image=image,
        mask=listed_mask(root, frame.get("mask_path"), f"{where}: mask_path", name),
        width=width,
        height=height,
        fx=focals[0],
        fy=focals[1],
        cx=of("cx", width / 2),
        cy=of("cy", height / 2),
        lens=lens,
        to_world=matrix(frame["transform_matrix"], f"{where}: transform_matrix") @ TO_OPENCV,
        exposure=exposure(frame, where),
        described=str(file),
    )


def _lens(both: dict, where: str) -> Lens:
    """``camera_model``, or instant-ngp's ``is_fisheye``, and its numbers.

    Of OPENCV, k4 is the factor of r⁸, as nerfstudio has it, unless k5 or k6 stand with it: the
    three are OpenCV's, below the fraction."""
    model = both.get("camera_model", "OPENCV")
    if both.get("is_fisheye"):
        model = "OPENCV_FISHEYE"
    if model == _PERSPECTIVE:
        model = "OPENCV"
    other = next((name for name in _OTHERS if both.get(name)), None)
    if _THETA in both:  # whose number may be 0
        other = _THETA
    if other is not None or not isinstance(model, str) or model not in models.PARAMETERS:
        told = f"camera_model {model}" if other is None else other
        valid = ", ".join(models.PARAMETERS)
        raise InputError(f"{where}: {told}; valid: {valid}; {models.WAY_OUT}")
    shutter = both.get("rolling_shutter") or [0]
    still = isinstance(shutter, list) and all(x == 0 for x in shutter)
    if not still or "transform_matrix_end" in both:
        raise InputError(
            f"{where}: rolling_shutter or transform_matrix_end: a camera that moves while it takes "
            "a picture, which isas does not know: leave them out where it hardly moves"
        )
    names = {*_NUMBERS, *models.PARAMETERS[model].split()} - {"f", "fx", "fy", "cx", "cy"}
    values = {n: number(both[n], f"{where}: {n}") for n in names if both.get(n) is not None}
    if (listed := both.get(_LISTED)) is not None:
        values |= dict(zip(_IN_LIST, numbers(listed, len(_IN_LIST), f"{where}: {_LISTED}")))
    if model == "OPENCV" and (values.get("k5") or values.get("k6")):
        model = "FULL_OPENCV"
    return models.lens(model, values)


def _focals(told: dict, where: str, width: int, height: int) -> tuple[float, float] | None:
    """Pixels, along x and y, of what a frame or the top says; None where that is nothing."""
    fx, fy = _focal(told, where, "x", width), _focal(told, where, "y", height)
    if fx is None and fy is None:
        return None
    return (fy if fx is None else fx), (fx if fy is None else fy)


def _focal(told: dict, where: str, axis: str, size: int) -> float | None:
    """Pixels, along one axis; None where nothing says it. ``camera_angle_x`` is in radians, as
    NeRF's, ``x_fov`` in degrees, as instant-ngp's, which asks for them in this order."""
    radians, degrees = f"camera_angle_{axis}", (f"{axis}_fov", f"fov_{axis}")
    for name in (*degrees, f"fl_{axis}", radians):
        if name not in told:
            continue
        value = number(told[name], f"{where}: {name}")
        if name.startswith("fl"):
            return value
        if name == radians and not 0 < value < math.pi:
            raise InputError(f"{where}: {name}={value:g}: radians, between 0 and π")
        if name != radians:
            # Below, it is radians, or the lens of a telescope.
            if not math.pi < value < 180:
                raise InputError(
                    f"{where}: {name}={value:g}: degrees, between π and 180; radians are {radians}"
                )
            value = math.radians(value)
        return size / 2 / math.tan(value / 2)
    return None
