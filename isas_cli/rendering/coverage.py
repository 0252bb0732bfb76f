"""Which entries of the unknowns any view sees."""

from __future__ import annotations

import hashlib
import itertools
import time

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import guests, streams
from ..runtime.backend import sync
from ..runtime.cache import cached, digest
from ..runtime.errors import InputError
from ..scene.problem import Problem
from ..unknowns.kind import THRESHOLD, WELL_SEEN
from ..unknowns.parameters import as_numpy
from ..unknowns.ranges import only_emits
from ..unknowns.unknowns import Unknown
from . import rays, undone
from .integrators import Integrator
from .kernels import recorded
from .renderer import Renderer

_LANES = 1 << 20
_LEAST = 1 << 10  # visits of a pass: a meter's single pixel is looked through so often
_MOST = 1 << 24  # pixels visited; above this a stratified subset of them
_SAMPLES = 4  # paths a pixel, where all fit into one pass
_ALONE = _SAMPLES * _LEAST  # paths of a view that is looked through less than ``_LEAST`` times
# ``missed`` asks first by some paths for each entry, within these numbers, and each time by twice
# as many, until twice as many show less than this share of what was missed.
_FIRST, _EACH, _WORTH = (1 << 12, 1 << 16), 4, 0.1
_WARM_UP = 2  # the first call compiles
# ``unmoved`` looks at so many places, by at most so many pixels.
_PLACES, _LOOKED_AT = 8, 1 << 16
_ANY = 1 << 20  # edges: as good as no limit
_DIFFER = 1e-3  # of radiance: more than rounding
_WIDEST = 89.0  # degrees of a spot's cone: of a right angle the tangent is infinite
# What materials heed only beside another parameter, by their word for it.
_ON = "give that a value, or make it unknown as well"
_OFF = {
    "clearcoat_gloss": f"while 'clearcoat' is 0: {_ON}",
    "sheen_tint": f"while 'sheen' is 0: {_ON}",
    **dict.fromkeys(("eumelanin", "pheomelanin"), "beside a 'sigma_a': take that out of the file"),
}


def fill_in(problem: Problem, seed: int) -> None:
    """Set ``seen`` and ``unseen`` of every unknown, from the cache where possible.

    Of what moves geometry, and of what paths do not carry, all entries count. The others are judged
    by what path replay differentiates, at the start values, dark lights lit; where the truth is
    known, also with lamps and what moves as they are in it: an entry counts that is seen by either.
    One that shows itself only on the way between is left out of the errors. Where entries hide each
    other, as those of volumes do, they are judged with all unknowns at the truth, where that is
    known and shows any.

    The truth says what counts in errors alone. What a run goes by, ``told``, is what is seen at the
    start and with ``widest`` cones; where no truth is known that is what counts.

    Raises InputError for an unknown that was asked for and that no view sees: nothing could be
    learnt about it. Where something moves that cannot be told, and all entries of such an unknown
    count.
    """
    judged = replayed(problem)
    arrays = cached(_key(problem, seed), lambda: _judge(problem, judged, seed)) if judged else {}
    for unknown in problem.unknowns:
        unknown.seen, unknown.unseen = np.ones(unknown.start.shape, bool), False
        unknown.told = None
    some = any(arrays[f"seen{index}"].any() for index in range(len(judged)))
    for index, unknown in enumerate(judged):
        seen, told = (arrays[f"{w}{index}"].reshape(unknown.start.shape) for w in ("seen", "told"))
        if seen.any():
            unknown.seen, unknown.told = seen, told if told.any() else np.ones_like(told)
        elif some and not (unknown.asked or problem.unknowns.moving):
            unknown.unseen = True
            problem.warnings.append(f"'{unknown.key}': no view sees it: it stays where it starts")
        elif not problem.unknowns.moving:
            by, way = _short(problem.integrator)
            if problem.mask is not None:
                by += " in a pixel that counts"
                way += "let masks and weights leave pixels that show it, "
            if problem.integrator.samples_lights and unknown.kind.words & {"sigma_t", "albedo"}:
                way += "let paths into its medium (the integrator volpath, a shape of bsdf null), "
            raise InputError(
                f"scene.unknowns['{unknown.key}']: no view sees it{by}, so no image can tell its "
                f"value; {way}turn a camera towards it or take it off the list"
                + "".join(f"; or it has no effect {_OFF[w]}" for w in unknown.kind.words & {*_OFF})
            )


