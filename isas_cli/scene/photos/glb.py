"""glTF as trimesh reads it, but for what it leaves away.

trimesh has texture coordinates only of what has a material, and whole numbers that stand for 0 to
1 (``normalized``) as they stand. Attributes whose names begin with an underscore it hands on: so
these stand there once more, and are set in afterwards. It takes URIs for names of files, and drops
the first camera with all that hangs on it.
"""

from __future__ import annotations

import io
import json
import os
import re
import struct
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import unquote

import numpy as np

_PLACES, _TEXTURE = "POSITION", "TEXCOORD_0"
MOVED, POSED = "isas: moved", "isas: posed"  # among a scene's metadata
_OWN = "_ISAS_"  # before the names of what stands once more
_FLOAT = 5126
_TRIANGLES, _FAN = 4, 6  # modes: below are points and lines
_MAGIC, _JSON = b"glTF", b"JSON"
# What packs a mesh so that trimesh has zeros in its place, and what it would unpack it by.
_PACKED = {
    "KHR_draco_mesh_compression": ("Draco", "DracoPy"),
    "EXT_meshopt_compression": ("meshopt", None),
    "KHR_meshopt_compression": ("meshopt", None),
}
# Extensions without which triangles are where they are, and one whose numbers are read here.
_ASIDE = re.compile(
    "_(materials|texture|lights|animation|xmp|techniques|packing)|^KHR_mesh_quantization$"
)


def load(file: Path):
    """The scene of a GLB or glTF file. Raises whatever trimesh raises, and ValueError for what is
    no such file, compressed, or would be read as less or other than it is."""
    import trimesh

    data, binary = file.read_bytes(), file.suffix.lower() == ".glb"
    text = _chunk(data) if binary else data
    tree = json.loads(text)
    for name in tree.get("extensionsRequired", []):
        if name in _PACKED and not _unpacked(name):
            how, _ = _PACKED[name]
            raise ValueError(f"is compressed by {how}: export it without compression")
        if name not in _PACKED and not _ASIDE.search(name):
            raise ValueError(f"needs {name}, which is not read: export it without")
    for mesh in tree.get("meshes", []):
        every = mesh["primitives"]
        mesh["primitives"] = [p for p in every if p.get("mode", _TRIANGLES) >= _TRIANGLES]
        for primitive in mesh["primitives"]:
            _check(primitive, tree["accessors"])
            _mark(primitive["attributes"], tree["accessors"])
    told = {MOVED: _moved(tree), POSED: _posed(tree)}
    _pare(tree)
    for each in tree.get("buffers", []):
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
        resolver=_Files(file.parent),
    )
    scene.metadata.update(told)
    return scene


class _Files:
    """Those that a glTF file names, also above its ``folder`` or behind links, where trimesh's own
    does not look; of a name that leads nowhere, what is called so beside it. Windows parts names by
    backslashes."""

    def __init__(self, folder: Path):
        self._folder = folder

    def __getitem__(self, name: str) -> bytes:
        file = self._folder / name.replace("\\", "/")
        beside = self._folder / file.name
        return (beside if beside.is_file() and not file.is_file() else file).read_bytes()


def _unpacked(extension: str) -> bool:
    """Whether trimesh can unpack what an extension packs."""
    _, by = _PACKED.get(extension, (None, None))
    return by is not None and find_spec(by) is not None


def _check(primitive: dict, accessors: list[dict]) -> None:
    """Raises ValueError for triangles that trimesh leaves out, or has zeros in place of."""
    if primitive.get("mode") == _FAN:
        raise ValueError("has triangle fans: export triangles")
    attributes = primitive["attributes"]
    used = attributes[_PLACES], attributes.get(_TEXTURE), primitive.get("indices")
    held = [accessors[at] for at in used if at is not None]
    if any("sparse" in each for each in held):
        raise ValueError("has sparse accessors: export it without")
    unpacked = any(map(_unpacked, primitive.get("extensions", {})))
    if not unpacked and any("bufferView" not in each for each in held):
        raise ValueError("is compressed: export it without compression")


def _posed(tree: dict) -> bool:
    """Whether bones or shape keys move any mesh."""
    meshes = tree.get("meshes", [])
    shown = [node for node in tree.get("nodes", []) if "mesh" in node]
    weights = [node.get("weights", meshes[node["mesh"]].get("weights", [])) for node in shown]
    return any("skin" in node for node in shown) or any(map(any, weights))


def _pare(tree: dict) -> None:
    """Takes out cameras, meshes without triangles, which trimesh trips over where others hang on
    them, and of materials all but their names."""
    for name in ("cameras", "images", "textures"):
        tree.pop(name, None)
    for node in tree.get("nodes", []):
        node.pop("camera", None)
        if "mesh" in node and not tree["meshes"][node["mesh"]]["primitives"]:
            del node["mesh"]
    materials = tree.get("materials", [])
    # A number by which trimesh tells apart those of one name.
    tree["materials"] = [
        {"name": each.get("name"), "alphaCutoff": materials.index(each)} for each in materials
    ]


def _moved(tree: dict) -> list[str]:
    """The materials whose pictures do not lie by texture coordinates as these stand. Raises
    ValueError where these mean nothing otherwise."""
    found = {}
    for mesh in tree.get("meshes", []):
        for primitive in mesh["primitives"]:
            if "material" not in primitive:
                continue
            material = tree["materials"][primitive["material"]]
            gloss = material.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness", {})
            picture = (
                gloss.get("diffuseTexture")
                or material.get("pbrMetallicRoughness", {}).get("baseColorTexture")
                or material.get("normalTexture", {})
            )
            told = picture.get("extensions", {}).get("KHR_texture_transform", {})
            turned = told.get("offset", [0, 0]) != [0, 0] or told.get("scale", [1, 1]) != [1, 1]
            layer = told.get("texCoord", picture.get("texCoord", 0))
            if not (turned or told.get("rotation", 0) or layer):
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
