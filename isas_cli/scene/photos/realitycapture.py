"""RealityCapture's and RealityScan's XMP files, one beside each picture.

As "RealityCapture XMP Camera Math" has it: ``Rotation``, row after row, goes from world to camera
(x right, y down, z forward), ``Position`` is where the camera stands; ``FocalLength35mm`` is of a
film 36 mm long, and it and the principal point are in lengths of the picture's longer side. Of its
lenses those are read of which the formula is sure: ``perspective``, ``brown3``, ``brown4``, and
these with ``t2``, whose t1 and t2 are OpenCV's p2 and p1, as its own table "OpenCV-compliant
Internal/External Camera Parameters" orders them. The mesh has to be exported with "Same as XMP" as
coordinate system. Its CSV, of angles, is not read.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...runtime.errors import InputError
from .base import Asked, Capture, claimed, load_xml, name_of, read_text, words
from .camera import Camera
from .finding import ordered, picture, present, size
from .lens import Lens

_SPACE = "{http://www.capturingreality.com/ns/xcr/1.1#}"
_FILM = 36.0  # mm
_LENSES = ("perspective", "brown3", "brown4", "brown3t2", "brown4t2")
_POSE = {"Rotation", "Position"}
_COMPONENT = "ComponentId"
_WAY_OUT = "export the registration for COLMAP, or undistorted pictures with XMP"


def claims(file: Path) -> bool:
    ending = file.suffix.lower()
    if ending == ".csv":
        return "heading" in read_text(file)[:200]
    return ending == ".xmp" and _SPACE.strip("{}") in read_text(file)


def find(folder: Path) -> Path | None:
    """The first of its files: those beside pictures before a table."""
    for ending in ("xmp", "csv"):
        for place in (folder, folder / "images"):
            found = (file for file in ordered(place.glob(f"*.{ending}")) if claimed(file, claims))
            if (first := next(found, None)) is not None:
                return first
    return None


def read(file: Path, asked: Asked) -> Capture:
    """Raises InputError, naming the file, for what is missing, wrong or not known."""
    if file.suffix.lower() == ".csv":
        raise InputError(
            f"{file}: RealityCapture's table of angles is not read, as nobody says exactly what "
            f"they mean: export XMP beside the pictures, or {_WAY_OUT}"
        )
    files = [each for each in ordered(file.parent.glob(f"*{file.suffix}")) if claimed(each, claims)]
    told = {each: _told(each) for each in files}
    posed = [each for each in files if set(told[each]) >= _POSE]
    lost = [each.name for each in files if each not in posed]
    if not posed:
        raise InputError(f"{file}: no XMP file there holds Rotation and Position of a camera")
    parts = {told[each][_COMPONENT] for each in posed if _COMPONENT in told[each]}
    if len(parts) > 1:
        raise InputError(
            f"{file.parent}: its XMP files are of {len(parts)} components, whose poses share no "
            "world: remove those of earlier exports, or export one component"
        )
    cameras = [present(_camera, each, told[each], asked.root) for each in posed]
    found = [camera for camera in cameras if camera is not None]
    notes = [f"{file.parent}: {len(lost)} XMP files hold no pose, first {lost[0]}"] if lost else []
    return Capture(found, "RealityCapture", notes=notes)


def _told(file: Path) -> dict[str, str]:
    """What a file says of its picture's camera, by name. Raises InputError."""
    told = {}
    for element in load_xml(file, "XMP").iter():
        if element.tag.startswith(_SPACE):
            told[element.tag.removeprefix(_SPACE)] = element.text or ""
        for name, value in element.attrib.items():
            if name.startswith(_SPACE):
                told[name.removeprefix(_SPACE)] = value
    return told


def _camera(file: Path, told: dict[str, str], root: Path) -> Camera:
    def of(name: str, count: int = 1, otherwise: str = "0") -> list[float]:
        return words(told.get(name, otherwise), count, f"{file}: {name}")

    image = picture(file.parent, file.stem, str(file))
    width, height = size(image)
    side = max(width, height)
    if "FocalLength35mm" not in told:
        raise InputError(f"{file}: has no FocalLength35mm")
    focal = of("FocalLength35mm")[0] / _FILM * side
    pose = np.eye(4)
    pose[:3, :3] = np.reshape(of("Rotation", 9), (3, 3)).T
    pose[:3, 3] = of("Position", 3)
    return Camera(
        name=name_of(image, root),
        image=image,
        width=width,
        height=height,
        fx=focal,
        fy=focal,
        cx=width / 2 + of("PrincipalPointU")[0] * side,
        cy=height / 2 + of("PrincipalPointV")[0] * side,
        lens=_lens(file, told, of),
        to_world=pose,
        described=str(file),
    )


def _lens(file: Path, told: dict[str, str], of) -> Lens:
    model = told.get("DistortionModel", "perspective")
    numbers = of("DistortionCoeficients", 6, "0 0 0 0 0 0")
    if model == "perspective" or not any(numbers):
        numbers = [0.0] * 6
    elif model not in _LENSES:
        raise InputError(
            f"{file}: DistortionModel {model}; valid: {', '.join(_LENSES)}: choose one in "
            f"RealityCapture (Alignment Settings > Advanced), align and export anew, or {_WAY_OUT}"
        )
    if of("Skew")[0] != 0 or of("AspectRatio", 1, "1")[0] != 1:
        raise InputError(f"{file}: Skew is not 0 or AspectRatio not 1: {_WAY_OUT}")
    first, second = numbers[4:] if model.endswith("t2") else (0.0, 0.0)
    return Lens(radial=tuple(numbers[:4]), tangential=(second, first))
