"""NumPy's files of cameras, which have no names of pictures: these are taken in the names' order.

- `cameras_sphere.npz`, `cameras.npz`, of IDR, VolSDF and NeuS: for each picture n, ``world_mat_n``
  leads from the world to pixels, a camera matrix times a pose, up to a factor. Their readers count
  pixels from the middle of the first, and so is it here, but where the principal point is half the
  picture's size exactly: that comes from COLMAP's cameras, which count from the corner.
  ``scale_mat_n`` leads from a sphere of radius 1 to that world, and is of no use to a mesh in it.
  Masks are taken in the order of their names as well, where these are others than the pictures'.
- `poses_bounds.npy`, of LLFF: rows of 17 numbers, a 3×5 matrix and two depths. Of the matrix the
  first three columns are the camera's axes (down, right, backward), the fourth is its place, the
  fifth height, width and focal length of its picture, whose middle is the principal point.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from scipy.linalg import rq

from ...runtime.errors import InputError
from .base import Asked, Capture, name_of, whole
from .camera import Camera
from .finding import inside, listing, size

_NAMES = ("cameras_sphere.npz", "cameras.npz", "poses_bounds.npy")
_FOLDERS = ("image", "images", "rgb")
_MASKS = ("mask", "masks")
_MARK = re.compile(r"[_.-]?mask[_.-]?")
_MATRIX = re.compile(r"world_mat_(\d+)")
# Pixels: of what a decomposition leaves, and of skew across a picture, which no camera here has.
_ROUNDING, _SKEW = 1e-3, 0.25
# Of a picture's width: a shorter focal length is one in other units.
_SHORT = 0.05


def claims(file: Path) -> bool:
    return file.suffix in (".npz", ".npy")


def find(folder: Path) -> Path | None:
    return next((folder / name for name in _NAMES if (folder / name).is_file()), None)


def read(file: Path, asked: Asked) -> Capture:
    """Raises InputError, naming the file, for what is missing or wrong."""
    try:
        opened = np.load(file, allow_pickle=False)
        found = dict(opened) if file.suffix == ".npz" else opened
    except Exception as error:  # zipfile, zlib and NumPy have their own
        told = " ".join(str(error).split())
        raise InputError(f"{file}: cannot be read as NumPy's arrays: {told}") from error
    return _neus(file, found, asked) if isinstance(found, dict) else _llff(file, found, asked)


def _pictures(file: Path, asked: Asked, count: int) -> list[Path]:
    folders = [file.parent / name for name in _FOLDERS]
    found = listing(folders, str(file))
    if len(found) != count:
        raise InputError(
            f"{file}: holds {count} cameras, but {found[0].parent} has {len(found)} pictures: one "
            "for each camera, in the order of their names; photos.images=FOLDER takes another"
        )
    return found


def _neus(file: Path, arrays: dict, asked: Asked) -> Capture:
    known = {int(m[1]): arrays[key] for key in arrays if (m := _MATRIX.fullmatch(key))}
    if not known:
        raise InputError(
            f"{file}: has no world_mat_0, world_mat_1, …, which NeuS' and IDR's cameras have"
        )
    matrices = [_projection(known[n], f"{file}: world_mat_{n}") for n in sorted(known)]
    centred, cameras, pictures = 0, [], _pictures(file, asked, len(known))
    masks = next((m for name in _MASKS if len(m := inside(file.parent / name)) == len(known)), [])
    # Where names tell, they count: '10_mask' comes before '1_mask', and '1.png' before '10.png'.
    named = {_MARK.sub("", mask.stem): mask for mask in masks}
    told = {image.stem for image in pictures} <= set(named)
    masks = [named[image.stem] for image in pictures] if told else masks
    every = zip(sorted(known), pictures, masks or [None] * len(known), matrices)
    for number, image, mask, matrix in every:
        (width, height), where = size(image), f"{file}: world_mat_{number}"
        inner, turn = rq(matrix[:, :3])
        signs = np.sign(np.diag(inner))
        inner, turn = inner * signs, turn * signs[:, None]
        place = np.linalg.solve(matrix[:, :3], -matrix[:, 3])
        inner = inner / inner[2, 2]
        if inner[0, 0] < _SHORT * width:
            raise InputError(
                f"{where}: its focal length is {inner[0, 0]:.3g} pixels, of a picture {width} "
                "wide: where pixels are no unit (DVR's sets, with camera_mat) write transforms.json"
            )
        if abs(inner[0, 1]) * height > _SKEW * inner[1, 1]:
            raise InputError(f"{where}: has skew of {inner[0, 1]:.3g} pixels: no lens has any")
        centre = inner[:2, 2]
        if np.abs(centre - [width / 2, height / 2]).max() > _ROUNDING:
            centre = centre + 0.5
        else:
            centred += 1
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn.T, place
        numbers = width, height, inner[0, 0], inner[1, 1], *centre
        name = name_of(image, asked.root)
        cameras.append(Camera(name, image, *numbers, pose, mask, described=str(file)))
    notes = [f"{file}: its {len(cameras)} cameras are of the pictures in the order of their names"]
    if masks and not told:
        notes.append(
            f"{masks[0].parent}: its masks are called otherwise than the pictures, and are theirs "
            "in the order of their names"
        )
    if centred:
        notes.append(
            f"{file}: {centred} principal points are half the picture's size: taken as its middle"
        )
    return Capture(cameras, "NeuS", notes=notes)


def _projection(value: np.ndarray, where: str) -> np.ndarray:
    """``(3, 4)``, whose first three columns have a positive determinant. Raises InputError."""
    if value.shape not in ((4, 4), (3, 4)) or not np.issubdtype(value.dtype, np.floating):
        raise InputError(f"{where}: no matrix of 4 rows of 4 numbers")
    matrix = value[:3].astype(np.float64)
    # By what turns and projects: how far away the world's origin is says nothing of that.
    matrix = matrix / (np.abs(matrix[:, :3]).max() or 1)
    if not np.isfinite(matrix).all():
        raise InputError(f"{where}: holds NaN or infinite numbers: mend or remove this view")
    determinant = np.linalg.det(matrix[:, :3])
    if abs(determinant) < 1e-15:
        raise InputError(f"{where}: cannot be inverted, so it is of no camera")
    return matrix * np.sign(determinant)


def _llff(file: Path, rows: np.ndarray, asked: Asked) -> Capture:
    if rows.ndim != 2 or rows.shape[1] != 17 or not np.issubdtype(rows.dtype, np.floating):
        raise InputError(f"{file}: is no table of 17 numbers a row, as LLFF's poses_bounds.npy is")
    cameras = []
    for row, image in zip(rows.astype(np.float64), _pictures(file, asked, len(rows))):
        matrix = row[:15].reshape(3, 5)
        down, right, backward, place = matrix[:, :4].T
        height, width = (whole(x, f"{file}: size of {image.name}") for x in matrix[:2, 4])
        pose = np.eye(4)
        pose[:3] = np.column_stack([right, down, -backward, place])
        numbers = width, height, matrix[2, 4], matrix[2, 4], width / 2, height / 2
        name = name_of(image, asked.root)
        cameras.append(Camera(name, image, *numbers, pose, described=str(file)))
    notes = [
        f"{file}: its {len(cameras)} cameras are of the pictures in the order of their names; it "
        "tells of no lens, so what COLMAP found of one is lost: photos.cameras=sparse/0 has it, "
        "where the model is kept"
    ]
    return Capture(cameras, "LLFF", notes=notes)
