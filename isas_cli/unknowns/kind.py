"""What a kind of unknown says of itself: all that the rest of the program asks, in one class.

A class derived from ``Kind`` is a kind, an instance of it is one unknown. As it stands, ``Kind``
describes an unknown that is one of Mitsuba's own parameters, unchanged: such a kind says in
``matches`` which parameters are its, and little else. One that has an array of its own (a pose, an
offset, a logarithm) also says which keys it offers, and overrides ``__init__``, ``write`` and what
the defaults get wrong. ``registry.register`` makes a kind known; nothing else names it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import mitsuba as mi
import numpy as np

from ..config.schema import PoseConfig
from ..runtime import images
from ..runtime.errors import InputError
from .parameters import as_numpy, like
from .ranges import AIMS, bare, fed, lowest, role, usual

if TYPE_CHECKING:
    from ..scene.outside import Outside
    from ..scene.topology import Topology
    from ..scene.views import Glass, Views

# An entry counts as seen from this share of a well seen one's sensitivity on. Texels that only
# light the seen ones by interreflection, or that a view grazes, lie far below it: no view pins
# them down, and an error there says nothing about a method. Well seen is a high quantile, not the
# median: where most texels are grazed, the median is one of those.
THRESHOLD, WELL_SEEN = 0.05, 0.9
# Numbers of an unknown that are shown one by one.
_FEW = 8


@dataclass(frozen=True)
class Loaded:
    """The scene as it was loaded, and ``scene.poses`` of the configuration by name; of
    photographs the ``views``; ``channels``: of their exposures, where these may be unknown;
    ``told``: these, ``(V, channels)``, and by which share they may be off, where places of the
    object tell them; ``pixel``: ``(V, 2)`` radians and scene units that are a pixel of each, where
    poses may be; ``glass``: the lenses of these views and of those that are held out after them,
    where something of them may be; ``outside``: a renderer that is none of Mitsuba's."""

    params: mi.SceneParameters
    poses: dict[str, PoseConfig] = field(default_factory=dict)
    views: Views | None = None
    channels: int | None = None
    told: tuple[np.ndarray, float] | None = None
    pixel: np.ndarray | None = None
    glass: Glass | None = None
    outside: Outside | None = None


class Surface(NamedTuple):
    """``vertices (V, 3)``, ``faces (F, 3)``, and of each vertex the distance from the truth, in
    scene units, ``apart (V,)``, where that is known."""

    vertices: np.ndarray
    faces: np.ndarray
    apart: np.ndarray | None


