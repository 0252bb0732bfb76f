"""The settings of photographs, `photos.…`."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, List, Optional

from ..runtime.errors import InputError
from .meanings import at_least

UPS = ("x", "y", "z", "-x", "-y", "-z")
# In place of one, of lights for scores: as the camera of each view stands.
CAMERA = "camera"
# What of a lens may be unknown.
LENS = ("focal", "centre", "radial")
# In place of whether something of a surface is unknown: it is, as a texture.
MAP = "map"
SIDE = 256  # texels, where nothing is said


@dataclass
class PhotosConfig:
    """Photographs with known cameras (scene=photos; ``photos.path``, their folder, is
    ``scene.photos.path``). What each setting is: the table in scenes/README.md."""

    path: Optional[str] = None
    cameras: Optional[str] = None
    world: str = "mesh"
    mesh: Optional[str] = None
    plane: Optional[List[float]] = None
    sphere: Optional[List[float]] = None
    environment: Optional[str] = None
    up: str = "y"
    turn: float = 0.0
    width: Optional[int] = None
    texture: Any = SIDE  # an int, or a file's name
    roughness: Any = False  # a bool, or "map"
    metallic: Any = False
    normals: Any = False
    texels: Optional[int] = None
    sky: int = 8
    test: Any = None
    without: List[str] = field(default_factory=list)
    exposure: str = "fixed"
    refine: bool = False
    lens: List[str] = field(default_factory=list)
    lenses: str = "shared"
    saturated: Optional[float] = 0.995
    encoding: str = "auto"
    background: Any = False  # a bool, or "black"
    images: Optional[str] = None
    masks: Optional[str] = None
    missing: str = "refuse"
    scale: Any = None
    orientation: str = "auto"
    materials: str = "each"
    start: Optional[str] = None
    voxels: int = 48
    edges: bool = False
    pose: bool = False

    @property
    def colour(self) -> Optional[str]:
        """The file of a base colour that is known."""
        return self.texture if isinstance(self.texture, str) else None

    def __post_init__(self) -> None:
        at_least(1, photos__width=self.width, photos__texels=self.texels)
        at_least(2, photos__sky=self.sky)
        at_least(8, photos__voxels=self.voxels)
        self._check_maps()
        for name, valid in (
            ("exposure", ("fixed", "scale", "channels")),
            ("lenses", ("shared", "each")),
            ("encoding", ("auto", "srgb", "linear")),
            ("world", ("mesh", "file")),
            ("up", UPS),
            ("missing", ("refuse", "skip")),
            ("orientation", ("auto", "stored", "turned")),
            ("materials", ("each", "one")),
            ("start", (None, "hull")),
        ):
            if getattr(self, name) not in valid:
                told = ", ".join("null" if each is None else each for each in valid)
                raise InputError(f"photos.{name}={getattr(self, name)}: valid: {told}")
        unknown = [each for each in self.lens if each not in LENS]
        if unknown or len(set(self.lens)) < len(self.lens):
            raise InputError(
                f"photos.lens=[{','.join(map(str, self.lens))}]: a list of what is unknown, each "
                f"once: {', '.join(LENS)}"
            )
        if self.lenses != "shared" and not self.lens:
            raise InputError(
                f"photos.lenses={self.lenses}: of lenses that are unknown, and photos.lens says "
                "nothing of what is: photos.lens=[focal], or leave it out"
            )
        if self.environment is not None and self.sky != PhotosConfig.sky:
            raise InputError(
                f"photos.sky={self.sky}: of an unknown light, but photos.environment is given"
            )
        if not math.isfinite(self.turn):
            raise InputError(f"photos.turn={self.turn}: degrees")
        if self.environment is None and self.turn:
            raise InputError(f"photos.turn={self.turn}: of photos.environment, which is not given")
        if not isinstance(self.background, bool) and self.background != "black":
            raise InputError(f"photos.background={self.background}: valid: true, false, black")
        shapes = [n for n in ("mesh", "plane", "sphere", "start") if getattr(self, n) is not None]
        if len(shapes) > 1:
            raise InputError(f"photos.{shapes[0]} and photos.{shapes[1]}: one shape alone")
        if shapes and shapes != ["start"] and self.voxels != PhotosConfig.voxels:
            raise InputError(
                f"photos.voxels={self.voxels}: of a hull, but photos.{shapes[0]} is given"
            )
        for name in ("plane", "sphere"):
            numbers = getattr(self, name)
            if numbers is not None and (len(numbers) != 4 or not all(map(math.isfinite, numbers))):
                raise InputError(f"photos.{name}={list(numbers)}: four numbers")
        if self.plane and not (self.plane[0] < self.plane[2] and self.plane[1] < self.plane[3]):
            raise InputError(f"photos.plane={list(self.plane)}: [x0, y0, x1, y1], x0 < x1, y0 < y1")
        if self.sphere and not self.sphere[3] > 0:
            raise InputError(f"photos.sphere={list(self.sphere)}: its radius must be above 0")
        scaled = isinstance(self.scale, (int, float)) and not isinstance(self.scale, bool)
        if self.scale not in (None, "auto") and not (scaled and 0 < self.scale < math.inf):
            raise InputError(
                f"photos.scale={self.scale}: how large pictures are of the cameras' size, such as "
                "0.5, or auto"
            )
        if self.saturated is not None and not 0 < self.saturated <= 1:
            raise InputError(f"photos.saturated={self.saturated}: in (0, 1], or null")

    def _check_maps(self) -> None:
        count = isinstance(self.texture, int) and not isinstance(self.texture, bool)
        if not count and not (isinstance(self.texture, str) and self.texture):
            raise InputError(
                f"photos.texture={self.texture}: texels a side, such as {SIDE}, or the picture "
                "file of a base colour that is known"
            )
        if count:
            at_least(1, photos__texture=self.texture)
        for name, valid in (
            ("roughness", (False, True, MAP)),
            ("metallic", (False, True, MAP)),
            ("normals", (False, MAP)),
        ):
            value = getattr(self, name)
            if not isinstance(value, (bool, str)) or value not in valid:
                told = ", ".join(str(each).lower() for each in valid)
                raise InputError(f"photos.{name}={value}: valid: {told}")
        if self.texels is not None and MAP not in (self.roughness, self.metallic, self.normals):
            raise InputError(
                f"photos.texels={self.texels}: of maps, and none is asked for: say which, such as "
                "photos.roughness=map; the base colour's are photos.texture"
            )
