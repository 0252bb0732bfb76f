"""A result as a Mitsuba scene: the user's file once more, or a file of what a program described,
with what was found in it."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

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
from . import built, mesh_files, scene_file
from .photos import building, photographs
from .photos.photographs import Photographs
from .views import Views

# Of nodes that the file gives no id: by it an object is found that was made from one.
_OWN = "isas-node-"
# What of a material is its colour, as a picture.
_COLOURS = "base_color.data", "reflectance.data", "diffuse.data"
# Plugins that Mitsuba has not: where they are registered.
_OURS = {"phong": "isas_cli.scene.phong", "emission": "isas_cli.rendering.volume"}


def write(
    scene: SceneConfig, arrays: dict[str, np.ndarray], folder: Path
) -> tuple[Path, list[str]]:
    """Writes ``scene.xml`` and the files that it names into ``folder``: textures, grids and meshes
    that were found as EXR, ``.vol`` and PLY, and copies of all others; and meshes with pictures on
    them as OBJ, MTL and PNG. Returns its path, and in
    words what such a file cannot hold.

    ``arrays``: the unknowns' values by key. Raises InputError where ``folder`` cannot be written,
    and for an unknown that Mitsuba's format cannot hold.
    """
    folder.mkdir(parents=True, exist_ok=True)
    taken = None if scene.photos.path is None else photographs.load(scene.photos)
    parsed = _parser(scene, taken, folder)
    settings, state = parsed()
    named = _name(state)
    mi.parser.transform_all(settings, state)
    with backend.loading():
        loaded = mi.parser.instantiate(settings, state)
    loaded = loaded[0] if isinstance(loaded, (list, tuple)) else loaded
    places = {node.props.id(): number for number, node in enumerate(state.nodes)}
    first = mi.traverse(loaded)
    made_from = {thing: places[thing.id()] for thing in first.hierarchy if thing.id() in places}
    for thing in (*loaded.emitters(), *loaded.shapes(), *loaded.sensors()):
        if thing.id().startswith(_OWN):
            thing.set_id("")
    scene_file.name_all(loaded)
    unknowns, views = _unknowns(scene, taken, loaded)
    unknowns.write(unknowns.values_of(arrays))
    # What was instantiated has been used up.
    settings, written = parsed()
    _name(written)
    mi.parser.transform_all(settings, written)
    params = mi.traverse(loaded)
    for key in dict.fromkeys(name for each in unknowns for name in each.kind.writes):
        _Place(params, key, made_from, written).put(folder)
    _paint(loaded, folder)
    told = _stand(written, views) if views is not None else []
    brought: dict[str, Path] = {}
    for node in written.nodes:
        if node.props.id() in named:
            node.props.set_id("")
        if "filename" in node.props:
            node.props["filename"] = _bring(node.props["filename"], folder, brought)
        if (kind := node.props.plugin_name()) in _OURS:
            told.append(f"'{kind}' is isas's own: import {_OURS[kind]} before Mitsuba loads it")
    path = folder / "scene.xml"
    mi.parser.write_file(written, str(path))
    _keep_ids(path, written)
    return path, told


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
            # Of plugins in Python Mitsuba does not know what they are.
            if node.type == mi.ObjectType.Unknown:
                ours = node.props.plugin_name() == "phong"
                node.type = mi.ObjectType.BSDF if ours else mi.ObjectType.Integrator
        return settings, state

    return parsed


def _as_files(described: dict[str, Any], folder: Path, name: str) -> dict[str, Any]:
    """``described``, its pictures and grids as files in ``folder`` that are called ``name``."""
    found = {}
    for key, value in described.items():
        here = f"{name}.{key}" if name else key
        if isinstance(value, dict):
            found[key] = _as_files(value, folder, here)
        elif isinstance(value, mi.Bitmap):
            pixels = np.array(value, np.float32)
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
        colours = [key for key in paint.keys() if key.endswith(_COLOURS)]
        positions = [key for key in POSITIONS if key in mesh]
        if not colours or not positions:  # a rectangle is a mesh that tells no vertices
            continue
        arrays = [np.array(mesh[key]) for key in (positions[0], "faces", "vertex_texcoords")]
        colour = as_numpy(paint[colours[0]])
        colour = np.broadcast_to(colour, (*colour.shape[:2], 3))
        rows = (a.reshape(-1, n) for a, n in zip(arrays, (3, 3, 2)))
        for name, content in mesh_files.painted(shape.id(), *rows, colour).items():
            (folder / name).write_bytes(content)


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
    if views.exposure is None:
        return []
    factors = np.array(views.exposure).reshape(-1, 3)
    told = ", ".join("/".join(f"{e:.4g}" for e in dict.fromkeys(each)) for each in factors)
    return [f"no part of it are exposures: times {told} the views are as bright as the photographs"]


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


def _name(state) -> set[str]:
    """Gives every node an id of its own; returns those that are new."""
    found = set()
    used = Counter(node.props.id() for node in state.nodes)
    things = {value.index() for _, value in state.root.props.items()}
    for number, node in enumerate(state.nodes):
        # Within what a program described, two may have the same.
        if not node.props.id() or (used[node.props.id()] > 1 and number not in things):
            node.props.set_id(f"{_OWN}{number}")
            found.add(node.props.id())
    return found


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

    def put(self, folder: Path) -> None:
        """Writes the parameter's value there, large ones into files of their own in ``folder``."""
        file = folder / self.key
        if isinstance(self.owner, mi.Mesh):
            self._mesh(folder / f"{self.key.rpartition('.')[0]}.ply")
        elif isinstance(self.owner, mi.Volume):
            mi.VolumeGrid(as_numpy(self.value)).write(f"{file}.vol")
            self._file(f"{file}.vol")
        elif isinstance(self.owner, mi.Emitter) and self.name == "data":
            self._picture(as_numpy(self.value)[:, 1:-1], f"{file}.exr")
        elif isinstance(self.owner, mi.Texture) and self.name == "data":
            self._picture(as_numpy(self.value), f"{file}.exr")
        elif self.name == "to_world":
            self.props["to_world"] = mi.ScalarTransform4f(np.array(self.value.matrix).reshape(4, 4))
        else:
            numbers = as_numpy(self.value).ravel()
            if numbers.size not in (1, 3):
                raise InputError(
                    f"'{self.key}' holds {numbers.size} numbers: 1 or 3 can be written"
                )
            plain = numbers.size == 1
            self.props[self.name] = float(numbers[0]) if plain else mi.ScalarColor3f(*numbers)

    def _picture(self, pixels: np.ndarray, path: str) -> None:
        images.write_exr(path, pixels, _channels(pixels), {"what": self.key})
        self._file(path)

    def _file(self, path: str) -> None:
        for other in ("data", "bitmap", "grid"):
            if other in self.props:
                del self.props[other]
        self.props["filename"] = path

    def _mesh(self, path: Path) -> None:
        self.owner.write_ply(str(path))
        for other in ("to_world", "flip_tex_coords", "shape_index"):
            if other in self.props:
                del self.props[other]
        self.props.set_plugin_name("ply")
        self.props["filename"] = str(path)