def _short(integrator: Integrator) -> tuple[str, str]:
    """That paths may be too short to show anything, and what to do."""
    depth = integrator.max_depth
    if depth >= _ANY or only_emits(integrator.mitsuba):
        return "", ""
    by = f" by paths of at most {depth} edges"
    if depth == 1:
        by = " by paths of one edge, which show lights alone"
    return by, f"take scene.max_depth={depth + 1} or more, "


def replayed(problem: Problem) -> list[Unknown]:
    """The unknowns that path replay differentiates by: what paths carry and no geometry moves, but
    for what the scene's integrator misses."""
    missed = {u.key for u in undone.missed(problem)}
    carried = [u for u in problem.unknowns if u.kind.carried and u.key not in missed]
    return [u for u in carried if not u.kind.moves_geometry]


def _key(problem: Problem, seed: int) -> str:
    # What is seen depends on the start.
    unknowns = [
        (
            u.key,
            u.kind.source,
            u.kind.settings,
            u.truth is not None,
            (u.low, u.high),
            hashlib.blake2b(u.start.tobytes()).hexdigest(),
        )
        for u in problem.unknowns
    ]
    masked = "" if problem.mask is None else problem.target_hash
    what = problem.content_hash, unknowns, masked, seed, guests.installed(), mi.variant()
    return "coverage-" + digest("coverage", 11, *what, mi.__version__, THRESHOLD, WELL_SEEN)


def _judge(problem: Problem, judged: list[Unknown], seed: int) -> dict[str, np.ndarray]:
    """Which entries count as seen, by ``seen<index>`` among ``judged``, and ``told<index>``."""
    unknowns = problem.unknowns
    starts = {u.key: u.lit for u in unknowns}
    seen = {u.key: np.zeros(u.start.shape, bool) for u in judged}

    def look(
        values: dict[str, np.ndarray], at: list[Unknown], before: dict[str, np.ndarray]
    ) -> dict[str, np.ndarray]:
        """``before``, and what is seen of ``at`` at ``values``."""
        at = [u for u in at if not before[u.key].all()]
        if not at:
            return before
        unknowns.write(unknowns.values_of(values))
        found = measure(problem, {u.key: values[u.key] for u in at}, seed)
        return before | {u.key: before[u.key] | u.kind.seen(found[u.key]) for u in at}

    truths = {u.key: u.truth for u in unknowns} if problem.truth_known else {}
    if truths:
        seen = look(truths, [u for u in judged if u.kind.hides], seen)
    others = [u for u in judged if not seen[u.key].any()]
    told = look(starts, judged, {u.key: np.zeros(u.start.shape, bool) for u in judged})
    seen = seen | {u.key: told[u.key] for u in others}
    if wide := widest(problem):
        told = look(starts | wide, judged, told)
    if not truths:
        seen = told
    elif there := [u for u in unknowns if _shows(u)]:
        seen = look(starts | {u.key: truths[u.key] for u in there}, others, seen)
    unknowns.write(unknowns.starts())
    both = {"seen": seen, "told": told}
    return {f"{w}{i}": found[u.key] for w, found in both.items() for i, u in enumerate(judged)}


def _shows(unknown: Unknown) -> bool:
    """Whether it decides what can be seen of others: a lamp, or what moves."""
    kind = unknown.kind
    return kind.moves_geometry or kind.role == "light" or kind.aims


def widest(problem: Problem) -> dict[str, np.ndarray]:
    """By key, the cones of spots that are unknown as wide as they may come to be."""
    cones = [u for u in problem.unknowns if "cutoff_angle" in u.kind.words]
    return {u.key: np.full_like(u.start, min(u.high, _WIDEST)) for u in cones}


