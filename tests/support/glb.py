"""GLB files read by the letter of the glTF 2.0 specification, without the library that wrote them,
and what in them is against it."""

from __future__ import annotations

import io
import json
import struct
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from PIL import Image

from isas_cli.runtime import images

_TYPES = {5121: "<u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_SIZES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_REPEAT, _MIRROR, _CLAMP = 10497, 33648, 33071


@dataclass
class Part:
    """One primitive: ``attributes`` by name, ``faces (F, 3)``, and its material's description."""

    attributes: dict[str, np.ndarray]
    faces: np.ndarray
    material: dict


@dataclass
class Glb:
    path: Path
    header: tuple = ()
    chunks: list = field(default_factory=list)

    def __post_init__(self):
        content = self.path.read_bytes()
        self.header = (*struct.unpack_from("<4sII", content), len(content))
        at = 12
        while at < len(content):
            size, kind = struct.unpack_from("<I4s", content, at)
            self.chunks.append((kind, content[at + 8 : at + 8 + size]))
            at += 8 + size

    @cached_property
    def tree(self) -> dict:
        return json.loads(self.chunks[0][1])

    def accessor(self, number: int) -> np.ndarray:
        accessor = self.tree["accessors"][number]
        view = self.tree["bufferViews"][accessor["bufferView"]]
        kind, size = np.dtype(_TYPES[accessor["componentType"]]), _SIZES[accessor["type"]]
        first = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        stride = view.get("byteStride", kind.itemsize * size)
        shape, strides = (accessor["count"], size), (stride, kind.itemsize)
        return np.ndarray(shape, kind, self.chunks[1][1], first, strides).copy()

    def image(self, info: dict | None) -> np.ndarray | None:
        """The stored 8 bits of the picture that ``info`` of a material names, (H, W, C)."""
        if info is None:
            return None
        source = self.tree["images"][self.tree["textures"][info["index"]]["source"]]
        view = self.tree["bufferViews"][source["bufferView"]]
        first = view.get("byteOffset", 0)
        return np.array(Image.open(io.BytesIO(self.chunks[1][1][first:][: view["byteLength"]])))

    @cached_property
    def parts(self) -> dict[str, Part]:
        """By the names of nodes, none of which moves anything."""
        found = {}
        for node in self.tree["nodes"]:
            if "mesh" not in node:
                continue
            assert not {"matrix", "translation", "rotation", "scale"} & set(node)
            (each,) = self.tree["meshes"][node["mesh"]]["primitives"]
            attributes = {name: self.accessor(at) for name, at in each["attributes"].items()}
            faces = self.accessor(each["indices"]).reshape(-1, 3)
            found[node["name"]] = Part(attributes, faces, self.tree["materials"][each["material"]])
        return found

    def look_up(self, info: dict, uv: dict[str, np.ndarray], srgb: bool) -> np.ndarray:
        """What the picture shows at ``uv``, by the names of sets, each (n, 2): (n, C), linear."""
        texels = self.image(info) / 255.0
        if srgb:
            texels[..., :3] = images.srgb_decode(texels[..., :3])
        texture = self.tree["textures"][info["index"]]
        sampler = self.tree["samplers"][texture["sampler"]]
        sizes = np.array(texels.shape[1::-1])
        place = uv[f"TEXCOORD_{info.get('texCoord', 0)}"].astype(np.float64) * sizes
        wraps = sampler["wrapS"], sampler["wrapT"]
        if sampler["magFilter"] == 9728:
            column, row = (
                _wrapped(np.floor(place[:, axis]).astype(int), sizes[axis], wraps[axis])
                for axis in (0, 1)
            )
            return texels[row, column]
        low = np.floor(place - 0.5).astype(int)
        share = place - 0.5 - low
        found = 0
        for right in (0, 1):
            for down in (0, 1):
                weight = np.abs(1 - right - share[:, 0]) * np.abs(1 - down - share[:, 1])
                column = _wrapped(low[:, 0] + right, sizes[0], wraps[0])
                row = _wrapped(low[:, 1] + down, sizes[1], wraps[1])
                found = found + weight[:, None] * texels[row, column]
        return found


def _wrapped(index: np.ndarray, many: int, how: int) -> np.ndarray:
    if how == _CLAMP:
        return np.clip(index, 0, many - 1)
    if how == _MIRROR:
        index = index % (2 * many)
        return np.minimum(index, 2 * many - 1 - index)
    assert how == _REPEAT
    return index % many


def problems(path: Path) -> list[str]:
    """What in the file is against the specification, in words."""
    file, found = Glb(path), []

    def check(right, *words) -> None:
        if not right:
            found.append(" ".join(map(str, words)))

    magic, version, length, size = file.header
    check(magic == b"glTF" and version == 2 and length == size, "header", file.header)
    check([kind for kind, _ in file.chunks] == [b"JSON", b"BIN\0"], "chunks")
    check(all(len(content) % 4 == 0 for _, content in file.chunks), "chunks are not aligned")
    tree, binary = file.tree, file.chunks[1][1]
    check(tree["asset"]["version"] == "2.0", "asset")
    (buffer,) = tree["buffers"]
    check(0 <= len(binary) - buffer["byteLength"] <= 3, "buffer")
    for number, view in enumerate(tree["bufferViews"]):
        end = view.get("byteOffset", 0) + view["byteLength"]
        check(view.get("byteOffset", 0) % 4 == 0 and end <= len(binary), "view", number)
    for number, accessor in enumerate(tree["accessors"]):
        view = tree["bufferViews"][accessor["bufferView"]]
        values = file.accessor(number)
        need = accessor.get("byteOffset", 0) + values.nbytes
        check(need <= view["byteLength"], "accessor", number, "is longer than its view")
        check(np.isfinite(values).all(), "accessor", number, "holds numbers that are none")
        for name, own in (("min", values.min(axis=0)), ("max", values.max(axis=0))):
            check(np.array_equal(np.array(accessor[name], values.dtype), own), name, number)
    users: dict[int, set] = {}
    names = [each.get("name") for each in tree["meshes"]]
    check(len(set(names)) == len(names), "names of meshes", names)
    for mesh in tree["meshes"]:
        for each in mesh["primitives"]:
            found += _of_primitive(file, each, mesh["name"])
            for at in each["attributes"].values():
                users.setdefault(tree["accessors"][at]["bufferView"], set()).add(at)
    for view, accessors in users.items():
        stated = "byteStride" in tree["bufferViews"][view]
        check(len(accessors) == 1 or stated, "view", view, "is several's and has no stride")
    used = {name for each in tree["materials"] for name in each.get("extensions", {})}
    check(used == set(tree.get("extensionsUsed", [])), "extensionsUsed", used)
    for material in tree["materials"]:
        inside = material["pbrMetallicRoughness"]
        factors = inside["baseColorFactor"], inside["roughnessFactor"], inside["metallicFactor"]
        factors = np.hstack(factors)
        check(factors.min() >= 0 and factors.max() <= 1, "factors of", material["name"])
        check(material.get("alphaMode", "OPAQUE") in ("OPAQUE", "MASK", "BLEND"), "alphaMode")
    for each in tree.get("images", []):
        view = tree["bufferViews"][each["bufferView"]]
        check("byteStride" not in view and each["mimeType"] == "image/png", "image", each)
        check(binary[view.get("byteOffset", 0) :][:8] == b"\x89PNG\r\n\x1a\n", "image", each)
    roots = tree["scenes"][tree["scene"]]["nodes"]
    held = [child for node in tree["nodes"] for child in node.get("children", [])]
    check(sorted(roots + held) == list(range(len(tree["nodes"]))), "nodes")
    return found


def _of_primitive(file: Glb, each: dict, name: str) -> list[str]:
    found, tree = [], file.tree
    attributes = {key: file.accessor(at) for key, at in each["attributes"].items()}
    many = len(attributes["POSITION"])
    if any(len(values) != many for values in attributes.values()):
        found.append(f"{name}: attributes of unlike length")
    if any(not (key.startswith("_") or key in _KNOWN) for key in attributes):
        found.append(f"{name}: {list(attributes)}")
    indices = file.accessor(each["indices"])
    if indices.max() >= many or len(indices) % 3:
        found.append(f"{name}: indices")
    if "NORMAL" in attributes:
        lengths = np.linalg.norm(attributes["NORMAL"].astype(np.float64), axis=1)
        if np.abs(lengths - 1).max() > 5e-4:
            found.append(f"{name}: normals of length {lengths.min()} to {lengths.max()}")
    material = tree["materials"][each["material"]]
    for info in infos(material).values():
        if f"TEXCOORD_{info.get('texCoord', 0)}" not in attributes:
            found.append(f"{name}: lacks texture coordinates for {info}")
    return found


_KNOWN = "POSITION", "NORMAL", "TANGENT", "COLOR_0", "TEXCOORD_0", "TEXCOORD_1", "TEXCOORD_2"


def infos(material: dict) -> dict[str, dict]:
    """What of a material names a picture."""
    both = {**material, **material["pbrMetallicRoughness"]}
    return {name: info for name, info in both.items() if name.endswith("Texture")}
