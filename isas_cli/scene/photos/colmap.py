"""COLMAP's model: `cameras.txt`, `images.txt` and `points3D.txt`, or the same in binary.

Poses go from world to camera, as a quaternion and a translation; the camera's axes are x right,
y down, z forward, and pixels count from the picture's corner. Binary models are turned into text by
``pycolmap`` (``pip install '.[photos]'``).
"""

from __future__ import annotations

import os
import re
import tempfile
from pathlib import Path

import numpy as np

from ...runtime.errors import InputError
from .base import Capture, number, read_text, whole
from .camera import Camera
from .finding import picture, present

# Model → what its parameters are; f is both fx and fy.
_MODELS = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
}
_PLACES = ("", "sparse/0", "sparse", "colmap/sparse/0", "colmap")


def find(folder: Path) -> Path | None:
    for ending in ("txt", "bin"):
        for place in _PLACES:
            file = folder / place / f"cameras.{ending}"
            if file.is_file():
                return file
    return None


def read(file: Path, root: Path) -> Capture:
    """``root``: the folder given, in which the pictures are looked for. Raises InputError."""
    if file.suffix == ".txt":
        return _read(file, root)
    try:
        import pycolmap
    except ImportError:
        raise InputError(
            f"{file}: binary models are read through pycolmap: pip install pycolmap, or convert it "
            "by colmap model_converter --output_type TXT"
        ) from None
    with tempfile.TemporaryDirectory() as folder:
        try:
            pycolmap.Reconstruction(str(file.parent)).write_text(folder)
        except (RuntimeError, ValueError, OSError) as error:
            told = " ".join(str(error).split())
            raise InputError(f"{file}: pycolmap cannot read the model: {told}") from error
        try:
            return _read(Path(folder) / "cameras.txt", root, str(file))
        except InputError as error:  # names the user's files, not those that they were turned into
            told = str(error).replace(folder, str(file.parent))
            raise InputError(re.sub(r"\.txt(:\d+)?\b", ".bin", told)) from error


def _read(file: Path, root: Path, called: str = "") -> Capture:
    called = called or str(file)
    lenses = {}
    for where, words in _lines(file):
        if len(words) < 4:
            raise InputError(f"{where}: a camera is ID, MODEL, WIDTH, HEIGHT and its parameters")
        lenses[words[0]] = _lens(words[1], words[2:], where)
    file = file.with_name("images.txt")
    if not file.is_file():
        raise InputError(f"{called}: images.txt is missing beside it")
    places = _points(file.with_name("points3D.txt"))
    order = {name: index for index, name in enumerate(places)}
    cameras, observed = [], {}
    for where, words, found in _images(file):
        camera = present(_camera, where, words, lenses, root, called)
        if camera is None:
            continue
        cameras.append(camera)
        known = [(order[p], x, y) for x, y, p in found if p in order]
        if known:
            table = np.array(known, np.float64)
            observed[camera.name] = table[:, 0].astype(int), table[:, 1:]
    if not cameras:
        raise InputError(f"{called}: images.txt lists no image")
    points = np.array(list(places.values())) if places else None
    return Capture(cameras, "COLMAP", points, observed)


def _lines(file: Path):
    for number_, line in enumerate(read_text(file).splitlines(), 1):
        if line.strip() and not line.startswith("#"):
            yield f"{file}:{number_}", line.split()


def _lens(model: str, words: list[str], where: str) -> dict:
    if model not in _MODELS:
        raise InputError(f"{where}: camera model {model}; valid: {', '.join(_MODELS)}")
    names = _MODELS[model]
    width, height = (whole(word, f"{where}: size") for word in words[:2])
    if len(words) - 2 != len(names):
        raise InputError(f"{where}: {model} has {len(names)} parameters: {', '.join(names)}")
    values = {name: number(word, f"{where}: {name}") for name, word in zip(names, words[2:])}
    f = values.get("f", 0.0)
    return {
        "width": width,
        "height": height,
        "fx": values.get("fx", f),
        "fy": values.get("fy", f),
        "cx": values["cx"],
        "cy": values["cy"],
        "radial": (values.get("k1", 0.0), values.get("k2", 0.0), 0.0, 0.0),
        "tangential": (values.get("p1", 0.0), values.get("p2", 0.0)),
    }


def _images(file: Path):
    """Of every image: where it stands, its ten words, and [(x, y, id of a point), …]. Each takes
    two lines, the second of which may be empty."""
    lines = enumerate(read_text(file).splitlines(), 1)
    kept = [(n, line) for n, line in lines if not line.startswith("#")]
    while kept and not kept[0][1].strip():
        kept.pop(0)
    for (n, line), (_, second) in zip(kept[::2], [*kept[1::2], (0, "")]):
        where, words = f"{file}:{n}", line.split(maxsplit=9)
        if not words:
            continue
        if len(words) != 10:
            raise InputError(f"{where}: an image is ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA, NAME")
        rest = second.split()
        triples = zip(*(rest[i::3] for i in range(3)))
        found = [(number(x, where), number(y, where), p) for x, y, p in triples]
        yield where, words, found


def _camera(where: str, words: list[str], lenses: dict, root: Path, called: str) -> Camera:
    pose = [number(word, f"{where}: pose") for word in words[1:8]]
    quaternion = np.array(pose[:4])
    length = np.linalg.norm(quaternion)
    if not length > 1e-6:
        raise InputError(f"{where}: its quaternion is 0, 0, 0, 0")
    to_camera = np.eye(4)
    to_camera[:3, :3] = _rotation(quaternion / length)
    to_camera[:3, 3] = pose[4:]
    if words[8] not in lenses:
        raise InputError(f"{where}: camera {words[8]} is not in cameras.txt")
    name = words[9].strip()
    places = (root / each for each in ("images", ""))
    folder = next((place for place in places if os.path.isfile(place / name)), root)
    masks = (root / "masks" / f"{name}.png", root / "masks" / Path(name).with_suffix(".png"))
    return Camera(
        name=name,
        image=picture(folder, name, where),
        mask=next((mask for mask in masks if os.path.isfile(mask)), None),
        to_world=np.linalg.inv(to_camera),
        described=called,
        **lenses[words[8]],
    )


def _rotation(quaternion: np.ndarray) -> np.ndarray:
    """Of a unit quaternion w, x, y, z."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def _points(file: Path) -> dict[str, np.ndarray]:
    """Places by id; none where the file is missing."""
    if not file.is_file():
        return {}
    found = {}
    for where, words in _lines(file):
        if len(words) < 4:
            raise InputError(f"{where}: a point is ID, X, Y, Z, …")
        found[words[0]] = np.array([number(word, where) for word in words[1:4]])
    return found
