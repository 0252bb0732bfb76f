"""A result as a Mitsuba scene: the user's file once more, or a file of what a program described,
with what was found in it."""

from __future__ import annotations

import importlib
import re
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.spatial.transform import Rotation

from ..config.schema import SceneConfig
from ..runtime import backend, images
from ..runtime.errors import InputError
from ..scenes import meshes
from ..unknowns.parameters import as_numpy
from ..unknowns.specs import parse
from ..unknowns.unknowns import Unknowns
from ..unknowns.vertices import POSITIONS
from . import built, instances, mesh_files, scene_file
from .photos import building, photographs
from .photos.photographs import Photographs
from .views import Views

# Plugins in Python, of which Mitsuba does not know what they are.
_PYTHON = {"phong": mi.ObjectType.BSDF} | dict.fromkeys(
    ("prb", "prb_basic", "prbvolpath", "emission"), mi.ObjectType.Integrator
)
# What of a material is its colour, as a picture.
_COLOURS = ".base_color", ".reflectance", ".diffuse_reflectance", ".diffuse"
# What tells its index of refraction as one inside and one outside.
_REFRACTING = "dielectric", "roughdielectric", "thindielectric", "plastic", "roughplastic"
# Plugins that Mitsuba has not: where they are registered, and what their files need.
_OURS = {"phong": "isas_cli.scene.phong", "emission": "isas_cli.rendering.emission"}
_NEEDS = {
    "phong": "after mitsuba.set_variant, import isas_cli.scene.phong, then load the scene",
    "emission": "isas alone renders it, with scene=file",
}


def write(
    scene: SceneConfig, arrays: dict[str, np.ndarray], folder: Path
) -> tuple[Path, list[str]]:
    """Writes ``scene.xml`` and the files that it names into ``folder``: textures, grids and meshes
    that were found as EXR, ``.vol`` and PLY, and copies of all others; and into ``painted`` below
    it meshes with pictures on them, as OBJ, MTL and PNG. Returns the path of the scene, and lines
    about what such a file cannot hold.

    ``arrays``: the unknowns' values by key. Raises InputError where ``folder`` cannot be written,
    and for what Mitsuba's format cannot hold.
    """
    for module in _OURS.values():
        importlib.import_module(module)
    if scene.path is not None and Path(scene.path).resolve().parent == folder.resolve():
        raise InputError(f"{folder} is where the scene's own files are: take another --output")
    taken = None if scene.photos.path is None else photographs.load(scene.photos)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # What a program described is put into files there, of which the result copies what it uses.
        with tempfile.TemporaryDirectory(prefix="isas-export-") as made:
            return _write(_parser(scene, taken, Path(made)), scene, taken, arrays, folder)
    except (OSError, RuntimeError) as error:
        told = " ".join(str(error).split())
        raise InputError(f"{folder}: the result cannot be written: {told}") from error


def _write(
    parsed: Callable[[], tuple],
    scene: SceneConfig,
    taken: Photographs | None,
    arrays: dict[str, np.ndarray],
    folder: Path,
) -> tuple[Path, list[str]]:
    settings, state = parsed()
    with backend.loading():
        loaded, made_from = instances.instantiate(settings, state)
    unknowns, views = _unknowns(scene, taken, loaded)
    # A run that was stopped may have left a coarse version.
    whole = unknowns.arrays(unknowns.values_of(arrays))
    unknowns.write(unknowns.values_of(whole))
    # What was instantiated has been used up.
    settings, written = parsed()
    mi.parser.transform_all(settings, written)
    params = mi.traverse(loaded)
    found = []
    for key in dict.fromkeys(name for each in unknowns for name in each.kind.writes):
        found += _Place(params, key, made_from, written).put(folder)
    _paint(loaded, folder / "painted")
    told = _stand(written, views) if views is not None else []
    # Found files keep their names.
    brought = {path.name: path.resolve() for path in found}
    for node in written.nodes:
        if "filename" in node.props:
            node.props["filename"] = _bring(node.props["filename"], folder, brought)
        if (kind := node.props.plugin_name()) in _OURS:
            told.append(f"'{kind}' is isas's own: {_NEEDS[kind]}")
    path = folder / "scene.xml"
    mi.parser.write_file(written, str(path))
    _keep_ids(path, written)
    return path, list(dict.fromkeys(told))


def _parser(scene: SceneConfig, taken: Photographs | None, folder: Path) -> Callable[[], tuple]:
    """What parses the scene, anew each time. What a program describes is put into files."""
    if scene.path is not None:
        return lambda: scene_file.parse(scene.path)
    with meshes.as_files(folder), backend.loading():
        described = _as_files(built.description(scene, taken), folder, "")
    settings = mi.parser.ParserConfig(mi.variant())
    settings.merge_equivalent = settings.merge_meshes = False

    def parsed() -> tuple:
        state = mi.parser.parse_dict(settings, described)
        for node in state.nodes:
            if node.type == mi.ObjectType.Unknown:
                node.type = _PYTHON.get(node.props.plugin_name(), node.type)
        return settings, state

    return parsed


