"""A result as a Mitsuba scene: the user's file once more, with what was found in it."""

from __future__ import annotations

import shutil
from pathlib import Path
from xml.etree import ElementTree

import mitsuba as mi
import numpy as np

from ..config.schema import SceneConfig
from ..runtime import backend, images
from ..runtime.errors import InputError
from ..unknowns.parameters import as_numpy
from ..unknowns.specs import parse
from ..unknowns.unknowns import Unknowns
from . import scene_file

# Of nodes that the file gives no id: by it an object is found that was made from one.
_OWN = "isas-node-"


def write(scene: SceneConfig, arrays: dict[str, np.ndarray], folder: Path) -> Path:
    """Writes ``scene.xml`` and the files that it names into ``folder``: textures, grids and meshes
    that were found as EXR, ``.vol`` and PLY, and copies of all others. Returns its path.

    ``arrays``: the unknowns' values by key. Raises InputError for a scene that is no file, where
    ``folder`` cannot be written, and for an unknown that Mitsuba's format cannot hold.
    """
    if scene.path is None:
        raise InputError(
            f"scene={scene.name} is built by a program, of which there is no scene file: only runs "
            "of scene=file can be exported"
        )
    settings, state = scene_file.parse(scene.path)
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
    unknowns = Unknowns(
        mi.traverse(loaded),
        parse(mi.traverse(loaded), scene.unknowns, scene.targets is None, scene.poses),
    )
    unknowns.write(unknowns.values_of(arrays))
    # What was instantiated has been used up.
    settings, written = scene_file.parse(scene.path)
    _name(written)
    mi.parser.transform_all(settings, written)
    folder.mkdir(parents=True, exist_ok=True)
    params = mi.traverse(loaded)
    for key in dict.fromkeys(name for each in unknowns for name in each.kind.writes):
        _Place(params, key, made_from, written).put(folder)
    brought: dict[str, Path] = {}
    for node in written.nodes:
        if node.props.id() in named:
            node.props.set_id("")
        if "filename" in node.props:
            node.props["filename"] = _bring(node.props["filename"], folder, brought)
    path = folder / "scene.xml"
    mi.parser.write_file(written, str(path))
    _keep_ids(path, written)
    return path


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
    """Gives every node an id; returns those that are new."""
    found = set()
    for number, node in enumerate(state.nodes):
        if not node.props.id():
            node.props.set_id(f"{_OWN}{number}")
            found.add(node.props.id())
    return found


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
        names = [*"RGB"] if pixels.shape[2] == 3 else ["Y"]
        images.write_exr(path, pixels, names, {"what": self.key})
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
