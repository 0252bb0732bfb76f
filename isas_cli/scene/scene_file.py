"""A user's own scene: any Mitsuba XML."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import mitsuba as mi

from ..runtime import backend, memory
from ..runtime.errors import InputError
from . import file_checks, instances

backend.plugin(f"{__package__}.phong")

# Which replaying integrator stands for which of the file's.
_REPLAY = {
    "path": ("prb", -1),
    "direct": ("prb", 2),
    "prb": ("prb", 6),
    "prb_basic": ("prb", 6),
    "direct_projective": ("prb", 2),
    "prb_projective": ("prb", 6),
    "volpath": ("prbvolpath", -1),
    "volpathmis": ("prbvolpath", -1),
    "prbvolpath": ("prbvolpath", 6),
    "emission": ("emission", None),
}
# Integrators that hand on what one inside them finds, and add channels of their own.
_WRAPPERS = ("aov", "moment", "stokes")
# Those whose paths have one length, and those whose paths may have any.
SHORT = "direct", "direct_projective"
DEEP = tuple(name for name in _REPLAY if name not in (*SHORT, "emission"))
# Of files that may describe a scene to Mitsuba, and are no XML.
_PROGRAMS = ".py", ".json", ".ipynb"
_MESHES = ".obj", ".ply", ".stl", ".off", ".glb", ".gltf", ".blend", ".fbx", ".usd", ".usdz"
# What Mitsuba says of colours that it knows by their wavelengths only, such as blackbody.
_SPECTRAL = "non-spectral"
_DIRECT = 2  # camera, surface, light: whatever the file says


def load(path: str, max_depth: int | None) -> tuple[mi.Scene, mi.Integrator, str]:
    """The scene of an XML file, the integrator that replays its paths, and its text of properties.

    Bitmap textures are loaded in floating point, or 8-bit files could not be differentiated.
    Nothing is merged: two materials that start equal stay two unknowns. ``max_depth`` overrides
    the file's path depth; a file without an integrator gets Mitsuba's default (no limit). Which
    one it has the integrator says, as ``stands_for``: see ``stand_ins``.
    Raises InputError when the file is missing, cannot be loaded, or holds no scene.
    """
    with said(f"scene.path={path}"):
        settings, state = parse(path)
        own = _unwrapped(state, path)
        kind = own[0].props.plugin_name() if own else None
        blind = any(_takes_none(node, "bsdf_samples") for node in own)
        unlit = kind == "prb_basic" or any(_takes_none(node, "emitter_samples") for node in own)
        described = _integrator(own, state, path, max_depth)
        description = "".join(str(node.props) + _contents(node) for node in state.nodes)
        for node in state.nodes:
            if node.type == mi.ObjectType.Integrator:
                node.props = _properties(described)
        loaded, _ = instances.instantiate(settings, state)
    if not isinstance(loaded, mi.Scene):
        raise InputError(f"scene.path={path}: holds no <scene>")
    integrator = loaded.integrator() or mi.load_dict(described)
    _prepare(integrator, loaded)
    integrator.stands_for = kind
    integrator.blind, integrator.unlit = blind, unlit
    return loaded, integrator, description


def simulated(path: str, max_depth: int | None) -> dict:
    """The integrator that replays the paths of an XML file, as ``mitsuba.load_dict`` takes it.
    Raises InputError like ``load``."""
    with said(f"scene.path={path}"):
        _, state = parse(path)
        return _integrator(_unwrapped(state, path), state, path, max_depth)


def parse(path: str) -> tuple[mi.parser.ParserConfig, mi.parser.ParserState]:
    """What an XML file says, and how it is to be made a scene, as ``load`` does. Raises InputError
    like it."""
    file = Path(path)
    if not file.is_file():
        raise InputError(f"scene.path={path}: no such file")
    if file.suffix.lower() in _PROGRAMS:
        raise InputError(
            f"scene.path={path}: takes an XML file: for a dictionary of Python, "
            "mitsuba.parser.parse_dict and mitsuba.parser.write_file make one"
        )
    if file.suffix.lower() in _MESHES:
        raise InputError(
            f"scene.path={path}: takes an XML file, in which a mesh is a <shape> of OBJ or PLY; "
            "what photographs show is given as scene=photos photos.mesh=FILE"
        )
    settings = mi.parser.ParserConfig(mi.variant())
    settings.merge_equivalent = settings.merge_meshes = False
    # Of a link first what is beside it.
    backend.look_beside(*dict.fromkeys((file.resolve().parent, file.absolute().parent)))
    with said(f"scene.path={path}"):
        state = mi.parser.parse_file(settings, str(file))
        # Older versions call properties otherwise.
        mi.parser.transform_upgrade(settings, state)
        file_checks.check(state, f"scene.path={path}")
    instances.in_floats(state)
    for node in state.nodes:
        # A largest value that does not follow the grid's: where that grows beyond it, pictures and
        # derivatives are others'.
        if node.props.plugin_name() == "gridvolume" and "max_value" in node.props:
            del node.props["max_value"]
    return settings, state


@contextmanager
def said(where: str) -> Iterator[None]:
    """Raises what Mitsuba has to say of a scene as InputError that begins with ``where``; not that
    memory is full."""
    try:
        yield
    except (RuntimeError, ValueError, OSError) as error:
        if memory.exhausted(error):
            raise
        # Mitsuba begins with a place in its own source.
        text = re.sub(r"^\[\w+\.cpp:\d+\] ", "", " ".join(str(error).split()))
        if _SPECTRAL in text and "wavelength" not in text:  # which a polarized material asks for
            text += " (isas renders red, green and blue: give this colour as <rgb>)"
        raise InputError(f"{where}: Mitsuba cannot load it: {text}") from error


def _contents(node) -> str:
    """Of a file whose numbers Mitsuba's parameters do not tell, what tells it from others."""
    if node.props.plugin_name() != "measured" or "filename" not in node.props:
        return ""
    path = Path(str(mi.file_resolver().resolve(node.props["filename"])))
    return hashlib.blake2b(path.read_bytes(), digest_size=16).hexdigest()