def _as_files(described: dict[str, Any], folder: Path, name: str) -> dict[str, Any]:
    """``described``, its pictures and grids as files in ``folder`` that are called ``name``."""
    found = {}
    for key, value in described.items():
        here = f"{name}.{key}" if name else key
        if isinstance(value, dict):
            found[key] = _as_files(value, folder, here)
        elif isinstance(value, mi.Object) and not isinstance(value, (mi.Bitmap, mi.VolumeGrid)):
            raise InputError(
                f"'{here}' is an object that the scene's builder made, which no file can name: "
                "describe it by a dictionary, or make it by meshes.shape"
            )
        elif isinstance(value, mi.Bitmap):
            pixels = np.array(value, np.float32)
            pixels = pixels[..., None] if pixels.ndim == 2 else pixels
            found["filename"] = str(folder / f"{name}.exr")
            images.write_exr(found["filename"], pixels, _channels(pixels), {"what": name})
        elif isinstance(value, mi.VolumeGrid):
            found["filename"] = str(folder / f"{name}.vol")
            value.write(found["filename"])
        else:
            found[key] = value
    return found


def _unknowns(
    scene: SceneConfig, taken: Photographs | None, loaded: mi.Scene
) -> tuple[Unknowns, Views | None]:
    """The unknowns in ``loaded``, and the views where these have unknowns of their own."""
    wanted, of_views = scene.unknowns, None
    if taken is not None:
        wanted = building.unknowns(scene.photos, taken.surface, scene.unknowns)
        sizes = [(each.camera.width, each.camera.height) for each in taken.shown]
        of_views = building.of_views(taken, Views.of(sizes))
    truth_known = taken is None and scene.targets is None
    found = parse(mi.traverse(loaded), wanted, truth_known, scene.poses, of_views)
    return Unknowns(mi.traverse(loaded), found), of_views and of_views["views"]


def _paint(loaded: mi.Scene, folder: Path) -> None:
    """Meshes whose colour is a picture once more, for programs that read OBJ files."""
    for shape in loaded.shapes():
        if not shape.is_mesh() or not shape.has_vertex_texcoords():
            continue
        paint, mesh = mi.traverse(shape.bsdf()), mi.traverse(shape)
        pictures = {}
        for key, (_, _, owner, *_) in paint.properties.items():
            texels = paint[key]
            if isinstance(owner, mi.Texture) and isinstance(texels, mi.TensorXf):
                pictures[key.rpartition(".")[0]] = texels
        colours = [name for name in pictures if f".{name}".endswith(_COLOURS)]
        positions = [key for key in POSITIONS if key in mesh]
        if not colours or not positions:  # a rectangle is a mesh that tells no vertices
            continue
        texels = pictures[colours[0]]
        coordinates = np.array(mesh["vertex_texcoords"]).reshape(-1, 2)
        if f"{colours[0]}.to_uv" in paint:
            turn = np.array(paint[f"{colours[0]}.to_uv"].matrix, np.float64).reshape(3, 3)
            coordinates = coordinates @ turn[:2, :2].T + turn[:2, 2]
        colour = as_numpy(texels)
        colour = np.broadcast_to(colour, (*colour.shape[:2], 3))
        points, faces = (np.array(mesh[key]).reshape(-1, 3) for key in (positions[0], "faces"))
        folder.mkdir(exist_ok=True)
        name = re.sub(r"[^\w.-]", "_", shape.id())
        for file, content in mesh_files.painted(name, points, faces, coordinates, colour).items():
            (folder / file).write_bytes(content)


def _stand(state, views: Views) -> list[str]:
    """Lets the cameras of photographs stand where they were found to; says what remains."""
    if views.motion is not None:
        motion = np.array(views.motion, np.float64).reshape(-1, 2, 3)
        for number, (turn, shift) in enumerate(motion):
            (props,) = (n.props for n in state.nodes if n.props.id() == f"sensor_{number:05d}")
            stands = np.array(props["to_world"].matrix, np.float64).reshape(4, 4)
            stands[:3, :3] = Rotation.from_rotvec(turn).as_matrix() @ stands[:3, :3]
            stands[:3, 3] += shift
            props["to_world"] = mi.ScalarTransform4f(stands)
    numbers = dr.arange(mi.UInt32, views.count)
    factors = np.array(views.brightness(numbers) * dr.ones(mi.Color3f, views.count)).T.tolist()
    if all(factor == 1 for each in factors for factor in each):
        return []
    told = [each[:1] if len(set(each)) == 1 else each for each in factors]
    told = ", ".join("/".join(f"{e:.4g}" for e in each) for each in told)
    return [f"exposures are not in the file: multiply the views by {told}"]