class Kind:
    """One unknown, seen from its kind.

    ``name``: of the kind, in words. ``key``: of the unknown. ``present``: the value that the scene
    was loaded with, float32, in the shape of the unknown; never changed. ``writes``: the scene's
    parameters that it writes. ``range``: legal where the configuration gives no other, (low, high).
    ``bare``: how far from its ends values stay, where derivatives vanish at them. ``words``: what
    materials, lights and media that take the parameter's numbers call them.
    ``unit``: of its error, a word for reports; errors of one unit may be averaged. ``period``:
    after which a value means the same again, or None. ``scale``: the size, in its unit, of what it
    is added to in the scene, or its own, whose rounding limits how finely it can be moved.

    ``moves_geometry``: whether it changes what is visible: path replay cannot differentiate it, and
    no entry of it is ever judged unseen. ``affine``: whether it moves all of an object alike, so
    that what is convex stays so. ``deforms``: whether it is a mesh's own shape. ``hides``: whether
    its entries hide each other from view, so that its value decides which are seen. ``axes``: (axis
    of the array, whether its last entry is the first one's neighbour), for each axis along which
    neighbours are alike.

    ``all_of``: (low, high) of what it may come to whatever its ``range``, as what has one length
    after every step does, or None. ``listed``: how a start of several numbers is to be given, in
    words; ``nested``: as lists within a list alone, where a plain one might mean either;
    ``repeats``: how many stand for all, as those of a part for every part, or 0.

    ``outlined``: whether alpha and masks tell it by the outline of what moves (``Contours``),
    as they do shapes and poses.

    ``order``: of those that write the same parameter, the lower comes first. ``settings``: what the
    configuration says of it beside ``scene.unknowns``, in a text that changes as that does.
    ``rewrites``: whether the truth, once it is written, is another than the file has: values are
    lifted from ends of ranges, and a shape's normals are its own.
    ``doublings``: how often a coarser version of it may double its resolution before it is whole;
    ``undivided``: what a user is told who wants levels of what has none. ``levels``: how many it
    passes through, as configured.
    ``carried``: whether a path's derivative by it is among those that integrators take; ``aside``:
    why it is not, where estimators take differences of renderings instead, or nothing.
    ``uniform``: whether Adam divides the steps of all entries by one number, and steps go along
    ``smoothed``. ``texture``: whose texels, laid out on meshes, are the unknown; the meshes are
    checked for it. ``colours``: whether its pictures show any. ``raw``: whether
    the scene takes its files' numbers as they are. ``turned``: whether the picture of a start is
    turned as its Orientation tag asks, which Mitsuba does not ask of its own files. ``role``:
    ``light``, ``colour`` or nothing, see ``Unknowns.traded``. ``doubtful``: whether ``doubt`` may
    have something to say. ``unheeded``: of the file it starts at, in words.
    """

    name: ClassVar[str] = "parameter"
    bare: tuple[float, float] = (0.0, 0.0)
    words: frozenset[str] = frozenset()
    moves_geometry: bool = False
    affine: bool = False
    deforms: bool = False
    hides: bool = False
    all_of: ClassVar[tuple[float, float] | None] = None
    listed: ClassVar[str] = "one per channel"
    nested: ClassVar[bool] = False
    repeats: int = 0
    outlined: bool = False
    period: float | None = None
    scale: float = 1.0
    axes: tuple[tuple[int, bool], ...] = ()
    order: tuple[int, int] = (0, 0)
    settings: str = ""
    texture: mi.Texture | None = None
    colours: bool = True
    raw: bool = False
    turned: bool = True
    uniform: bool = False
    doubtful: bool = False
    doublings: int = 0
    rewrites: bool = False
    levels: int = 1
    undivided: ClassVar[str] = "one level; leave it out"
    carried: bool = True
    aside: str = ""
    role: str = ""
    unheeded: Sequence[str] = ()
    _lifting: tuple[np.ndarray, np.ndarray] | None = None  # what was lifted, and to what

    @property
    def source(self) -> str:
        """The class that it is of, as no other package has it."""
        return f"{type(self).__module__}.{type(self).__qualname__}"

    @property
    def aims(self) -> bool:
        """Whether it says where a light shines."""
        return any(word.endswith(AIMS) for word in self.words)

    @classmethod
    def matches(cls, params: mi.SceneParameters, key: str) -> bool:
        """Whether the scene's parameter ``key`` is an unknown of this kind."""
        return False

    @classmethod
    def keys(cls, loaded: Loaded) -> list[str]:
        """The unknowns of this kind that the scene offers; names of their own are allowed."""
        return [key for key in loaded.params.keys() if cls.matches(loaded.params, key)]

    @classmethod
    def check(cls, loaded: Loaded, chosen: list[str]) -> None:
        """Raise InputError where the configuration speaks of unknowns of this kind that are not
        among the ``chosen`` ones."""

    def __init__(self, key: str, loaded: Loaded):
        """Reads the scene's value. Raises InputError where the configuration does not fit it."""
        self.key, self.writes = key, [key]
        value = loaded.params[key]
        self._type = type(value)
        self.present = as_numpy(value)
        *self.range, self.unit = usual(loaded.params, key)
        self.bare = bare(loaded.params, key)
        low, high = self.kept(*self.range)
        legal = (self.present >= self.range[0]) & (self.present <= self.range[1])
        kept = np.where(legal, np.clip(self.present, low, high), self.present).astype(np.float32)
        self.rewrites = not np.array_equal(kept, self.present, equal_nan=True)
        self._lifting = (self.present, kept) if self.rewrites else None
        self.present = kept
        if self.range[0] >= 0 and self.range[1] == np.inf:
            # A light or a density, which is added to nothing: in its unit it may be small.
            self.scale = min(1.0, float(np.abs(kept).max(initial=0.0))) or 1.0
        self.role = role(loaded.params, key)
        self.words = frozenset(word for _, word, _ in fed(loaded.params, key))

    def kept(self, low: float, high: float) -> tuple[float, float]:
        """The part of a range in which values stay: a hair from the kind's own ends where these
        have no derivative. An end elsewhere, beyond them or before, was asked for, and stays."""
        least, most = self.range[0] + self.bare[0], self.range[1] - self.bare[1]
        return (
            low if low != self.range[0] else lowest(low, least, np.asarray(high)),
            high if high != self.range[1] else most,
        )

    def heed(self, low: float, high: float) -> None:
        """Be told the range that is given, before anything begins: what the scene has is lifted no
        farther than into that."""
        file = self._unlifted
        if file is None:
            return
        low, high = self.kept(low, high)
        least, most = np.minimum(file, self.present), np.maximum(file, self.present)
        self.present = np.clip(np.clip(file, low, high), least, most)
        self._lifting = file, self.present
        self.rewrites = not np.array_equal(self.present, file, equal_nan=True)

    @property
    def _unlifted(self) -> np.ndarray | None:
        """``present`` before it was lifted, unless the kind has made another array of it."""
        file, lifted = self._lifting or (None, None)
        return file if lifted is self.present else None

    @property
    def lifted(self) -> int:
        """How many numbers of the scene were lifted from the lower end of their range."""
        file = self._unlifted
        return 0 if file is None else int((file < self.present).sum())

    def value(self, array: np.ndarray):
        """``array`` as the Dr.Jit value that estimators differentiate by, the *leaf*."""
        return like(self._type, array)

    def write(self, leaf, written: dict) -> None:
        """Put what ``leaf`` stands for into ``written``, values by parameter of the scene, into
        which the caller puts them.

        What an unknown of a lower ``order`` has put there is to be built upon. Traced and
        differentiable: derivatives by the scene's parameters flow back to the leaf on this way. A
        leaf that is put there itself is read back from the scene, as Mitsuba keeps it.
        """
        written[self.key] = leaf

    @property
    def topologies(self) -> "dict[str, dict[int, Topology]]":
        """Where it is a mesh's own shape: by the key of its vertices' positions, how its triangles
        hang together at each level that it passes through, by the number of vertices."""
        return {}

    def shape(self, doublings: int) -> tuple[int, ...]:
        """Of a version that doubles its resolution so often before it is whole."""
        return self.present.shape

    def coarse(self, array: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
        """The whole ``array`` in a coarser ``shape``."""
        return array

    def fine(self, leaf, shape: tuple[int, ...]):
        """What ``leaf`` stands for in a finer ``shape``; itself where that is its own. Traced and
        differentiable."""
        return leaf

    def whole(self, leaf) -> np.ndarray:
        """What ``leaf`` stands for, in the shape of the unknown."""
        return as_numpy(self.fine(leaf, self.present.shape))

    @property
    def decoded(self) -> bool:
        """Whether the numbers of a picture file are decoded as colours: data stay as stored."""
        return bool(self.role) and not self.raw

    def start(self, spec: str, where: str) -> np.ndarray:
        """The start that the configuration calls ``spec``: a file. Raises InputError, naming
        ``where``."""
        linear = None if self.decoded else True
        loaded = images.load(Path(spec), linear=linear, turned=self.turned)
        self.unheeded = [f"{where}: {line}" for line in images.unheeded([spec], [loaded.doubt])]
        picture = loaded.image
        if self.decoded and images.counted(spec):  # a profile's white may be a hair beyond ours
            picture = np.clip(picture, 0, 1)
        if self.present.shape[-1] == 1 and (picture == picture[..., :1]).all():
            picture = picture[..., :1]
        if self.texture is not None and 1 in picture.shape[:2]:
            # Mitsuba holds the only row or column of a texture's file twice.
            twice = [(0, int(n == 1)) for n in picture.shape[:2]]
            whole = np.pad(picture, [*twice, (0, 0)], mode="edge")
            picture = whole if whole.shape == self.present.shape else picture
        if picture.shape != self.present.shape:
            raise InputError(
                f"{where}: {spec} is {picture.shape}, the parameter {self.present.shape}"
            )
        return picture.astype(np.float32)

    def directed(self, gradient, value):
        """The direction of steps for a ``gradient`` at ``value``, where that is another; both as
        ``value`` makes them. Traced."""
        return gradient

    def compare(self, counts: np.ndarray) -> None:
        """Be told how many pixels of each view count, ``(V,)``, by their weights."""

    def smoothed(self, gradient: np.ndarray) -> np.ndarray:
        """Where ``uniform``: the direction of steps for a ``gradient``, on the host."""
        return gradient

    def refusal(self, array: np.ndarray) -> str | None:
        """Why the unknown cannot start at, or be, ``array``, which lies in the legal range."""
        return None

    def normal(self, array: np.ndarray) -> np.ndarray:
        """Of values that mean the same as ``array``, the one that the unknown starts at."""
        return array

    def projected(self, leaf):
        """``leaf`` after a step, within the range: the value next to it that it may have."""
        return leaf

    def seen(self, sensitivity: np.ndarray) -> np.ndarray:
        """Which entries count as seen, bool, from the images' ``sensitivity`` to each (in the
        unknown's shape, at least 0 or not a number). Not asked where geometry moves."""
        return well_seen(sensitivity)

    def error(self, array: np.ndarray, truth: np.ndarray, seen: np.ndarray) -> float:
        """Root mean square difference over the ``seen`` entries, the shorter way round where the
        unknown has a period. In its unit."""
        difference = (array - truth)[seen]
        if self.period:
            difference -= self.period * np.round(difference / self.period)
        return float(np.sqrt(np.mean(difference**2)))

    def numbers(self, array: np.ndarray, truth: np.ndarray | None) -> dict[str, float]:
        """What a row of the history says of ``array`` beside its error, by a name, which of a
        single number may be empty: the numbers themselves, where they are few."""
        if array.size > _FEW:
            return {}
        numbers = array.reshape(-1)
        return {str(i) if numbers.size > 1 else "": float(x) for i, x in enumerate(numbers)}

    def doubt(self, array: np.ndarray) -> str | None:
        """Why ``array`` is not to be trusted as a result."""
        return None

    def warnings(self) -> list[str]:
        """What a user should know before anything is spent."""
        return []

    def files(self, array: np.ndarray) -> dict[str, bytes]:
        """``array`` in files for other programs, by extension."""
        return {}

    def surface(self, array: np.ndarray, truth: np.ndarray | None) -> "Surface | None":
        """The surface that ``array`` is, where it is one, and how far it is from the truth."""
        return None

    def volume(self, array: np.ndarray) -> "np.ndarray | None":
        """A density that ``array`` is, ``(Z, Y, X)``, y up, at most 64 points a side, where it is
        one."""
        return None

    def pictures(self, array: np.ndarray) -> dict[str, np.ndarray]:
        """Pictures of ``array``, ``(H, W, 1 or 3) float32``, linear, by a name; the name of the
        only one, or of the main one, may be empty."""
        return {}

    def place(self, where: str) -> tuple["Kind", np.ndarray]:
        """This, and the middles of the parts that it moves, ``(parts, 3)``; raises InputError,
        naming ``where``, where there are none."""
        raise InputError(f"{where}: only for what a pose moves")


def well_seen(sensitivity: np.ndarray) -> np.ndarray:
    """Which entries reach ``THRESHOLD`` of a well seen one's sensitivity. Where no sensitivity is a
    number, all: something is seen, and the run will say what is wrong with it."""
    if not np.isfinite(sensitivity).any():
        return np.ones(sensitivity.shape, bool)
    finite = np.where(np.isfinite(sensitivity), sensitivity, 0)
    positive = finite[finite > 0]
    if positive.size == 0:
        return np.zeros(finite.shape, bool)
    return finite > THRESHOLD * np.quantile(positive, WELL_SEEN)


def picture(array: np.ndarray) -> dict[str, np.ndarray]:
    """``array`` as its own picture, where it is one."""
    return {"": array} if array.ndim == 3 and array.shape[2] in (1, 3) else {}
