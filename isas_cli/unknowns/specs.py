"""What a configuration says of the unknowns, checked against the scene."""

from __future__ import annotations

import math
from collections.abc import Mapping

import mitsuba as mi
import numpy as np

from ..config.schema import PoseConfig
from ..runtime.errors import InputError, nearest
from . import registry, routes
from .kind import Kind, Loaded
from .parameters import as_numpy, is_float, moves_geometry, owner, read
from .ranges import around, lowest
from .smoothing import stable
from .unknowns import Unknown


def _start(spec, kind: Kind, loaded: Loaded, truth_known: bool) -> np.ndarray:
    current, key = kind.present, kind.key
    if spec is None:
        if truth_known:
            raise InputError(
                f"scene.unknowns['{key}'] has no start: without scene.targets the scene's own "
                "value is the truth; give start: a number, a list, an image file or {of: key}"
            )
        return current
    if isinstance(spec, Mapping) and "uniform" in spec:
        return _random_start(spec, key, current.shape)
    if isinstance(spec, Mapping):
        return _start_of_another(spec, key, current.shape, loaded)
    if isinstance(spec, str):
        return kind.start(spec, f"scene.unknowns['{key}'].start")
    try:
        if isinstance(spec, bool):
            raise TypeError
        if np.ndim(spec) == 1 and 0 < len(spec) == _repeated(kind, loaded):
            spec = np.tile(spec, current.size // len(spec))
        if kind.nested and np.ndim(spec) == 1:
            raise ValueError
        return np.broadcast_to(np.asarray(spec, np.float32), current.shape).copy()
    except (ValueError, TypeError):
        raise InputError(
            f"scene.unknowns['{key}'].start={spec} does not fit the parameter's shape "
            f"{current.shape}: give one number, or {kind.listed}"
        ) from None


def _repeated(kind: Kind, loaded: Loaded) -> int:
    """How many numbers of a start stand for all."""
    if kind.present.ndim == 1 and kind.key.rpartition(".")[2].startswith(("vertex_", "face_")):
        return routes.channels(loaded.params, kind.key)
    return kind.repeats


def _random_start(spec: Mapping, key: str, shape: tuple[int, ...]) -> np.ndarray:
    """``{uniform: [low, high], seed: n}``: every entry drawn by itself, for trials of starts."""
    where = f"scene.unknowns['{key}'].start={dict(spec)}"
    try:
        low, high = map(float, spec["uniform"])
        rng = np.random.default_rng(spec["seed"])
        if set(spec) != {"uniform", "seed"} or not low < high:
            raise ValueError
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{where}: give {{uniform: [low, high], seed: 1}}, low < high") from None
    return rng.uniform(low, high, shape).astype(np.float32)


def _start_of_another(
    spec: Mapping, key: str, shape: tuple[int, ...], loaded: Loaded
) -> np.ndarray:
    """``{of: other}``: what the scene was loaded with as ``other``, which may be unknown itself."""
    where = f"scene.unknowns['{key}'].start"
    if list(spec) != ["of"]:
        raise InputError(
            f"{where}={dict(spec)}: a mapping is {{of: another key}} or "
            "{uniform: [low, high], seed: 1}"
        )
    other, params = spec["of"], loaded.params
    valid = [k for k in params.keys() if k != key and is_float(read(params, k))]
    if other not in valid:
        raise InputError(
            f"{where}.of={other}: no other parameter that holds numbers; "
            f"{nearest(str(other), valid)}"
        )
    kind = registry.offered(loaded).get(other)
    value = kind(other, loaded).present if kind else as_numpy(params[other])
    if value.shape != shape:
        raise InputError(f"{where}: '{other}' is {value.shape}, the parameter {shape}")
    return value


def _range(spec, kind: Kind) -> tuple[float, float]:
    low, high = kind.range if spec is None else _given(spec, kind.key)
    return float(low), float(high)


def _given(spec, key: str) -> list[float]:
    if len(spec) != 2 or not spec[0] < spec[1]:
        raise InputError(
            f"scene.unknowns['{key}'].range={list(spec)}: give [low, high] with low < high"
        )
    return spec


def _doubled(levels, kind: Kind) -> tuple[float, ...]:
    """The shares of the budget at which resolutions double: ``levels`` is their number, each of
    which has twice the time of the one before, or those shares themselves. Coarse grids are soon
    as good as they can be."""
    where = f"scene.unknowns['{kind.key}'].levels={levels}"
    if isinstance(levels, int) and not isinstance(levels, bool) and levels >= 1:
        shares = [(2**number - 1) / (2**levels - 1) for number in range(1, levels)]
    else:
        try:
            shares = [float(share) for share in levels]
            if any(not 0 < a < b < 1 for a, b in zip(shares, [*shares[1:], 1 - 1e-9])):
                raise ValueError
        except (TypeError, ValueError):
            raise InputError(
                f"{where}: a number of levels, at least 1, or the shares of the budget at which "
                "the resolution doubles, rising between 0 and 1, such as [0.3, 0.6]"
            ) from None
    if shares and len(shares) > kind.doublings:
        least = kind.shape(kind.doublings)
        most = f"at most {kind.doublings + 1} levels, the coarsest of {least}"
        raise InputError(
            f"{where}: what it is of ({kind.name}, {kind.present.shape}) has "
            f"{most if kind.doublings else kind.undivided}"
        )
    return tuple(shares)


def narrow_blurs(unknowns: list[Unknown]) -> list[str]:
    """A warning for each unknown whose last blur is narrower than single precision resolves."""
    found = []
    for unknown in (u for u in unknowns if u.blur is not None):
        wanted = np.full(unknown.start.size, unknown.blur.end)
        width = stable(wanted, unknown.start.reshape(-1), unknown.scale).max()
        if width > unknown.blur.end:
            found.append(
                f"scene.unknowns['{unknown.key}'].blur.end={unknown.blur.end:g}: single precision "
                f"resolves no less than {width:.2g} there, which is the width instead"
            )
    return found


def parse(
    params: mi.SceneParameters,
    specs: dict,
    truth_known: bool,
    poses: dict[str, PoseConfig] | None = None,
    of_views: dict | None = None,
    begins: bool = True,
) -> list[Unknown]:
    """Check the configured unknowns against the scene and read starts and truths.

    ``specs``: key → object with ``start``, ``range``, ``lr``, ``blur``, ``levels``
    (``config.UnknownConfig``); ``poses``: those of the configuration, by name; ``of_views``: what
    of ``Loaded`` is of photographs; ``begins``: whether anything begins at the starts, which are
    else what the scene happens to hold, and are not checked.
    Raises InputError for an unknown key (nearest and all that a kind offers listed), for one that
    no kind can handle, an illegal range, a start outside it, or when there is no unknown.
    """
    loaded = Loaded(params, dict(poses or {}), **(of_views or {}))
    offered = registry.offered(loaded)
    if not offered:
        raise InputError("the scene has no differentiable parameter to recover")
    if not specs:
        raise InputError(
            f"scene.unknowns is empty: name what to recover; valid: {', '.join(offered)}"
        )
    found = []
    for key, spec in specs.items():
        if key not in offered:
            raise InputError(f"scene.unknowns: {_unfit(params, key, list(offered))}")
        found.append(_unknown(offered[key](key, loaded), spec, loaded, truth_known, begins))
    for kind in registry.kinds():
        kind.check(loaded, list(specs))
    _check_shared([unknown.kind for unknown in found])
    if begins:
        _check_cones({unknown.key: unknown for unknown in found})
    check_stages(found)
    return found


def _check_shared(kinds: list[Kind]) -> None:
    """Raise InputError where two write one parameter and neither is made to build on the other, as
    poses are: what the first has put there would be lost."""
    writer: dict[tuple, str] = {}
    for kind in kinds:
        for name in kind.writes:
            other = writer.setdefault((name, kind.order), kind.key)
            if other != kind.key:
                raise InputError(
                    f"scene.unknowns: '{other}' and '{kind.key}' both write the scene's parameter "
                    f"'{name}', so that one of them would have no effect: leave one out"
                )


def _check_cones(unknowns: dict[str, Unknown]) -> None:
    """Raise InputError where a spot's beam may come to be wider than its cone."""
    for key, beam in unknowns.items():
        holder, _, word = key.rpartition(".")
        cone = unknowns.get(f"{holder}.cutoff_angle") if word == "beam_width" else None
        if cone is not None and not beam.high < cone.low:
            beams, cones = (
                [each.item() for each in (u.start, u.truth) if each is not None]
                for u in (beam, cone)
            )
            below, above = max(beams), min(cones)
            might = (
                f"scene.unknowns: '{key}' may be up to {beam.high:g} and '{cone.key}' from "
                f"{cone.low:g} on, so that they might cross"
            )
            if below >= above:
                raise InputError(
                    f"{might}, and no ranges part a beam of {below:g} from a cone of {above:g}: "
                    "let starts and truths of the beam lie below those of the cone, or leave one "
                    "of the two out"
                )
            middle, apart = (below + above) / 2, min(0.1, (above - below) / 4)
            raise InputError(
                f"{might}: give both a range, such as "
                f"[{beam.low:g}, {middle - apart:g}] and [{middle:g}, {cone.high:g}]"
            )


def check_stages(unknowns: list[Unknown]) -> None:
    """Raise InputError where at some share of the budget nothing would move."""
    for share in sorted({0.0, *(s for u in unknowns for s in u.during if s < 1)}):
        if not any(u.moves(share) for u in unknowns):
            raise InputError(
                f"scene.unknowns: from the share {share:g} of the budget on no unknown moves: let "
                "the stages that during gives follow one another, from 0 to 1"
            )


def _unfit(params: mi.SceneParameters, key: str, valid: list[str]) -> str:
    """Why no kind offers ``key``, and what is valid."""
    if key in params and params.flags(key) & mi.ParamFlags.ReadOnly:
        return (
            f"'{key}' follows from other numbers of the file, by which nothing is differentiated; "
            f"valid: {', '.join(valid)}"
        )
    if key in params and (reason := routes.refusal(params, key)):
        return f"'{key}': {reason}; valid: {', '.join(valid)}"
    if key in params and key.endswith(".data") and not is_float(params[key]):
        return (
            f"'{key}' holds whole numbers, by which nothing is differentiated: take the format of "
            f"this bitmap out of the file; valid: {', '.join(valid)}"
        )
    id, _, word = key.rpartition(".")
    movable = id in registry.movable(params)
    if key in params and (moves_geometry(params, key) or word == "control_points"):
        shaped = word == "vertex_positions" and f"{id}.vertices" in valid
        how = f", or find its shape, '{id}.vertices', by estimator=silhouettes" if shaped else ""
        what = "the object" if movable else "an instance of a shapegroup with it"
        return (
            f"'{key}' moves geometry, whose visibility path replay does not differentiate; move "
            f"{what} by scene.poses and sampler=plateau{how}; valid: {', '.join(valid)}"
        )
    own = _held_by(params, key, valid)
    if own:
        return f"'{key}': the key of what '{key.partition('.')[0]}' holds is {' or '.join(own)}"
    how = f": scene.poses moves '{id}'" if movable and word in ("to_world", "position") else ""
    return f"'{key}' is no differentiable parameter{how}; {nearest(key, valid)}"


def _held_by(params: mi.SceneParameters, key: str, valid: list[str]) -> list[str]:
    """Of ``valid`` keys those that go on like ``key`` after its first name, and lie within the
    object of that id: parts of a shape are called by what they are to it."""
    head, _, rest = key.partition(".")

    def within(thing) -> bool:
        while thing is not None and thing.id() != head:
            thing = params.hierarchy[thing][0]
        return thing is not None

    same = [each for each in valid if each in params and each.endswith(f".{rest}")]
    return [f"'{each}'" for each in same if rest and within(owner(params, each))]


def _instead(key: str, low: float, high: float, own: np.ndarray) -> str:
    """What to do where the scene's ``own`` value lies outside its range."""
    if high == 1 < own.max() <= 255 and "vertex_" in key and own.min() >= 0:
        return (
            "Mitsuba takes a mesh's colours of 8 bits as they stand, up to 255: divide them by 255"
        )
    return f"give range: {around(low, high, own)}"


def _unknown(kind: Kind, spec, loaded: Loaded, truth_known: bool, begins: bool) -> Unknown:
    where = f"scene.unknowns['{kind.key}']"
    low, high = _range(spec.range, kind)
    if spec.range is not None:
        kind.heed(low, high)
    start = _start(spec.start, kind, loaded, truth_known)
    if kind.all_of is not None and not (low <= kind.all_of[0] and high >= kind.all_of[1]):
        raise InputError(
            f"{where}.range: a {kind.name} has length 1 after every step, whatever the range: "
            "leave it out"
        )
    finite = np.all(np.isfinite(start))
    if begins and not (finite and start.min() >= low and start.max() <= high):
        told = f"lies outside its range [{low:g}, {high:g}]"
        if spec.start is not None:
            raise InputError(f"{where}.start {told}")
        instead = _instead(kind.key, low, high, start) if finite else "mend its file"
        raise InputError(
            f"{where}: the scene's own value, the start, {told}; {instead}, or give another start"
        )
    reason = begins and kind.refusal(start)
    if reason:
        raise InputError(f"{where}.start: {reason}")
    start = kind.normal(start)
    if spec.lr is not None and not 0 < spec.lr < math.inf:
        raise InputError(f"{where}.lr={spec.lr}: must be a finite number above 0")
    truth = kind.present if truth_known else None
    if truth is not None and not np.all(np.isfinite(truth)):
        count = int((~np.isfinite(truth)).sum())
        raise InputError(
            f"{where}: the scene's own value, the truth: {count} of its {truth.size} numbers are "
            "not finite: mend its file"
        )
    if truth is not None and (truth.min() < low or truth.max() > high):
        raise InputError(
            f"{where}: the scene's own value, the truth, is outside its range "
            f"[{low:g}, {high:g}]; {_instead(kind.key, low, high, truth)}"
        )
    reason = truth is not None and kind.refusal(truth)
    if reason:
        raise InputError(f"{where}: the scene's own value, the truth: {reason}")
    during = (0.0, 1.0) if spec.during is None else tuple(spec.during)
    doubled = _doubled(spec.levels, kind)
    kind.levels = len(doubled) + 1  # before anyone asks what it writes
    least, high = kind.kept(low, high)
    low = lowest(low, least, start)
    start = np.clip(start, low, high).astype(np.float32)
    return Unknown(
        *(kind, start, truth, low, high, spec.lr, spec.blur),
        **dict(during=during, doubled=doubled),
        **dict(schedule=spec.schedule, final=spec.final, prior=spec.prior),
    )