def _check(node) -> None:
    """Raises what Mitsuba does of an integrator with properties that it has not: of that which
    stands for it it would not be asked."""
    alone, own = mi.parser.ParserState(), mi.parser.SceneNode()
    own.type, own.props = node.type, mi.Properties(node.props)
    alone.nodes = [own]
    mi.parser.instantiate(mi.parser.ParserConfig(mi.variant()), alone)


def _prepare(integrator: mi.Integrator, scene: mi.Scene) -> None:
    """Mitsuba's volumetric integrator looks for media in shapes that the scene itself lists, not in
    groups that instances show, and takes what it has not seen for homogeneous."""
    if not hasattr(integrator, "handle_null_scattering"):
        return
    media = [each for each in mi.traverse(scene).hierarchy if isinstance(each, mi.Medium)]
    if media:
        uniform = [each.is_homogeneous() for each in media]
        integrator.use_nee = integrator.is_prepared = True
        integrator.nee_handle_homogeneous = any(uniform)
        integrator.handle_null_scattering = not all(uniform)


def _takes_none(node, samples: str) -> bool:
    usual = node.props.get("shading_samples", 1)
    return node.props.plugin_name() == "direct" and node.props.get(samples, usual) == 0


def _properties(described: dict) -> mi.Properties:
    found = mi.Properties(described["type"])
    for name, value in described.items():
        if name != "type":
            found[name] = value
    return found


def _unwrapped(state, path: str) -> list:
    """The file's integrators without those around them. Raises InputError where they do not hold
    exactly one."""
    found = [node for node in state.nodes if node.type == mi.ObjectType.Integrator]
    inner = [node for node in found if node.props.plugin_name() not in _WRAPPERS]
    if len(inner) != 1 and len(inner) < len(found):
        around = next(n.props.plugin_name() for n in found if n not in inner)
        raise InputError(
            f"scene.path={path}: integrator '{around}' holds {len(inner)} integrators: give it "
            f"one, which finds the radiance; valid: {', '.join(_REPLAY)}"
        )
    return inner


def _integrator(own: list, state, path: str, max_depth: int | None) -> dict:
    """What replays the file's ``own``, described as for ``mi.load_dict``."""
    described = {"type": "prb"}
    for node in own:
        kind = node.props.plugin_name()
        if kind not in _REPLAY:
            raise InputError(
                f"scene.path={path}: integrator '{kind}' has no path replay counterpart here; "
                f"valid: {', '.join(_REPLAY)}"
            )
        described["type"], usual = _REPLAY[kind]
        # Without a medium the radiance is the same, but for ``stand_ins``, and paths between
        # surfaces can be planned.
        media = any(other.type == mi.ObjectType.Medium for other in state.nodes)
        if not media and kind != "emission":
            described["type"] = "prb"
        _check(node)
        for name in ("max_depth", "rr_depth", "hide_emitters"):
            if name in node.props:
                described[name] = node.props[name]
        if usual == _DIRECT:
            described["max_depth"] = _DIRECT
        elif usual is not None:
            described.setdefault("max_depth", usual)
    if max_depth is not None:
        described["max_depth"] = max_depth
    elif described["type"] != "emission":  # whose paths have no depth
        described.setdefault("max_depth", -1)
    return described
