"""`cameras.json`: pictures of a calibrated target, as OpenCV's calibration gives them.

``width``, ``height``, ``camera_matrix`` (3 × 3), ``distortion`` ([k1, k2, p1, p2, k3], or a word
for none), and ``views`` with ``image``, ``mask`` (optional), and ``world_to_camera`` (4 × 4) each,
whose axes are x right, y down, z forward. OpenCV counts pixels from the *middle* of the first.
A view may have an ``exposure``, a number or [red, green, blue]: how many times as bright its
picture is as at exposure 1. ``inner_corners`` and ``square_size_m`` say where a chessboard's
corners are in the plane z = 0, ``printed_board_rect_m`` how far it reaches.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...runtime.errors import InputError
from .base import Capture, exposure, load_json, matrix, number, numbers, whole
from .camera import Camera
from .finding import listed_mask, picture, present

NAME = "cameras.json"
_MOST_CORNERS = 100_000


def find(folder: Path) -> Path | None:
    return folder / NAME if (folder / NAME).is_file() else None


def read(file: Path) -> Capture:
    """Raises InputError, naming the view, for what is missing or wrong."""
    top = load_json(file)
    views = top.get("views")
    if not isinstance(views, list) or not views:
        raise InputError(f"{file}: has no list of views")
    found = [present(_camera, file, n, top, view) for n, view in enumerate(views)]
    cameras = [camera for camera in found if camera is not None]
    plane = top.get("printed_board_rect_m")
    if plane is not None:
        plane = numbers(plane, 4, f"{file}: printed_board_rect_m")
    return Capture(cameras, file.name, _corners(file, top), plane=plane, turned=True)


def _camera(file: Path, index: int, top: dict, view) -> Camera:
    where = f"{file}: view {index}"
    if not isinstance(view, dict) or not isinstance(view.get("image"), str):
        raise InputError(f"{where} has no image")
    both = {**top, **view}
    for name in ("width", "height", "camera_matrix", "world_to_camera"):
        if name not in both:
            raise InputError(f"{where} has no {name}")
    try:
        inner = np.asarray(both["camera_matrix"], np.float64)
        if inner.shape != (3, 3):
            raise ValueError
    except (TypeError, ValueError):
        raise InputError(f"{where}: camera_matrix is no 3×3 matrix") from None
    if inner[0, 1] != 0:
        raise InputError(f"{where}: camera_matrix has skew, which no renderer's camera has")
    world_to_camera = matrix(both["world_to_camera"], f"{where}: world_to_camera")
    if abs(np.linalg.det(world_to_camera)) < 1e-9:
        raise InputError(f"{where}: world_to_camera cannot be inverted")
    lens = both.get("distortion")
    k1, k2, p1, p2, k3 = [0.0] * 5
    if isinstance(lens, list):
        if len(lens) not in (4, 5):
            raise InputError(f"{where}: distortion: give [k1, k2, p1, p2] or [k1, k2, p1, p2, k3]")
        k1, k2, p1, p2, k3 = numbers([*lens, 0.0][:5], 5, f"{where}: distortion")
    return Camera(
        name=view["image"],
        image=picture(file.parent, view["image"], where),
        mask=listed_mask(file.parent, view.get("mask"), f"{where}: mask"),
        width=whole(both["width"], f"{where}: width"),
        height=whole(both["height"], f"{where}: height"),
        fx=float(inner[0, 0]),
        fy=float(inner[1, 1]),
        cx=float(inner[0, 2]) + 0.5,
        cy=float(inner[1, 2]) + 0.5,
        radial=(k1, k2, k3, 0.0),
        tangential=(p1, p2),
        to_world=np.linalg.inv(world_to_camera),
        exposure=exposure(view, where),
        described=str(file),
    )


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
