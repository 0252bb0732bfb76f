"""Agisoft Metashape's cameras (File > Export > Export Cameras, XML).

The formulas are those of its manual (2.1, appendix on camera models): u = w/2 + cx + x' f + x' B1 +
y' B2, v = h/2 + cy + y' f, pixels from the picture's corner, and Brown's lens with P1 and P2 the
other way round than OpenCV's. A camera's ``transform`` goes from camera (x right, y down,
z forward) to chunk; the ``transform`` of its component or chunk from there to the world in which
Metashape exports meshes.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from ...runtime.errors import InputError
from . import layouts
from .base import Asked, Capture, claimed, load_xml, lone, matrix, number, read_text, whole, words
from .finding import ordered, present, viewed
from .lens import Lens

_TYPES = {"frame": "flat", "fisheye": "fisheye"}
_WAY_OUT = "export cameras for COLMAP instead"
# Of a reference system that is no place on Earth.
_LOCAL = "LOCAL_CS"


def claims(file: Path) -> bool:
    if file.suffix.lower() != ".xml":
        return False
    begin = read_text(file)[:2000]
    return "<document" in begin and "<chunk" in begin


def find(folder: Path) -> Path | None:
    """Raises InputError for several."""
    found = [file for file in ordered(folder.glob("*.xml")) if claimed(file, claims)]
    return lone(folder, found, "cameras of Metashape")


def read(file: Path, asked: Asked) -> Capture:
    """Raises InputError, naming sensor or camera, for what is missing, wrong or not known."""
    chunks = load_xml(file).findall("chunk")
    if len(chunks) != 1:
        raise InputError(f"{file}: holds {len(chunks)} chunks: export the cameras of one")
    chunk = chunks[0]
    sensors = {each.get("id"): each for each in chunk.findall("sensors/sensor")}
    worlds = {each.get("id"): each.find("transform") for each in chunk.iter("component")}
    folders = layouts.pictures(file.parent, asked.root)
    cameras, lost, rigged, beside, aligned = [], [], [], [], 0
    active = _active(chunk)
    for each in chunk.iter("camera"):
        label = each.get("label", "")
        if each.find("transform") is None or each.get("enabled") in ("false", "0"):
            (rigged if each.get("master_id") is not None else lost).append(label)
            continue
        if active is not None and each.get("component_id") != active:
            beside.append(label)
            continue
        where = f"{file}: camera {label}"
        if each.get("sensor_id") not in sensors:
            raise InputError(f"{where}: its sensor {each.get('sensor_id')} is not in the file")
        world = worlds.get(each.get("component_id"))
        world = chunk.find("transform") if world is None else world
        if world is not None and not chunk.findtext("reference", _LOCAL).startswith(_LOCAL):
            raise InputError(
                f"{file}: its cameras lie on the Earth: in Metashape's Reference pane take Local "
                f"Coordinates, export mesh and cameras anew, or {_WAY_OUT}"
            )
        aligned += 1
        pose = partial(_pose, each, world, where)
        inner = partial(_inner, sensors[each.get("sensor_id")], where)
        camera = present(viewed, label, folders, pose, inner, file, where)
        if camera is not None:
            cameras.append(camera)
    if not aligned:
        raise InputError(f"{file}: no camera has a pose: align the photos in Metashape first")
    notes = []
    if lost:
        notes = [f"{file}: {len(lost)} cameras are not aligned or disabled, first {lost[0]}"]
    if beside:
        notes.append(
            f"{file}: {len(beside)} cameras, first {beside[0]}, are of another component than the "
            "active one, in a world of its own: left out"
        )
    if rigged:
        notes.append(
            f"{file}: {len(rigged)} cameras, first {rigged[0]}, hang on others in a rig, which is "
            f"not read: they are left out; {_WAY_OUT}"
        )
    return Capture(cameras, "Metashape", notes=notes)


def _active(chunk: ElementTree.Element) -> str | None:
    """The component that counts, where cameras are of several."""
    posed = [each for each in chunk.iter("camera") if each.find("transform") is not None]
    if len({each.get("component_id") for each in posed}) < 2:
        return None
    components = chunk.find("components")
    return None if components is None else components.get("active_id")


def _numbers(element: ElementTree.Element, path: str, count: int, where: str) -> list[float]:
    return words(element.findtext(path, ""), count, f"{where}: {path}")


def _pose(camera: ElementTree.Element, world: ElementTree.Element | None, where: str) -> np.ndarray:
    """Camera to world, ``(4, 4)``, without scale."""
    rows = np.reshape(_numbers(camera, "transform", 16, where), (4, 4))
    found = matrix(rows, f"{where}: transform").copy()
    if world is not None:
        turn, place, scale = np.eye(3), np.zeros(3), 1.0
        if world.find("rotation") is not None:
            turn = np.reshape(_numbers(world, "rotation", 9, where), (3, 3))
        if world.find("translation") is not None:
            place = np.array(_numbers(world, "translation", 3, where))
        if world.find("scale") is not None:
            (scale,) = _numbers(world, "scale", 1, where)
        found[:3, 3] = scale * turn @ found[:3, 3] + place
        found[:3, :3] = turn @ found[:3, :3]
    return found


def _inner(sensor: ElementTree.Element, where: str) -> dict:
    """Size, focal lengths, principal point and lens of a sensor."""
    found = sensor.findall("calibration")
    adjusted = [each for each in found if each.get("class") == "adjusted"]
    if not found:
        raise InputError(f"{where}: its sensor has no calibration")
    calibration = (adjusted or found)[0]
    kind = calibration.get("type", sensor.get("type", "frame"))
    if kind not in _TYPES:
        raise InputError(f"{where}: camera type {kind}; valid: {', '.join(_TYPES)}; {_WAY_OUT}")
    size = calibration.find("resolution")
    size = sensor.find("resolution") if size is None else size
    if size is None:
        raise InputError(f"{where}: its sensor has no resolution")
    width, height = (whole(size.get(name), f"{where}: {name}") for name in ("width", "height"))

    def of(name: str) -> float:
        return number(calibration.findtext(name, "0"), f"{where}: {name}")

    if calibration.find("f") is None:
        raise InputError(f"{where}: its calibration has no f, the focal length")
    if of("p3") or of("p4"):
        raise InputError(f"{where}: p3 or p4 of its lens is not 0, of PhotoScan: {_WAY_OUT}")
    fx = of("f") + of("b1")
    if not fx > 0:
        raise InputError(f"{where}: focal length {fx:g}: must be above 0")
    return {
        "width": width,
        "height": height,
        "fx": fx,
        "fy": of("f"),
        "cx": width / 2 + of("cx"),
        "cy": height / 2 + of("cy"),
        "lens": Lens(
            radial=tuple(of(f"k{n}") for n in range(1, 5)),
            tangential=(of("p2"), of("p1")),
            skew=of("b2") / fx,
            kind=_TYPES[kind],
        ),
    }
