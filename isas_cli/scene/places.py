"""Where in a parsed scene a parameter stands, and how it is written there so that Mitsuba's plugins
read it back."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi
import numpy as np

from ..records import safe_name
from ..runtime import images
from ..runtime.errors import InputError
from ..unknowns.parameters import as_numpy
from ..unknowns.ranges import role
from .file_checks import read_bounds, write_bounds

# What tells its index of refraction as one inside and one outside.
_REFRACTING = "dielectric", "roughdielectric", "thindielectric", "plastic", "roughplastic"
_REFRACTING += "pplastic", "hair"
# Meshes that are made anew from numbers of another kind.
_CLOUDS = ("ellipsoidsmesh",)
_METALS = "conductor", "roughconductor"


class Place:
    """Where in the file, whose nodes are ``state``'s, the scene's parameter ``key`` stands.

    ``made_from``: the number of the node that an object was made from. Raises InputError where
    there is no such place.
    """

    def __init__(self, params: mi.SceneParameters, key: str, made_from: dict, state):
        self.params, self.key = params, key
        self.value, self.owner = params[key], params.properties[key][2]
        *outside, self.name = key.split(".")
        thing = self.owner
        # Of a colour or a number in the file Mitsuba makes a texture or a volume as well.
        while thing not in made_from and outside:
            if isinstance(thing, mi.BSDF) and thing.class_name() == "SmoothDiffuse":
                made_from = {**made_from, thing: _diffuse(params, thing, made_from, state)}
                break
            thing, self.name = params.hierarchy[thing][0], outside.pop()
        if thing not in made_from or not outside:
            raise InputError(f"'{key}' has no place in the scene file: {TAKE}")
        # What all parameters beside it begin with.
        self.beside = ".".join(outside)
        self.props = state.nodes[made_from[thing]].props
        self.plugin = self.props.plugin_name()
        if self.name in self.props and self._refers():
            raise InputError(f"'{key}' is made by '{self.plugin}' from another object: {TAKE}")

    def _refers(self) -> bool:
        return self.props.type(self.name) == mi.Properties.Type.ResolvedReference

    def put(self, folder: Path) -> list[Path]:
        """Writes the parameter's value there, large ones into files of their own in ``folder``,
        which it returns. Raises InputError for what no file of Mitsuba's can hold."""
        if self.name == "to_world":
            # What it holds already.
            self._without("center", "radius", "p0", "p1", "direction")
            matrix = np.array(self.value.matrix, np.float64).reshape(4, 4)
            if "sun_direction" in self.props:
                self._turn_sun(matrix[:3, :3])
            self.props["to_world"] = mi.ScalarTransform4f(matrix)
            return []
        if isinstance(self.owner, mi.Mesh) and self.plugin not in _CLOUDS:
            return [self._mesh(folder / f"{safe_name(self.beside)}.ply")]
        if isinstance(self.owner, mi.Shape):
            raise InputError(f"'{self.key}' lies in a file of '{self.plugin}': {TAKE}")
        if isinstance(self.owner, mi.Volume) and self.name == "data":
            return [self._grid(folder / f"{safe_name(self.key)}.vol")]
        if isinstance(self.owner, (mi.Emitter, mi.Texture)) and self.name == "data":
            return [self._picture(folder / f"{safe_name(self.key)}.exr")]
        self._numbers(as_numpy(self.value).ravel())
        return []

    def _turn_sun(self, turn: np.ndarray) -> None:
        """A sun, whose direction in the file is the world's, goes with its sky, which turns to
        ``turn (3, 3)``."""
        sun = np.array(self.props["sun_direction"], np.float64)
        if "to_world" in self.props:
            stood = np.array(self.props["to_world"].matrix, np.float64).reshape(4, 4)
            sun = np.linalg.solve(stood[:3, :3], sun)
        self.props["sun_direction"] = mi.ScalarVector3f((turn @ sun).tolist())

    def _numbers(self, numbers: np.ndarray) -> None:
        if self.name == "position":
            self._without("to_world")
            self.props["position"] = mi.ScalarPoint3f(numbers.tolist())
        elif self.name == "sun_direction":
            self.props["sun_direction"] = mi.ScalarVector3f(numbers.tolist())
        elif self.name == "eta" and self.plugin in _REFRACTING:
            self._without("int_ior", "ext_ior")
            self.props["int_ior"], self.props["ext_ior"] = float(numbers[0]), 1.0
        elif self.name in ("eta", "k") and self.plugin in _METALS:
            self._metal()
        elif self.name == "cutoff_angle":
            # By default the other one follows.
            for name in ("cutoff_angle", "beam_width"):
                self._set(name, as_numpy(self.params[f"{self.beside}.{name}"]).ravel())
        elif self.name == "values" and self.plugin == "tabphase":
            self.props["values"] = ", ".join(f"{number:.9g}" for number in numbers)
        elif self.name == "value" and self.plugin == "rawconstant" and numbers.size == 3:
            self.props["value"] = mi.ScalarVector3f(numbers.tolist())
        elif self.name == "value" and self.plugin in ("srgb", "d65"):
            self._spectrum(numbers)
        else:
            self._set(self.name, numbers)

    def _metal(self) -> None:
        """Both of its indices: the name of a material stands for both."""
        self._without("material")
        for name in ("eta", "k"):
            # A texture of the file's stays.
            whole = f"{self.beside}.{name}"
            for key in (f"{whole}.value", whole):
                if key in self.params and (name == self.name or name not in self.props):
                    self._set(name, as_numpy(self.params[key]).ravel())

    def _spectrum(self, numbers: np.ndarray) -> None:
        if numbers.size == 1:
            self.props["scale" if self.plugin == "d65" else "color"] = float(numbers[0])
            return
        self._without("scale")
        self._set("color", numbers)
        if self.plugin == "srgb" and numbers.max() > 1:
            self.props["unbounded"] = True

    def _set(self, name: str, numbers: np.ndarray) -> None:
        if numbers.size == 1:
            self.props[name] = float(numbers[0])
        elif numbers.size == 3:
            self.props[name] = mi.ScalarColor3f(*numbers)
        else:
            raise InputError(
                f"'{self.key}' holds {numbers.size} numbers, and 1 or 3 can be written: {TAKE}"
            )

    def _without(self, *names: str) -> None:
        for name in names:
            if name in self.props:
                del self.props[name]

    def _file(self, path: Path) -> Path:
        self._without("data", "bitmap", "grid", "volume")
        self.props["filename"] = str(path)
        return path

    def _picture(self, path: Path) -> Path:
        pixels = as_numpy(self.value)
        # An environment map repeats its first column and its last.
        pixels = pixels[:, 1:-1] if isinstance(self.owner, mi.Emitter) else pixels
        data = not role(self.params, self.key)
        images.write_exr(path, pixels, channels(pixels), {"what": self.key}, data)
        return self._file(path)

    def _grid(self, path: Path) -> Path:
        mi.VolumeGrid(as_numpy(self.value)).write(str(path))
        if "use_grid_bbox" in self.props and self.props["use_grid_bbox"]:
            source = mi.file_resolver().resolve(self.props["filename"])
            write_bounds(path, read_bounds(Path(str(source))))
        return self._file(path)

    def _mesh(self, path: Path) -> Path:
        if self.plugin == "merge":
            raise InputError(f"'{self.key}' lies in merged shapes: take 'merge' out of the file")
        self.owner.write_ply(str(path))
        self._without("to_world", "flip_tex_coords", "shape_index")
        self.props.set_plugin_name("ply")
        return self._file(path)


def _diffuse(params: mi.SceneParameters, bsdf: mi.BSDF, made_from: dict, state) -> int | None:
    """Writes down the material that a shape has where its file gives none. Returns its node."""
    shape = made_from.get(params.hierarchy[bsdf][0])
    if shape is None:
        return None
    node = mi.parser.SceneNode()
    node.type, node.props = mi.ObjectType.BSDF, mi.Properties("diffuse")
    number = len(state.nodes)
    state.nodes.append(node)
    state.nodes[shape].props["bsdf"] = mi.Properties.ResolvedReference(number)
    return number


TAKE = "take the numbers from isas_cli.load(DIR).parameters()"


def channels(pixels: np.ndarray) -> list[str]:
    """Names of a picture's, ``(H, W, C)``."""
    return {1: ["Y"], 3: [*"RGB"], 4: [*"RGBA"]}[pixels.shape[2]]
