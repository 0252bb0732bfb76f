"""Polycam's raw data: `keyframes/corrected_cameras/*.json` and the pictures beside them, or, where
these were not made, `keyframes/cameras`.

As https://github.com/PolyCam/polyform documents it: ``t_ij`` is row i, column j of the matrix from
camera to world, whose axes are ARKit's (x right, y up, z backward); `raw.glb` lies in a world of
its own, to which ``alignmentTransform`` in `mesh_info.json`, column after column, leads.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ...runtime.errors import InputError
from .base import Asked, Capture, load_json, name_of, number, whole
from .camera import Camera
from .finding import ordered, picture, present
from .transforms import TO_OPENCV

# Cameras and their pictures, the better ones first.
_PAIRS = (("corrected_cameras", "corrected_images"), ("cameras", "images"))
_PLACES = ("keyframes", "")
_ALIGNMENT = "alignmentTransform"


def claims(file: Path) -> bool:
    return file.suffix == ".json" and file.parent.name in (pair[0] for pair in _PAIRS)


def find(folder: Path) -> Path | None:
    """The first camera's file."""
    if folder.name in dict(_PAIRS) and folder.with_name(dict(_PAIRS)[folder.name]).is_dir():
        return next(iter(ordered(folder.glob("*.json"))), None)
    for place in _PLACES:
        for cameras, pictures in _PAIRS:
            if (folder / place / pictures).is_dir():
                files = ordered((folder / place / cameras).glob("*.json"))
                if files:
                    return files[0]
    return None


def read(file: Path, asked: Asked) -> Capture:
    """Raises InputError, naming the file, for what is missing or wrong."""
    folder = file.parent
    pictures = folder.with_name(dict(_PAIRS)[folder.name])
    files = ordered(folder.glob("*.json"))
    found = [present(_camera, each, pictures, asked.root) for each in files]
    cameras = [camera for camera in found if camera is not None]
    notes = []
    if folder.name == _PAIRS[-1][0]:
        notes.append(
            f"{folder}: poses as the phone had them: Polycam has no {_PAIRS[0][0]} here, which are "
            "exacter, and its pictures are not free of distortion"
        )
    else:
        notes.append(
            f"{pictures}: what Polycam's corrected pictures have of black along their borders is "
            "no part of the scene: where the object reaches it, masks are to leave it out"
        )
    info = next((p / "mesh_info.json" for p in folder.parents if _beside(p, asked.root)), None)
    alignment = None if info is None else load_json(info).get(_ALIGNMENT)
    if info is None and (above := asked.root.absolute().parent / "mesh_info.json").is_file():
        notes.append(
            f"{above}, whose {_ALIGNMENT} brings poses to the world of raw.glb, "
            "lies above the set, and is not read: give its folder to have it applied"
        )
    if alignment is not None and asked.world == "mesh":
        turn = _alignment(alignment, f"{info}: {_ALIGNMENT}")
        cameras = [replace(each, to_world=turn @ each.to_world) for each in cameras]
        notes.append(
            f"{info}: {_ALIGNMENT} applied: the mesh is taken to be raw.glb or in its world; "
            "photos.world=file takes poses as they stand"
        )
    return Capture(cameras, "Polycam", notes=notes, worlds=alignment is not None)


def _beside(folder: Path, root: Path) -> bool:
    """Whether a mesh's file lies there, not above the folder that was given."""
    return root in (folder, *folder.parents) and (folder / "mesh_info.json").is_file()


def _alignment(value, where: str) -> np.ndarray:
    """Of sixteen numbers, column after column. Raises InputError."""
    try:
        found = np.array(value, np.float64).reshape(4, 4).T
    except (TypeError, ValueError):
        raise InputError(f"{where}: no 16 numbers") from None
    if not np.isfinite(found).all() or abs(np.linalg.det(found)) < 1e-9:
        raise InputError(f"{where}: no matrix that can be inverted")
    return found


def _camera(file: Path, pictures: Path, root: Path) -> Camera:
    top = load_json(file)

    def of(name: str) -> float:
        if name not in top:
            raise InputError(f"{file}: has no {name}, which Polycam's cameras have")
        return number(top[name], f"{file}: {name}")

    pose = np.eye(4)
    pose[:3] = [[of(f"t_{row}{column}") for column in range(4)] for row in range(3)]
    image = picture(pictures, file.stem, str(file))
    return Camera(
        name=name_of(image, root),
        image=image,
        width=whole(of("width"), f"{file}: width"),
        height=whole(of("height"), f"{file}: height"),
        fx=of("fx"),
        fy=of("fy"),
        cx=of("cx"),
        cy=of("cy"),
        to_world=pose @ TO_OPENCV,
        described=str(file),
    )
