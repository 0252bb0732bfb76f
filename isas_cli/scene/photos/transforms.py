"""`transforms.json` of nerfstudio and instant-ngp, and `transforms_train.json` of Blender sets.

Their cameras have x to the right, y up and z backward (OpenGL's axes), and ``transform_matrix``
goes from camera to world. Intrinsics stand at the top or with a frame, as ``fl_x`` … or as an
angle of view. Ours alone is a frame's ``exposure``, a number or [red, green, blue]: how many times
as bright its picture is as at exposure 1.

nerfstudio lists the views that it holds out as ``val_filenames`` and ``test_filenames``, and those
to learn from as ``train_filenames``; Blender sets have them in `transforms_test.json`.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from ...runtime.errors import InputError
from .base import Capture, exposure, load_json, matrix, number, whole
from .camera import Camera
from .finding import listed_mask, missed, picture, present, size

NAMES = ("transforms.json", "transforms_train.json")
TEST = "transforms_test.json"
_MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE")
# From the camera's axes as the file has them to x right, y down, z forward.
_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


def find(folder: Path) -> Path | None:
    return next((folder / name for name in NAMES if (folder / name).is_file()), None)


def read(file: Path, given: bool = False) -> Capture:
    """``given``: whether views that the files hold out are looked for. Raises InputError, naming
    the frame, for what is missing or wrong."""
    top, cameras = _cameras(file)
    held = []
    if given and file.name == NAMES[0]:
        held = _listed(file, top, cameras, "val_filenames", "test_filenames")
        if "train_filenames" in top:
            wanted = {*held, *_listed(file, top, cameras, "train_filenames")}
            cameras = [camera for camera in cameras if camera.name in wanted]
    elif given and file.with_name(TEST).is_file():
        _, more = _cameras(file.with_name(TEST))
        cameras, held = cameras + more, [camera.name for camera in more]
    return Capture(cameras, file.name, held=held)


def _cameras(file: Path) -> tuple[dict, list[Camera]]:
    """What the file holds, and its frames. Raises InputError."""
    top = load_json(file)
    frames = top.get("frames")
    if not isinstance(frames, list) or not frames:
        raise InputError(f"{file}: has no list of frames")
    found = [present(_camera, file, n, top, frame) for n, frame in enumerate(frames)]
    return top, [camera for camera in found if camera is not None]


def _listed(file: Path, top: dict, cameras: list[Camera], *keys: str) -> list[str]:
    """Names of the views that nerfstudio lists so. Raises InputError for one that is no view."""
    names, held = {camera.name for camera in cameras}, []
    for key in keys:
        listed = top.get(key, [])
        if not isinstance(listed, list):
            raise InputError(f"{file}: {key} is no list of pictures")
        for name in listed:
            found = str(name).removeprefix("./")
            if missed(found):
                continue
            if found not in names:
                raise InputError(f"{file}: {key}: {name} is the file_path of no frame")
            held.append(found)
    return held


def _camera(file: Path, number_: int, top: dict, frame) -> Camera:
    where = f"{file}: frame {number_}"
    if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
        raise InputError(f"{where} has no file_path")
    if "transform_matrix" not in frame:
        raise InputError(f"{where} has no transform_matrix")
    both = {**top, **frame}
    model = both.get("camera_model", "OPENCV")
    if model not in _MODELS or both.get("is_fisheye"):
        told = "fisheye" if both.get("is_fisheye") else model
        raise InputError(f"{where}: camera_model {told}; valid: {', '.join(_MODELS)}")
    image = picture(file.parent, frame["file_path"], where)
    width, height = size(image)
    width = whole(both["w"], f"{where}: w") if "w" in both else width
    height = whole(both["h"], f"{where}: h") if "h" in both else height

    def of(name: str, otherwise: float) -> float:
        return number(both[name], f"{where}: {name}") if name in both else otherwise

    fx = _focal(both, where, "x", width)
    fy = _focal(both, where, "y", height)
    if fx is None and fy is None:
        raise InputError(f"{where}: neither fl_x nor camera_angle_x says its focal length")
    return Camera(
        name=frame["file_path"].removeprefix("./"),
        image=image,
        mask=listed_mask(file.parent, frame.get("mask_path"), f"{where}: mask_path"),
        width=width,
        height=height,
        fx=fx if fx is not None else fy,
        fy=fy if fy is not None else fx,
        cx=of("cx", width / 2),
        cy=of("cy", height / 2),
        radial=tuple(of(name, 0.0) for name in ("k1", "k2", "k3", "k4")),
        tangential=(of("p1", 0.0), of("p2", 0.0)),
        to_world=matrix(frame["transform_matrix"], f"{where}: transform_matrix") @ _TO_OPENCV,
        exposure=exposure(frame, where),
        described=str(file),
    )


def _focal(both: dict, where: str, axis: str, size: int) -> float | None:
    """Pixels, along one axis; None where nothing says it."""
    for name in (f"fl_{axis}", f"camera_angle_{axis}"):
        if name not in both:
            continue
        value = number(both[name], f"{where}: {name}")
        if name.startswith("fl"):
            return value
        if not 0 < value < math.pi:
            raise InputError(f"{where}: {name}={value:g}: radians, between 0 and π")
        return size / 2 / math.tan(value / 2)
    return None
