"""What a scene offers as unknowns, and what can be said of each before anything is run."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mitsuba as mi

from ..config.schema import SceneConfig
from ..rendering import lobes, onlookers, trial, undone
from ..runtime import memory
from ..runtime.errors import InputError
from ..scene import mesh_checks
from ..unknowns import registry, verdicts
from ..unknowns.kind import Kind, Loaded
from ..unknowns.ranges import glows
from ..unknowns.unknowns import Unknown
from . import assemble

_APART = "emission takes an extinction that is alike in all channels: give it as one number"


@dataclass
class Offer:
    """One key. ``kind``: in words; ``shape``: of its array; ``low``, ``high``: the range that it is
    kept in where none is given, in its ``unit``; ``estimator``: which takes it; ``views``: the
    numbers of those that see it, None where no path tells; ``refused``: why the scene's own state
    does not allow it; ``verdict`` and ``note``: of the census on derivatives by it, where it is a
    parameter of Mitsuba's."""

    key: str
    kind: str
    shape: tuple[int, ...] = ()
    low: float = -math.inf
    high: float = math.inf
    unit: str = ""
    estimator: str = ""
    views: list[int] | None = None
    refused: str = ""
    verdict: str = ""
    note: str = ""


@dataclass
class Offers:
    """``count`` of views; ``movable``: ids of objects that poses can move."""

    found: list[Offer]
    count: int
    movable: list[str]


def of(scene: SceneConfig) -> Offers:
    """Loads the scene and asks. Raises InputError for a scene that cannot be loaded."""
    offers: dict[str, Offer] = {}
    textures: dict[str, mi.Texture] = {}
    movable: list[str] = []

    def every(params, specs, truth_known, poses, of_views) -> list[Unknown]:
        """All that path replay differentiates, as it stands in the scene."""
        loaded = Loaded(params, dict(poses or {}), **(of_views or {}))
        movable.extend(registry.movable(params))
        replayed, kinds = [], []
        for key, kind in registry.offered(loaded).items():
            try:
                made = kind(key, loaded)
            except InputError as error:
                offers[key] = Offer(key, kind.name, refused=str(error))
                continue
            offers[key] = _offer(made, loaded.outside is not None)
            if made.texture is not None:  # asked below
                textures[key], made.texture = made.texture, None
            if key in params:
                what = verdicts.place(params, key)
                offers[key].verdict, offers[key].note = (
                    verdicts.verdict(*what),
                    verdicts.note(*what),
                )
            if made.carried and not made.moves_geometry:
                kinds.append(made)
        hidden = {*lobes.hidden(params, [key for made in kinds for key in made.writes])}
        for made in kinds:
            if hidden.intersection(made.writes):
                offers[made.key].refused = lobes.HIDDEN
            elif "sigma_t" in made.words and made.present.shape[-1] == 3 and glows(params):
                offers[made.key].refused = _APART
            else:
                replayed.append(Unknown(made, made.present, made.present, *made.range, None))
        return replayed

    problem = assemble.bare(scene, every)[0]
    if problem.integrator.black_box:
        return Offers(list(offers.values()), problem.views.count, [])
    try:
        for key, views in onlookers.of(problem).items():
            offers[key].views = views
    except RuntimeError as error:
        if memory.exhausted(error):
            raise
        raise trial.untraceable(assemble.where_of(scene), error) from error
    for missed in undone.missed(problem):
        offers[missed.key].refused = undone.reason(problem.integrator, [missed])
    try:
        mesh_checks.check_scene(problem.scene, textures)
    except InputError:
        # One by one only where one is refused: all meshes are gone through each time.
        for key, texture in textures.items():
            try:
                mesh_checks.check_scene(problem.scene, {key: texture})
            except InputError as error:
                offers[key].refused = str(error)
    return Offers(list(offers.values()), problem.views.count, movable)


def _offer(made: Kind, outside: bool) -> Offer:
    if outside:
        estimator = "plateau"
    elif not made.moves_geometry:
        estimator = "two_path"
    else:
        estimator = "silhouettes" if made.uniform else "plateau"
    low, high = map(float, made.range)
    return Offer(made.key, made.name, made.present.shape, low, high, made.unit, estimator)
