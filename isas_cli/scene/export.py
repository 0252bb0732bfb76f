"""A result as a Mitsuba scene: the user's file once more, or a file of what a program described,
with what was found in it."""

from __future__ import annotations

import filecmp
import importlib
import math
import re
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mitsuba as mi
import numpy as np

from ..config.schema import SceneConfig
from ..runtime import backend, images, memory
from ..runtime.errors import InputError
from ..scenes import meshes
from ..unknowns.optics import Lens
from ..unknowns.parameters import as_numpy
from ..unknowns.specs import parse
from ..unknowns.unknowns import Unknowns
from . import built, found_cameras, gltf, instances, mesh_files, scene_file
from .gltf_maps import Said
from .photos import building, photographs
from .photos.photographs import Photographs
from .places import TAKE, Place, channels
from .views import Views

# Plugins in Python, of which Mitsuba does not know what they are.
_PYTHON = {"phong": mi.ObjectType.BSDF} | dict.fromkeys(
    ("prb", "prb_basic", "prbvolpath", "emission"), mi.ObjectType.Integrator
)
# Tags of a file that are no objects.
_VALUES = {"default", "boolean", "integer", "float", "string"}
# What of a material is its colour, as a picture.
_COLOURS = ".base_color", ".reflectance", ".diffuse_reflectance", ".diffuse"
# Of bitmaps, what plugins make of them.
_TAKEN = {"YA": "Y", **dict.fromkeys(("RGBA", "XYZ", "XYZA"), "RGB")}
# Plugins that Mitsuba has not: where they are registered, and what their files need.
_OURS = {"phong": "isas_cli.scene.phong", "emission": "isas_cli.rendering.emission"}
# Names what an export has brought into its folder.
_MARK = ".isas-export"
_NEEDS = {
    "phong": "after mitsuba.set_variant, import isas_cli.scene.phong, then load the scene",
    "emission": "isas alone renders it, with scene=file",
}


def write(
    scene: SceneConfig, arrays: dict[str, np.ndarray], folder: Path
) -> tuple[Path, list[str]]:
    """Writes ``scene.xml`` and the files that it names into ``folder``: textures, grids and meshes
    that were found as EXR, ``.vol`` and PLY, and copies of all others; ``scene.glb``, its surfaces
    as glTF; and into ``painted`` below it meshes with pictures on them, as OBJ, MTL and PNG.
    Returns the path of the scene, and lines about what such files cannot hold.

    ``arrays``: the unknowns' values by key. Raises InputError where ``folder`` cannot be written,
    and for what Mitsuba's format cannot hold.
    """
    photos = scene.photos
    named = scene.path, photos.mesh, photos.environment, photos.texture
    _check_apart(folder, [each for each in named if isinstance(each, str)])
    own = (folder / _MARK, folder / "scene.glb")
    if (folder / "scene.xml").exists() and not any(each.exists() for each in own):
        raise InputError(f"{folder} holds another scene.xml: take another --output")
    taken = _taken(scene)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # What a program described is put into files there, of which the result copies what it uses.
        with tempfile.TemporaryDirectory(prefix="isas-export-") as made:
            return _write(_parser(scene, taken, Path(made)), scene, taken, arrays, folder)
    except (OSError, RuntimeError) as error:
        if memory.exhausted(error):
            raise
        told = " ".join(str(error).split())
        raise InputError(f"{folder}: the result cannot be written: {told}") from error


def _check_apart(folder: Path, files: list[str]) -> None:
    """Raises InputError where one of ``files``, which a scene was made from, lies in ``folder``:
    what is written there may have its name."""
    for file in files:
        for place in (Path(file).absolute(), Path(file).resolve()):
            if place.is_file() and place.parent.resolve() == folder.resolve():
                raise InputError(
                    f"{folder} is where the scene's own files are, such as {place.name}: take "
                    "another --output"
                )


def _write(
    parsed: Callable[[], tuple],
    scene: SceneConfig,
    taken: Photographs | None,
    arrays: dict[str, np.ndarray],
    folder: Path,
) -> tuple[Path, list[str]]:
    loaded, made_from, unknowns, views = _filled(parsed, scene, taken, arrays)
    # What was instantiated has been used up.
    settings, written = parsed()
    named = [node.props["filename"] for node in written.nodes if "filename" in node.props]
    _check_apart(folder, [str(mi.file_resolver().resolve(each)) for each in named])
    mi.parser.transform_all(settings, written)
    params = mi.traverse(loaded)
    # Before the first of them: an export that is broken off can be done again.
    ours = _ours(folder)
    _mark(folder, ours)
    found = []
    keys = dict.fromkeys(name for each in unknowns for name in each.kind.writes)
    # Skies first: a sun that was found itself is not turned with its sky.
    for key in sorted(keys, key=lambda name: not name.endswith(".to_world")):
        found += Place(params, key, made_from, written).put(folder)
    told = [line for first, own in views for line in found_cameras.put(written, own, first)]
    told += _deepen(written, scene)
    # Found files keep their names.
    brought = {path.name: path.resolve() for path in found}
    for node in written.nodes:
        if "filename" in node.props:
            node.props["filename"] = _bring(node.props["filename"], folder, brought, ours)
        if (kind := node.props.plugin_name()) in _OURS:
            told.append(f"'{kind}' is isas's own: {_NEEDS[kind]}")
    path = folder / "scene.xml"
    # Names of properties are those of Mitsuba's own version.
    written.versions = []
    mi.parser.write_file(written, str(path))
    _keep_ids(path, written)
    _check(path)
    _mark(folder, {*ours, *brought})
    # What other programs read comes last: of a full disk the scene is there.
    _paint(loaded, folder / "painted")
    told += gltf.write(loaded, path.with_suffix(".glb"), Said(made_from, written))
    return path, list(dict.fromkeys(told))


