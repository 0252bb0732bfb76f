"""OpenCV's FileStorage, YAML or XML, and ROS' camera files: the same contents as `cameras.json`.

``calibrate.py`` and others write ``image_width``, ``image_height``, ``camera_matrix``,
``distortion_coefficients`` and ``extrinsic_parameters``, but not the names of the pictures: these
are asked for, as ``images``. OpenCV up to 4 begins its YAML by "%YAML:1.0", which no library for
YAML reads; OpenCV 5 by "%YAML 1.2".
"""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from xml.etree import ElementTree

import yaml

from ...runtime.errors import InputError
from . import ours
from .base import Asked, Capture, claimed, lone, read_text
from .finding import ordered

_YAML, _XML = (".yml", ".yaml"), ".xml"
# What tells such a file from others of its ending.
_WORD, _ROOT = "camera_matrix", "opencv_storage"
# What lists pictures.
_LISTS = re.compile(r"<(?:views|images)\b|^\s*(?:views|images)\s*:", re.MULTILINE)


class _Loader(yaml.SafeLoader):
    """YAML with OpenCV's matrices as plain mappings."""


_Loader.add_constructor(
    "tag:yaml.org,2002:opencv-matrix",
    lambda loader, node: loader.construct_mapping(node, deep=True),
)


def claims(file: Path) -> bool:
    if file.suffix.lower() in _YAML:
        return True
    return file.suffix.lower() == _XML and _ROOT in read_text(file)[:1000]


def find(folder: Path) -> Path | None:
    """Raises InputError for several."""
    found = [
        file
        for file in ordered(folder.iterdir())
        if file.suffix.lower() in (*_YAML, _XML) and file.is_file() and claimed(file, _likely)
    ]
    listing = [file for file in found if not foreign(file)]
    return lone(folder, listing or found[:1], "files with a camera_matrix")


def foreign(file: Path) -> bool:
    """Whether it is a camera's calibration alone, which names no pictures."""
    return _LISTS.search(read_text(file)) is None


def _likely(file: Path) -> bool:
    return _WORD in read_text(file) and claims(file)


def read(file: Path, asked: Asked) -> Capture:
    """Raises InputError, naming file and view, for what is missing or wrong."""
    text = read_text(file)
    try:
        found = _of_xml(text) if file.suffix.lower() == _XML else _of_yaml(text)
    except (yaml.YAMLError, ElementTree.ParseError, RecursionError, ValueError) as error:
        told = " ".join(str(error).split())
        raise InputError(f"{file}: cannot be read as OpenCV's storage: {told}") from error
    if not isinstance(found, dict) or _WORD not in found:
        raise InputError(f"{file}: holds no camera_matrix, which OpenCV's calibration does")
    return ours.of(file, found)


def _of_yaml(text: str):
    if text.startswith("%YAML"):
        text = text.partition("\n")[2]
    return yaml.load(text, _Loader)  # a SafeLoader with one tag more


def _of_xml(text: str):
    return _node(ElementTree.fromstring(text))


def _node(element: ElementTree.Element):
    """A node as the same would be in YAML."""
    kind = element.get("type_id", "")
    if kind == "opencv-matrix":
        words = (element.findtext("data") or "").split()
        sizes = {name: element.findtext(name) for name in ("rows", "cols")}
        return {**sizes, "data": [float(word) for word in words]}
    children = list(element)
    if children and all(child.tag == "_" for child in children):
        return [_node(child) for child in children]
    if children:
        return {child.tag: _node(child) for child in children}
    words = shlex.split(element.text or "")
    return words[0] if len(words) == 1 else words