def measure(problem: Problem, values: dict[str, np.ndarray], seed: int) -> dict[str, np.ndarray]:
    """Largest of |Σ_j ∂I_j/∂θ_k| and |Σ_j ±∂I_j/∂θ_k| per entry, by key of ``values``, at which
    they are taken; all other unknowns stay where they are in the scene.

    Two backward passes over all pixels: one with unit adjoint, which is strong for reflectances,
    and one with random signs, which does not vanish where derivatives of both signs meet. Views of
    much fewer pixels than others, through which these hardly look, such as meters beside cameras,
    have both by themselves as well, and what is larger counts.
    """
    unknowns = problem.unknowns
    total = problem.views.total
    visited = min(max(total, _LEAST), _MOST)
    lanes = min(visited, _LANES)
    passes = -(-visited // lanes)
    samples = _SAMPLES if visited <= _LANES else 1
    run, alone = Pass(problem, lanes), Pass(problem, _ALONE)
    stride, start = total / visited, 0
    # Of each call: its pass, first pixel and stride, and what it counts beside the others.
    every = [(run, int(i % passes * lanes * stride), stride, 1.0) for i in range(passes * samples)]
    few = []
    most = max(width * height for width, height in problem.views.sizes)
    for width, height in problem.views.sizes:
        visits = samples * width * height / stride
        if visits < _LEAST and 16 * width * height < most:
            few.append((alone, start, width * height / _ALONE, visits / _ALONE))
        start += width * height
    parts = [(0, every), (len(every), few)] if few else [(0, every)]
    largest: dict[str, np.ndarray] = {}
    for signed, (number, calls) in itertools.product((False, True), parts):
        unknowns.attach(unknowns.values_of(values))
        sums: dict[str, np.ndarray] = {}
        for i, (call, first, apart, share) in enumerate(calls, number):
            call(first, apart, streams.seed(seed, 2 * i + signed, "coverage"), signed)
            dr.sync_thread()
            for key, gradient in unknowns.taken().items():
                if key in values:
                    sums[key] = sums.get(key, 0) + share * as_numpy(gradient)
        for key in values:
            found = np.abs(sums[key])
            largest[key] = np.fmax(largest[key], found) if key in largest else found
    return largest


def missed(
    problem: Problem,
    values: dict[str, np.ndarray],
    seen: dict[str, np.ndarray],
    enough: float,
    seconds: float | None = None,
    other: dict[str, np.ndarray] | None = None,
) -> tuple[dict[str, float], float]:
    """By key of ``values``: of the entries that count as ``seen``, the share without a derivative
    by the paths of ``problem``; an upper bound, as long as it is above ``enough``. Seconds spent,
    without compiling. ``seconds``: after which to give up, or where the last paths showed little;
    None: not before there were four paths a pixel. ``other``: by some keys of ``values``, what
    every second launch of paths has instead, so that these are half of them.

    Every path's derivative has a random sign, so that no sums vanish.
    """
    unknowns, total, spent = problem.unknowns, problem.views.total, 0.0
    left = {key: np.flatnonzero(seen[key].ravel()) for key in values}  # those not met so far
    counts = {key: max(entries.size, 1) for key, entries in left.items()}
    worst, number = 1.0, 0
    lanes = int(np.clip(_EACH * max(counts.values()), *_FIRST))
    run, stride = Pass(problem, lanes), total / lanes

    def trace(number: int) -> None:
        at = values | (other or {}) if number % 2 else values
        unknowns.attach(unknowns.values_of(at))
        first = int(np.random.default_rng(number).random() * stride)
        run(first, stride, streams.seed(0, number, "coverage"), True)
        sync()

    for _ in range(_WARM_UP):
        trace(0)
    while True:
        for _ in range(max(number, 1)):
            begun, number = time.perf_counter(), number + 1
            trace(number)
            for key, gradient in unknowns.gradients().items():
                if key in left:
                    left[key] = left[key][as_numpy(gradient).ravel()[left[key]] == 0]
            spent += time.perf_counter() - begun
            if seconds is not None and spent >= seconds:
                break
        shares = {key: entries.size / counts[key] for key, entries in left.items()}
        earlier, worst = worst, max(shares.values())
        hopeless = worst > (1 - _WORTH) * earlier and number > 1
        given_up = seconds is not None and (hopeless or spent >= seconds)
        if worst <= enough or given_up or number * lanes >= _SAMPLES * min(total, _MOST):
            return shares, spent


def unmoved(problem: Problem, cut: Problem) -> str | None:
    """The key of an unknown that moves what is visible in the images of ``problem``, and nothing in
    those of ``cut``, the same with other paths: of places within the blur around its start, seen by
    paths of the same random numbers. Evaluates; leaves the unknowns at their starts."""
    unknowns, total = problem.unknowns, problem.views.total
    rng, count = np.random.default_rng(0), min(problem.views.total, _LOOKED_AT)
    spread = (np.arange(count) + rng.random(count)) * (total / count)
    pixel = mi.UInt32(np.minimum(spread, total - 1).astype(np.uint32))
    counts = np.ones(count) if problem.mask is None else np.array(problem.mask)[np.array(pixel)]
    starts = {u.key: u.start for u in unknowns}

    def moves(seen: Problem, key: str, places: list[np.ndarray]) -> bool:
        renderer = Renderer(seen)

        def shown(place: np.ndarray) -> np.ndarray:
            unknowns.write(unknowns.values_of(starts | {key: place}))
            found = renderer.pixels(pixel, 1, lambda _: streams.seed(0, 0, "coverage"))
            return np.where(counts > 0, np.array(found), 0)

        here = shown(starts[key])
        return any(
            np.any(np.abs(there - here) > _DIFFER * np.maximum(there, here))
            for there in map(shown, places)
        )

    def found(key: str) -> bool:
        u = unknowns[key]
        offsets = rng.normal(0, u.blur.start, (_PLACES, *u.start.shape))
        places = list(np.clip(u.start + offsets, u.low, u.high).astype(np.float32))
        return not moves(cut, key, places) and moves(problem, key, places)

    key = next(filter(found, (key for key in unknowns.moving if unknowns[key].blur)), None)
    unknowns.write(unknowns.starts())
    return key


class Pass:
    """Adds derivatives of ``lanes`` pixels, ``stride`` apart from the ``first``, to the leaves'
    gradients (``Unknowns.attach`` first): all with weight 1, or ``signed``, each with a random
    sign."""

    def __init__(self, problem: Problem, lanes: int):
        self.problem = problem
        self._kernel = recorded(spread(problem.integrator, lanes), problem)

    def __call__(self, first: int, stride: float, seed: int, signed: bool) -> None:
        p = self.problem
        opaque = dr.opaque(mi.UInt32, first), dr.opaque(mi.Float64, stride)
        drawn = dr.opaque(mi.UInt32, seed), dr.opaque(mi.Bool, signed)
        self._kernel(*p.traced, p.mask, *opaque, *drawn)


def spread(integrator: Integrator, lanes: int):
    """What a ``Pass`` does."""

    def kernel(scene, sensors, views, leaves, mask, first, stride, seed, signed):
        with dr.suspend_grad():
            chosen = first + mi.UInt32(mi.Float64(dr.arange(mi.UInt32, lanes)) * stride)
            inside = chosen < views.total  # the last pass may reach beyond
            pixel = dr.minimum(chosen, views.total - 1)
            view, column, row = views.locate(pixel)
            stream = rays.stream(seed, lanes)
            ray, weight = rays.spawn(sensors, views, view, column, row, stream)
            sign = dr.select(stream.next_1d() < 0.5, mi.Float(-1), 1)
            counts = rays.masked(dr.select(inside, mi.Float(1), 0), mask, pixel)
            adjoint = mi.Color3f(dr.select(signed, sign, 1) * counts) * weight
            integrator.backward(scene, stream, ray, adjoint)

    return kernel
