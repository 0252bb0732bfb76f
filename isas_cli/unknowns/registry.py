"""Which kinds of unknown there are. The only place that knows them all."""

from __future__ import annotations

from ..runtime import guests
from . import routes
from .bumps import Bumps
from .direction import Direction
from .environment import Environment
from .exposure import Exposure
from .grid import Grid
from .kind import Kind, Loaded
from .motion import Motion
from .optics import Lens
from .outer import Outer
from .poses import Pose
from .poses import movable_in as movable  # noqa: F401  (ids of what poses can move)
from .texture import Texture
from .value import Value
from .vertices import Vertices

_KINDS: list[type[Kind]] = [
    *guests.loaded(guests.KINDS),
    *(Pose, Vertices, Exposure, Motion, Lens, Outer, Direction, Environment, Bumps, Texture, Grid),
    Value,  # whatever no other kind has taken
]


def register(kind: type[Kind]) -> type[Kind]:
    """Make a kind known, before all others: what it offers is its own. Usable as a decorator, for
    instance in the module of a scene's builder, which is imported before unknowns are read."""
    _KINDS.insert(0, kind)
    return kind


def kinds() -> tuple[type[Kind], ...]:
    """All kinds, in the order in which they are asked."""
    return tuple(_KINDS)


def offered(loaded: Loaded) -> dict[str, type[Kind]]:
    """What can be unknown in a scene and of which kind, names of their own before the scene's
    parameters, which come in its order."""
    if loaded.outside is not None:  # what stands for its scene is none
        return dict.fromkeys(Outer.keys(loaded), Outer)
    found: dict[str, type[Kind]] = {}
    for kind in _KINDS:
        for key in kind.keys(loaded):
            if key not in loaded.params or not routes.refusal(loaded.params, key):
                found.setdefault(key, kind)
    place = {key: number for number, key in enumerate(loaded.params.keys())}
    return dict(sorted(found.items(), key=lambda entry: place.get(entry[0], -1)))
