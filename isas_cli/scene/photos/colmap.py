"""COLMAP's model: `cameras.txt`, `images.txt` and `points3D.txt`, or the same in binary.

Poses go from world to camera, as a quaternion and a translation; the camera's axes are x right,
y down, z forward, and pixels count from the picture's corner. Where `rigs.txt` and `frames.txt`
stand beside them (COLMAP 3.12 and later), poses are of frames, as COLMAP itself reads them: those
in `images.txt` do not count. Binary models are turned into text by ``pycolmap``
(the extra ``photos``).
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ...runtime.errors import InputError, installing
from . import layouts, models
from .base import Asked, Capture, number, read_text, whole
from .finding import present, viewed

# Of a quaternion and a translation: how far images.txt may differ from frames.txt in silence.
_SAME = 1e-4


@dataclass(frozen=True)
class _Model:
    """``folder``: with the text files; ``called``: the user's own, for messages; ``binary``:
    whether that is binary, so that its lines have no numbers."""

    folder: Path
    called: Path
    binary: bool = False

    def name(self, name: str) -> str:
        """Of a file of the model, as the user has it."""
        return str(self.called / f"{name}.{'bin' if self.binary else 'txt'}")

    def has(self, name: str) -> bool:
        return (self.folder / f"{name}.txt").is_file()

    def numbered(self, name: str) -> list[tuple[str, str]]:
        """Of a file, each line that is no comment: where it is, and its text, perhaps empty."""
        text = read_text(self.folder / f"{name}.txt").splitlines()
        found = [(n, line.strip()) for n, line in enumerate(text, 1)]
        return [(self.where(name, n, line), line) for n, line in found if not line.startswith("#")]

    def where(self, name: str, line: int, text: str) -> str:
        number_ = f": entry {text.split(maxsplit=1)[0]}" if text else ""
        return f"{self.name(name)}{number_}" if self.binary else f"{self.name(name)}:{line}"

    def lines(self, name: str) -> Iterator[tuple[str, list[str]]]:
        """Those that are not empty, in words."""
        return ((where, line.split()) for where, line in self.numbered(name) if line)


_IMAGES, _POINTS = "images.bin", "points3D.bin"
# The heads of a table that Metashape and others write, too, in a cameras.txt.
_ANGLES = re.compile(r"^#.*omega.*phi.*kappa", re.IGNORECASE | re.MULTILINE)


def claims(file: Path) -> bool:
    return file.name in ("cameras.txt", "cameras.bin")


def find(folder: Path) -> Path | None:
    """The cameras of the model with the most images of those in the first place that has any."""
    return layouts.chosen(folder)[0]


def foreign(file: Path) -> bool:
    """Whether it is a table of places and angles."""
    return file.suffix == ".txt" and _ANGLES.search(read_text(file)) is not None


def read(file: Path, asked: Asked) -> Capture:
    """Raises InputError, naming the file and the line, for what is missing or wrong."""
    if foreign(file):
        raise InputError(
            f"{file}: is no COLMAP file but a table of angles (Omega, Phi, Kappa), which is not "
            "read: of Metashape take the XML (File > Export > Export Cameras)"
        )
    if file.suffix == ".txt":
        return _read(_Model(file.parent, file.parent), asked)
    try:
        import pycolmap
    except ImportError:
        raise InputError(
            f"{file}: binary models are read through pycolmap: {installing('pycolmap')}, or "
            "convert it by colmap model_converter --output_type TXT"
        ) from None
    with tempfile.TemporaryDirectory() as folder:
        try:
            pycolmap.Reconstruction(str(_with_points(file.parent, folder))).write_text(folder)
        except (RuntimeError, ValueError, IndexError, OSError) as error:
            told = " ".join(str(error).split())
            raise InputError(f"{file}: pycolmap cannot read the model: {told}") from error
        return _read(_Model(Path(folder), file.parent, binary=True), asked)


def _with_points(model: Path, made: str) -> Path:
    """A binary model's folder, or where it lacks its points, without which pycolmap reads none, one
    below ``made`` that has none of them."""
    if (model / _POINTS).is_file():
        return model
    folder = Path(made) / "model"
    folder.mkdir()
    for file in model.glob("*.bin"):
        if file.name == _IMAGES:  # must not name points that are not there
            (folder / _IMAGES).write_bytes(_unobserved(file.read_bytes()))
        else:
            (folder / file.name).symlink_to(file.resolve())
    (folder / _POINTS).write_bytes(bytes(8))  # how many there are
    return folder


def _unobserved(content: bytes) -> bytes:
    """An images.bin without what its images have found of points."""
    count, at, kept = int.from_bytes(content[:8], "little"), 8, [content[:8]]
    for _ in range(count):
        end = content.index(b"\0", at + 64) + 1  # number, pose and camera, then the name
        kept += [content[at:end], bytes(8)]
        at = end + 8 + 24 * int.from_bytes(content[end : end + 8], "little")
    return b"".join(kept)


def _read(model: _Model, asked: Asked) -> Capture:
    root, lenses = asked.root, {}
    for where, words in model.lines("cameras"):
        if len(words) < 4:
            raise InputError(f"{where}: a camera is ID, MODEL, WIDTH, HEIGHT and its parameters")
        lenses[words[0]] = _lens(words[1], words[2:], where)
    if not model.has("images"):
        raise InputError(f"{model.name('cameras')}: images.txt is missing beside it")
    frames = _frames(model)
    places = _points(model)
    order = {name: index for index, name in enumerate(places)}
    folders = layouts.pictures(model.called, root)
    cameras, observed, moved, listed = [], {}, 0, False
    for where, words, found in _images(model):
        listed = True
        pose = _pose(words[1:8], where)
        if frames is not None:
            told, pose = pose, _of_frame(frames, words, where)
            moved += not np.allclose(told, pose, atol=_SAME * max(1, np.abs(pose).max()))
        if words[8] not in lenses:
            raise InputError(f"{where}: camera {words[8]} is not in cameras.txt")
        name, inner, file = words[9].strip(), lenses[words[8]], model.name("images")
        camera = present(viewed, name, folders, np.linalg.inv(pose), inner, file, where)
        if camera is None:
            continue
        cameras.append(camera)
        known = [(order[p], x, y) for x, y, p in found if p in order]
        if known:
            table = np.array(known, np.float64)
            observed[camera.name] = table[:, 0].astype(int), table[:, 1:]
    if not listed:
        raise InputError(f"{model.name('cameras')}: images.txt lists no image")
    points = np.array(list(places.values())) if places else None
    notes = [] if asked.named else layouts.notes(model.called, root)
    if moved:
        notes.append(
            f"{model.name('images')}: poses of {moved} images differ from those of rigs.txt and "
            "frames.txt, which COLMAP takes, and so does isas"
        )
    return Capture(cameras, "COLMAP", points, observed, notes=notes)


def _lens(model: str, words: list[str], where: str) -> dict:
    if model not in models.PARAMETERS:
        valid = ", ".join(models.PARAMETERS)
        raise InputError(f"{where}: camera model {model}; valid: {valid}; {models.WAY_OUT}")
    names = models.PARAMETERS[model].split()
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
        "lens": models.lens(model, values),
    }


def _images(model: _Model):
    """Of every image: where it stands, its ten words, and [(x, y, id of a point), …]. Each takes
    two lines, the second of which may be empty; empty lines before the first are skipped."""
    lines = iter(model.numbered("images"))
    for where, line in lines:
        if not line:
            continue
        words = line.split(maxsplit=9)
        if len(words) != 10:
            raise InputError(f"{where}: an image is ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA, NAME")
        below_it, second = next(lines, (where, ""))
        rest = second.split()
        if len(rest) % 3:
            raise InputError(
                f"{below_it}: of an image's second line, which is empty or its points X, Y, ID: "
                f"{len(rest)} words, no multiple of 3"
            )
        triples = zip(*(rest[i::3] for i in range(3)))
        found = [(number(x, below_it), number(y, below_it), p) for x, y, p in triples]
        yield where, words, found


def _pose(words: list[str], where: str) -> np.ndarray:
    """``(4, 4)``, to the camera or rig, of QW, QX, QY, QZ, TX, TY, TZ."""
    w, x, y, z, *place = (number(word, f"{where}: pose") for word in words)
    if not np.linalg.norm([w, x, y, z]) > 1e-6:
        raise InputError(f"{where}: its quaternion is 0, 0, 0, 0")
    found = np.eye(4)
    found[:3, :3] = Rotation.from_quat([x, y, z, w]).as_matrix()
    found[:3, 3] = place
    return found


def _frames(model: _Model) -> dict[str, tuple[np.ndarray, dict]] | None:
    """Of each image's number: its frame's pose and, of the sensors of its rig, theirs (None:
    unknown); None for models without frames."""
    if not (model.has("rigs") and model.has("frames")):
        return None
    rigs = {}
    for where, words in model.lines("rigs"):
        if len(words) < 2:
            raise InputError(f"{where}: a rig is ID, NUM_SENSORS and its sensors")
        sensors = {tuple(words[2:4]): np.eye(4)}
        rest = words[4:]
        while rest:
            known = rest[2:3] == ["1"]
            if len(rest) < (10 if known else 3):
                raise InputError(f"{where}: a sensor is TYPE, ID, HAS_POSE and, where 1, its pose")
            sensors[tuple(rest[:2])] = _pose(rest[3:10], where) if known else None
            rest = rest[10 if known else 3 :]
        rigs[words[0]] = sensors
    found = {}
    for where, words in model.lines("frames"):
        if len(words) < 10 or words[1] not in rigs:
            raise InputError(f"{where}: a frame is ID, RIG of rigs.txt, its pose, its images")
        pose = _pose(words[2:9], where)
        for kind, _, image in zip(*(words[10 + i :: 3] for i in range(3))):
            if kind == "CAMERA":
                found[image] = pose, rigs[words[1]]
    return found


def _of_frame(frames: dict, words: list[str], where: str) -> np.ndarray:
    if words[0] not in frames:
        raise InputError(f"{where}: image {words[0]} is in no frame of frames.txt")
    pose, sensors = frames[words[0]]
    sensor = sensors.get(("CAMERA", words[8]))
    if sensor is None:
        raise InputError(f"{where}: rigs.txt has no pose of camera {words[8]} in its rig")
    return sensor @ pose


def _points(model: _Model) -> dict[str, np.ndarray]:
    """Places by id; none where the file is missing."""
    if not model.has("points3D"):
        return {}
    found = {}
    for where, words in model.lines("points3D"):
        if len(words) < 4:
            raise InputError(f"{where}: a point is ID, X, Y, Z, …")
        found[words[0]] = np.array([number(word, where) for word in words[1:4]])
    return found
