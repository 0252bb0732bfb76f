"""glTF as trimesh reads it, but for what it leaves away.

trimesh has texture coordinates only of what has a material, and whole numbers that stand for 0 to
1 (``normalized``) as they stand. Attributes whose names begin with an underscore it hands on: so
these stand there once more, and are set in afterwards. It takes URIs for names of files.
"""

from __future__ import annotations

import io
import json
import os
import struct
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import unquote

import numpy as np

_PLACES, _TEXTURE = "POSITION", "TEXCOORD_0"
MOVED = "isas: moved"  # among a scene's metadata
_OWN = "_ISAS_"  # before the names of what stands once more
_FLOAT = 5126
_MAGIC, _JSON = b"glTF", b"JSON"
# What packs a mesh so that trimesh has zeros in its place, and what it would unpack it by.
_PACKED = {
    "KHR_draco_mesh_compression": ("Draco", "DracoPy"),
    "EXT_meshopt_compression": ("meshopt", None),
    "KHR_meshopt_compression": ("meshopt", None),
}


def load(file: Path):
    """The scene of a GLB or glTF file. Raises whatever trimesh raises, and ValueError for what is
    no such file, or compressed."""
    import trimesh

    data, binary = file.read_bytes(), file.suffix.lower() == ".glb"
    text = _chunk(data) if binary else data
    tree = json.loads(text)
    for name in tree.get("extensionsRequired", []):
        how, by = _PACKED.get(name, (None, None))
        if how is not None and (by is None or find_spec(by) is None):
            raise ValueError(f"is compressed by {how}: export it without compression")
    for mesh in tree.get("meshes", []):
        for primitive in mesh["primitives"]:
            _mark(primitive["attributes"], tree["accessors"])
    moved = _moved(tree)
    for each in (*tree.get("buffers", []), *tree.get("images", [])):
        if "uri" in each:
            each["uri"] = _file(file.parent, each["uri"])
    changed = json.dumps(tree).encode()
    if binary:
        changed += b" " * (-len(changed) % 4)
        rest = data[20 + len(text) :]
        head = struct.pack(
            "<4sIII4s", _MAGIC, 2, 20 + len(changed) + len(rest), len(changed), _JSON
        )
        changed = head + changed + rest
    scene = trimesh.load_scene(
        io.BytesIO(changed),
        file_type=file.suffix[1:].lower(),
        process=False,
        resolver=trimesh.resolvers.FilePathResolver(str(file)),
    )
    scene.metadata[MOVED] = moved
    return scene


def _moved(tree: dict) -> list[str]:
    """The materials whose pictures do not lie by texture coordinates as these stand. Raises
    ValueError where these mean nothing otherwise."""
    found = {}
    for mesh in tree.get("meshes", []):
        for primitive in mesh["primitives"]:
            if "material" not in primitive:
                continue
            material = tree["materials"][primitive["material"]]
            picture = material.get("pbrMetallicRoughness", {}).get("baseColorTexture", {})
            told = picture.get("extensions", {}).get("KHR_texture_transform", {})
            turned = told.get("offset", [0, 0]) != [0, 0] or told.get("scale", [1, 1]) != [1, 1]
            if not (turned or told.get("rotation", 0) or picture.get("texCoord", 0)):
                continue
            name = material.get("name", "without a name")
            at = primitive["attributes"].get(_TEXTURE)
            if turned and at is not None and tree["accessors"][at]["componentType"] != _FLOAT:
                raise ValueError(
                    f"texture coordinates of material {name} are whole numbers that "
                    "KHR_texture_transform makes places of: export it without quantization"
                )
            found[name] = None
    return list(found)


def _chunk(data: bytes) -> bytes:
    """The JSON in a GLB file. Raises ValueError."""
    if len(data) < 20 or data[:4] != _MAGIC or data[16:20] != _JSON:
        raise ValueError("is no GLB file of glTF 2.0")
    (length,) = struct.unpack("<I", data[12:16])
    return data[20 : 20 + length]


def _file(folder: Path, uri: str) -> str:
    """The name of a URI's file, whose blanks are %20 and the like, unless one is called so."""
    as_it_is = uri.startswith("data:") or os.path.isfile(folder / uri)
    return uri if as_it_is else unquote(uri)


def _mark(attributes: dict, accessors: list[dict]) -> None:
    for name in {_PLACES, _TEXTURE} & set(attributes):
        told = accessors[attributes[name]]
        if told.get("normalized") or (name == _TEXTURE and told["componentType"] == _FLOAT):
            attributes[_OWN + name] = attributes[name]


def given(mesh) -> np.ndarray | None:
    """The texture coordinates ``(V, 2)`` of a mesh, v upwards, that trimesh would not have, or
    None; what it has of places is put right."""
    found = {
        name: _real(np.asarray(values))
        for name in (_PLACES, _TEXTURE)
        if (values := mesh.vertex_attributes.get(_OWN + name)) is not None
    }
    if _PLACES in found:
        mesh.vertices = found[_PLACES]
    if _TEXTURE not in found:
        return None
    return found[_TEXTURE] * [1, -1] + [0, 1]


def _real(values: np.ndarray) -> np.ndarray:
    """Of whole numbers the shares of the largest that they stand for."""
    if values.dtype.kind not in "iu":
        return values
    return np.maximum(values / np.iinfo(values.dtype).max, -1.0)