def _bring(name: str, folder: Path, brought: dict[str, Path]) -> str:
    """Copies the file called ``name`` into ``folder``; returns its name there, with a number before
    it where another of those ``brought`` has it."""
    source = Path(str(mi.file_resolver().resolve(name))).resolve()
    if source.parent == folder.resolve():
        return source.name
    here, number = source.name, 1
    while brought.setdefault(here, source) != source:
        here, number = f"{number}-{source.name}", number + 1
    shutil.copyfile(source, folder / here)
    return here


def _keep_ids(path: Path, state) -> None:
    """The ids of the scene's own things, which Mitsuba writes only where something refers to
    them: by these a user knows them."""
    tree = ElementTree.parse(path)
    things = [node for node in tree.getroot() if "type" in node.attrib]
    own = [state.nodes[value.index()] for _, value in state.root.props.items()]
    for thing, node in zip(things, own, strict=True):
        if node.props.id():
            thing.set("id", node.props.id())
    tree.write(path, encoding="utf-8")


def _channels(pixels: np.ndarray) -> list[str]:
    return [*"RGB"] if pixels.shape[2] == 3 else ["Y"]


class _Place:
    """Where in the file a parameter of the scene stands."""

    def __init__(self, params: mi.SceneParameters, key: str, made_from: dict, state):
        self.key, self.value, self.owner = key, params[key], params.properties[key][2]
        self.name = key.rpartition(".")[2]
        if self.owner in made_from:
            self.props = state.nodes[made_from[self.owner]].props
            return
        # Textures forget from which node they were made, and of a colour or a number in the file
        # Mitsuba makes one as well: what holds them knows.
        holder, name = params.hierarchy[self.owner][0], key.split(".")[-2]
        if holder not in made_from:
            raise InputError(f"'{key}' has no place in the scene file")
        self.props = state.nodes[made_from[holder]].props
        if isinstance(self.props.get(name), mi.Properties.ResolvedReference):
            self.props = state.nodes[self.props[name].index()].props
        else:
            self.name = name

    def put(self, folder: Path) -> list[Path]:
        """Writes the parameter's value there, large ones into files of their own in ``folder``,
        which it returns."""
        if isinstance(self.owner, mi.Mesh):
            return [self._mesh(folder / f"{self.key.rpartition('.')[0]}.ply")]
        if isinstance(self.owner, mi.Volume):
            path = folder / f"{self.key}.vol"
            mi.VolumeGrid(as_numpy(self.value)).write(str(path))
            return [self._file(path)]
        if isinstance(self.owner, (mi.Emitter, mi.Texture)) and self.name == "data":
            pixels, path = as_numpy(self.value), folder / f"{self.key}.exr"
            # An environment map repeats its first column and its last.
            pixels = pixels[:, 1:-1] if isinstance(self.owner, mi.Emitter) else pixels
            images.write_exr(path, pixels, _channels(pixels), {"what": self.key})
            return [self._file(path)]
        if self.name == "to_world":
            # What it holds already.
            self._without("center", "radius", "p0", "p1", "direction")
            self.props["to_world"] = mi.ScalarTransform4f(np.array(self.value.matrix).reshape(4, 4))
        else:
            self._numbers(as_numpy(self.value).ravel())
        return []

    def _numbers(self, numbers: np.ndarray) -> None:
        if self.name == "position":
            self._without("to_world")
            self.props["position"] = mi.ScalarPoint3f(numbers.tolist())
        elif self.name == "eta" and self.props.plugin_name() in _REFRACTING:
            self._without("int_ior", "ext_ior")
            self.props["int_ior"], self.props["ext_ior"] = float(numbers[0]), 1.0
        elif numbers.size == 1:
            self.props[self.name] = float(numbers[0])
        elif numbers.size == 3:
            self.props[self.name] = mi.ScalarColor3f(*numbers)
        else:
            raise InputError(f"'{self.key}' holds {numbers.size} numbers: 1 or 3 can be written")

    def _without(self, *names: str) -> None:
        for name in names:
            if name in self.props:
                del self.props[name]

    def _file(self, path: Path) -> Path:
        self._without("data", "bitmap", "grid")
        self.props["filename"] = str(path)
        return path

    def _mesh(self, path: Path) -> Path:
        self.owner.write_ply(str(path))
        self._without("to_world", "flip_tex_coords", "shape_index")
        self.props.set_plugin_name("ply")
        return self._file(path)