def _taken(scene: SceneConfig) -> Photographs | None:
    """Its photographs, where it is of some; once all plugins are there. Raises InputError for a
    renderer that is none of Mitsuba's."""
    if scene.outside:
        raise InputError(
            "scene=external: another renderer's result is its parameters, no scene for Mitsuba: "
            "isas_cli.load(DIR).parameters() has them"
        )
    for module in _OURS.values():
        importlib.import_module(module)
    return None if scene.photos.path is None else photographs.load(scene.photos)


def _filled(
    parsed: Callable[[], tuple],
    scene: SceneConfig,
    taken: Photographs | None,
    arrays: dict[str, np.ndarray],
) -> tuple[mi.Scene, Any, Unknowns, list[tuple[int, Views]]]:
    """The scene with the result in it, what it was made from, what was unknown of it, and views
    with unknowns of their own, each with the number of its first."""
    with backend.loading():
        settings, state = parsed()
        # Whoever reads texels takes them for linear, which bytes are not.
        instances.in_floats(state, every=True)
        loaded, made_from = instances.instantiate(settings, state)
    unknowns, views = _unknowns(scene, taken, loaded)
    # A run that was stopped may have left a coarse version.
    whole = unknowns.arrays(unknowns.recorded(arrays))
    unknowns.write(unknowns.values_of(whole))
    return loaded, made_from, unknowns, views


def result(scene: SceneConfig, arrays: dict[str, np.ndarray]) -> tuple[mi.Scene, int, bool]:
    """The scene with the unknowns' values ``arrays``, by key; how many edges paths have in it, -1
    for any number; and whether lights hide from cameras. Raises InputError."""
    taken = _taken(scene)
    with tempfile.TemporaryDirectory(prefix="isas-result-") as made:
        found = _filled(_parser(scene, taken, Path(made)), scene, taken, arrays)[0]
    if scene.path is not None:
        own = scene_file.simulated(scene.path, scene.max_depth)
    else:
        own = built.description(scene, taken).get("integrator", {})
    return found, own.get("max_depth", -1), own.get("hide_emitters", False)


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
        instances.in_floats(state)
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
            whole = mi.Bitmap(value)
            if described.get("raw", False):
                whole.set_srgb_gamma(False)
            # As plugins have it: linear, of whole numbers as of others, and without alpha.
            form = _TAKEN.get(whole.pixel_format().name)
            form = form and getattr(mi.Bitmap.PixelFormat, form)
            pixels = np.array(whole.convert(form, mi.Struct.Type.Float32, False), np.float32)
            pixels = pixels[..., None] if pixels.ndim == 2 else pixels
            found["filename"] = str(folder / f"{name}.exr")
            images.write_exr(found["filename"], pixels, channels(pixels), {"what": name})
        elif isinstance(value, mi.VolumeGrid):
            found["filename"] = str(folder / f"{name}.vol")
            value.write(found["filename"])
        else:
            found[key] = value
    return found


def _unknowns(
    scene: SceneConfig, taken: Photographs | None, loaded: mi.Scene
) -> tuple[Unknowns, list[tuple[int, Views]]]:
    """The unknowns in ``loaded``, and the views where these have unknowns of their own, see
    ``_filled``."""
    # Values are known: no start is needed, nor a file that it came from, nor is any checked.
    anything = {"start": None, "range": [-math.inf, math.inf]}
    wanted = {key: replace(spec, **anything) for key, spec in scene.unknowns.items()}
    of_views, poses, views = None, scene.poses, []
    if taken is not None:
        poses = building.poses(taken, scene.poses)
        wanted = building.unknowns(taken, wanted, poses)
        sizes = [(each.camera.width, each.camera.height) for each in taken.all]
        count = len(taken.shown)
        of_views = building.of_views(taken, Views.of(sizes[:count]))
        views.append((0, of_views["views"]))
    params = mi.traverse(loaded)
    found = Unknowns(
        mi.traverse(loaded), parse(params, wanted, False, poses, of_views, begins=False)
    )
    if taken is not None and taken.held:
        held = replace(Views.of(sizes[count:]), given=building.given(taken.held))
        if (lens := found.of(Lens)) is not None:
            lens.kind.follow(held, building.glass(taken).of_views(count, len(sizes)))
        views.append((count, held))
    return found, views


