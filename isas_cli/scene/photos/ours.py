"""`cameras.json`: pictures whose cameras OpenCV calibrated.

``width``, ``height``, ``camera_matrix`` (3 × 3), ``distortion`` (OpenCV's vector of 4, 5, 8, 12 or
14 numbers, as a list, a row or a column; ``fisheye``: true where it is the 4 of ``cv2.fisheye``; or
a word for none), and ``views`` with ``image``, ``mask`` (optional), and a pose each:
``world_to_camera`` (4 × 4), or OpenCV's ``rvec`` and ``tvec``; axes are x right, y down, z forward.
OpenCV counts pixels from the *middle* of the first. OpenCV's own words for these do as well:
``image_width``, ``image_height``, ``distortion_coefficients``. Instead of ``views`` there may be
``images``, names, beside ``rvecs`` and ``tvecs``, or ``extrinsic_parameters``, rows of both, as its
calibration sample writes them.

A view may have an ``exposure``, a number or [red, green, blue]: how many times as bright its
picture is as at exposure 1. ``inner_corners`` and ``square_size_m`` say where a chessboard's
corners are in the plane z = 0, ``printed_board_rect_m`` how far it reaches.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ...runtime.errors import InputError
from . import lens
from .base import (
    Asked,
    Capture,
    exposure,
    load_json,
    matrix,
    number,
    numbers,
    read_text,
    whole,
)
from .camera import Camera
from .finding import listed_mask, picture, present

NAME = "cameras.json"
_MOST_CORNERS = 100_000
_TELLING = ("views", "camera_matrix", "rvecs", "extrinsic_parameters")
_LENGTHS = (4, 5, 8, 12, 14)
# OpenCV's and ROS' words for ours.
_SAME = {
    "image_width": "width",
    "image_height": "height",
    "distortion_coefficients": "distortion",
    "distortion_coeffs": "distortion",
    "dist_coeffs": "distortion",
    "dist_coeff": "distortion",
    "dist_coefs": "distortion",
    "distCoeffs": "distortion",
    "dist": "distortion",
    "fisheye_model": "fisheye",
}
# What is probably distortion, too.
_UNREAD = re.compile(r"dist(?!ance|orted|rib)", re.IGNORECASE)
# ROS' distortion_model: whether it is a fisheye's.
_ROS = {"plumb_bob": False, "rational_polynomial": False, "equidistant": True, "fisheye": True}


def claims(file: Path) -> bool:
    return file.suffix == ".json" and file.name.startswith("cameras")


def find(folder: Path) -> Path | None:
    return folder / NAME if (folder / NAME).is_file() else None


def foreign(file: Path) -> bool:
    """Whether it is another program's of that name, as Gaussian splatting's: beside it lie, as a
    rule, the cameras that this was made from."""
    text = read_text(file)
    return file.name == NAME and not any(f'"{word}"' in text for word in _TELLING)


def read(file: Path, asked: Asked) -> Capture:
    """Raises InputError, naming the view, for what is missing or wrong."""
    return of(file, load_json(file))


def of(file: Path, top: dict) -> Capture:
    """What a file holds, ``top``, means. Raises InputError."""
    top = _named(top)
    views = top.get("views")
    if views is None:
        views = _paired(file, top)
    if not isinstance(views, list) or not views:
        raise InputError(f"{file}: has no list of views")
    found = [present(_camera, file, n, top, view) for n, view in enumerate(views)]
    cameras = [camera for camera in found if camera is not None]
    plane = top.get("printed_board_rect_m")
    if plane is not None:
        plane = numbers(plane, 4, f"{file}: printed_board_rect_m")
    return Capture(cameras, file.name, _corners(file, top), plane=plane, turned=True)


def _named(held: dict) -> dict:
    """By our words, where those are not there too."""
    found = {key: _plain(value) for key, value in held.items()}
    for key, own in _SAME.items():
        if key in found and found.get(own) is None:
            found[own] = found.pop(key)
    return found


def _plain(value):
    """A matrix as OpenCV and ROS write it, ``rows``, ``cols`` and ``data``, in lists of rows;
    anything else as it is."""
    if isinstance(value, dict) and {"rows", "cols", "data"} <= set(value):
        try:
            return np.array(value["data"]).reshape(int(value["rows"]), int(value["cols"])).tolist()
        except (TypeError, ValueError):
            return value
    return value


def _paired(file: Path, top: dict):
    """Views of ``images`` and the poses beside them; None where there are no poses. Raises
    InputError where either is missing or they are unlike in number."""
    poses = top.get("extrinsic_parameters")
    if poses is not None:
        table = _array(poses, f"{file}: extrinsic_parameters")
        if table.ndim != 2 or table.shape[1] != 6:
            raise InputError(f"{file}: extrinsic_parameters: rows of rvec and tvec, 6 numbers each")
        turns, shifts = table[:, :3].tolist(), table[:, 3:].tolist()
    else:
        turns, shifts = top.get("rvecs"), top.get("tvecs")
    if not (isinstance(turns, list) and isinstance(shifts, list)):
        return None
    images = top.get("images")
    images = [images] if isinstance(images, str) else images
    if not isinstance(images, list) or not len(images) == len(turns) == len(shifts):
        found = len(images) if isinstance(images, list) else 0
        raise InputError(
            f"{file}: has poses of {len(turns)} views and names of {found} pictures: add "
            "images: [a.png, …], in the order of the poses"
        )
    return [{"image": i, "rvec": r, "tvec": t} for i, r, t in zip(images, turns, shifts)]


def _camera(file: Path, index: int, top: dict, view) -> Camera:
    where = f"{file}: view {index}"
    if not isinstance(view, dict) or not isinstance(view.get("image"), str):
        raise InputError(f"{where} has no image")
    view = _named(view)
    both = {**top, **view}
    for name in ("width", "height", "camera_matrix"):
        if name not in both:
            raise InputError(f"{where} has no {name}")
    inner = _array(both["camera_matrix"], f"{where}: camera_matrix")
    if inner.shape != (3, 3):
        raise InputError(f"{where}: camera_matrix is no 3×3 matrix")
    if inner[0, 1] != 0:
        raise InputError(f"{where}: camera_matrix has skew, which OpenCV's cameras do not have")
    return Camera(
        name=view["image"].replace("\\", "/"),
        image=picture(file.parent, view["image"], where),
        mask=listed_mask(file.parent, view.get("mask"), f"{where}: mask", view["image"]),
        width=whole(both["width"], f"{where}: width"),
        height=whole(both["height"], f"{where}: height"),
        fx=float(inner[0, 0]),
        fy=float(inner[1, 1]),
        cx=float(inner[0, 2]) + 0.5,
        cy=float(inner[1, 2]) + 0.5,
        lens=_lens(both, where),
        to_world=np.linalg.inv(_pose(both, where)),
        exposure=exposure(view, where),
        described=str(file),
    )


def _pose(both: dict, where: str) -> np.ndarray:
    """World to camera, ``(4, 4)``. Raises InputError."""
    if "world_to_camera" in both:
        found = matrix(both["world_to_camera"], f"{where}: world_to_camera")
        if abs(np.linalg.det(found)) < 1e-9:
            raise InputError(f"{where}: world_to_camera cannot be inverted")
        return found
    if not ("rvec" in both and "tvec" in both):
        raise InputError(f"{where} has no world_to_camera, nor rvec and tvec")
    turn, shift = (_array(both[name], f"{where}: {name}") for name in ("rvec", "tvec"))
    if shift.size != 3 or turn.size not in (3, 9):
        raise InputError(f"{where}: rvec and tvec are of 3 numbers each")
    found = np.eye(4)
    # Some store what cv2.Rodrigues makes of rvec under its name.
    found[:3, :3] = (
        turn.reshape(3, 3) if turn.size == 9 else Rotation.from_rotvec(turn.ravel()).as_matrix()
    )
    if abs(np.linalg.det(found)) < 1e-9:
        raise InputError(f"{where}: rvec is a matrix that cannot be inverted")
    found[:3, 3] = shift.ravel()
    return found


def _lens(both: dict, where: str) -> lens.Lens:
    told, ros = both.get("distortion"), both.get("distortion_model")
    lists = (str(key) for key, value in both.items() if isinstance(value, (list, dict)))
    if told is None and (other := next(filter(_UNREAD.match, lists), None)) is not None:
        raise InputError(f"{where}: {other} is not read: call it distortion")
    if told is None or isinstance(told, str):
        return lens.Lens()
    if ros is not None and str(ros) not in _ROS:
        raise InputError(f"{where}: distortion_model {ros}; valid: {', '.join(_ROS)}")
    fisheye = both.get("fisheye") or 0
    if not isinstance(fisheye, bool):
        fisheye = number(fisheye, f"{where}: fisheye") != 0
    fisheye = fisheye or _ROS.get(str(ros), False)
    found = _array(told, f"{where}: distortion").ravel()
    valid = (4,) if fisheye else _LENGTHS
    if found.size not in valid:
        raise InputError(
            f"{where}: distortion: {found.size} numbers; OpenCV has {', '.join(map(str, valid))}: "
            + ("k1 … k4 of its fisheye" if fisheye else "k1, k2, p1, p2, k3, k4 …")
        )
    return lens.of_opencv(tuple(float(x) for x in found), fisheye)


def _array(value, where: str) -> np.ndarray:
    """Of finite numbers. Raises InputError, naming ``where``."""
    try:
        found = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{where}: no list of numbers, or rows of unlike length") from None
    if not np.isfinite(found).all():
        raise InputError(f"{where}: holds NaN or infinite numbers: mend or remove this view")
    return found


def _corners(file: Path, top: dict) -> np.ndarray | None:
    """The inner corners of the chessboard, row after row, ``(n m, 3)``."""
    if "inner_corners" not in top or "square_size_m" not in top:
        return None
    where = f"{file}: inner_corners"
    columns, rows = (whole(x, where) for x in numbers(top["inner_corners"], 2, where))
    if columns * rows > _MOST_CORNERS:
        raise InputError(f"{where}: {columns}×{rows} corners: at most {_MOST_CORNERS}")
    side = number(top["square_size_m"], f"{file}: square_size_m")
    j, i = np.mgrid[:rows, :columns]
    return np.stack([i.ravel() * side, j.ravel() * side, np.zeros(i.size)], axis=1)