def _paint(loaded: mi.Scene, folder: Path) -> None:
    """Meshes whose colour is a picture once more, for programs that read OBJ files."""
    taken: set[str] = set()
    drawn: dict[mi.Texture, str] = {}  # each picture once, however many meshes show it
    for shape in loaded.shapes():
        if not shape.is_mesh() or not shape.has_vertex_texcoords():
            continue
        paint, mesh = mi.traverse(shape.bsdf()), mi.traverse(shape)
        pictures = {}
        for key, (_, _, owner, *_) in paint.properties.items():
            texels = paint[key]
            if isinstance(owner, mi.Texture) and isinstance(texels, mi.TensorXf):
                pictures[key.rpartition(".")[0]] = texels, owner
        colours = [name for name in pictures if f".{name}".endswith(_COLOURS)]
        # A rectangle is a mesh that tells no vertices.
        if not colours or "vertex_positions" not in mesh:
            continue
        texels, owner = pictures[colours[0]]
        coordinates = np.array(mesh["vertex_texcoords"]).reshape(-1, 2)
        if f"{colours[0]}.to_uv" in paint:
            turn = np.array(paint[f"{colours[0]}.to_uv"].matrix, np.float64).reshape(3, 3)
            coordinates = coordinates @ turn[:2, :2].T + turn[:2, 2]
        points, faces = (
            np.array(mesh[key]).reshape(-1, 3) for key in ("vertex_positions", "faces")
        )
        folder.mkdir(exist_ok=True)
        name = gltf.unlike(re.sub(r"[^\w.-]", "_", shape.id()), taken)
        taken.add(name)
        colour = drawn.get(owner)
        if colour is None:
            colour = as_numpy(texels)
            colour = np.broadcast_to(colour, (*colour.shape[:2], 3))
            drawn[owner] = f"{name}.png"
        for file, content in mesh_files.painted(name, points, faces, coordinates, colour).items():
            (folder / file).write_bytes(content)


def _check(path: Path) -> None:
    """Raises InputError where Mitsuba cannot load the file: some plugins take a number only beside,
    or without, others."""
    try:
        with backend.loading():
            mi.load_file(str(path), optimize=False)
    except RuntimeError as error:
        path.unlink()
        if memory.exhausted(error):
            raise
        told = " ".join(str(error).split()).replace(f"{path.parent}/", "")
        raise InputError(f"Mitsuba's file cannot hold the result: {TAKE}; {told}") from error


def _deepen(state, scene: SceneConfig) -> list[str]:
    """Lets paths be as long as the configuration says of a file's; says where that cannot be."""
    if scene.path is None or scene.max_depth is None:
        return []
    integrators = [node for node in state.nodes if node.type == mi.ObjectType.Integrator]
    for node in integrators:
        if node.props.plugin_name() in scene_file.SHORT:
            hidden = node.props.get("hide_emitters", False)
            node.props = mi.Properties("path")
            node.props["hide_emitters"] = hidden
        if node.props.plugin_name() in scene_file.DEEP:
            node.props["max_depth"] = scene.max_depth
    if integrators:
        return []
    return [f"the file names no integrator: render it with max_depth={scene.max_depth}"]


def _ours(folder: Path) -> set[str]:
    """Names of what an earlier export has brought into ``folder``."""
    try:
        return set((folder / _MARK).read_text(encoding="utf-8").splitlines())
    except OSError:
        return set()


def _mark(folder: Path, names: set[str]) -> None:
    (folder / _MARK).write_text("\n".join(sorted(names)), encoding="utf-8")


def _bring(name: str, folder: Path, brought: dict[str, Path], ours: set[str]) -> str:
    """Copies the file called ``name`` into ``folder``; returns its name there, with a number before
    it where another of those ``brought`` has it, or somebody's own that is none of ``ours``."""
    source = Path(str(mi.file_resolver().resolve(name))).resolve()
    if source.parent == folder.resolve():
        return source.name
    here, number = source.name, 1
    while (here not in ours and _is_another(folder / here, source)) or (
        brought.setdefault(here, source) != source
    ):
        here, number = f"{number}-{source.name}", number + 1
    shutil.copyfile(source, folder / here)
    return here


def _is_another(there: Path, source: Path) -> bool:
    return there.exists() and not filecmp.cmp(there, source, shallow=False)


def _keep_ids(path: Path, state) -> None:
    """The ids of the scene's own things, which Mitsuba writes only where something refers to
    them: by these a user knows them."""
    tree = ElementTree.parse(path)
    things = [node for node in tree.getroot() if node.tag not in _VALUES]
    for thing, number in zip(things, instances.references(state.root.props).values(), strict=True):
        # Others stand where something else refers to them first.
        if thing.tag != "ref" and (id := state.nodes[number].props.id()):
            thing.set("id", id)
    tree.write(path, encoding="utf-8")
