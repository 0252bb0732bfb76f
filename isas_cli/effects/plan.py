"""What a run simulates: decided before its loop, from the settings, the scene and a short probe."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..estimators.estimator import Estimator
from ..rendering import coverage
from ..rendering.integrators import Integrator, Paths
from ..runtime import backend, guests
from ..runtime.cache import cached, digest
from ..runtime.errors import InputError
from ..scene.problem import Problem
from ..unknowns import cameras
from ..unknowns.ranges import fed, only_emits
from . import rules
from .probe import Cut, Lights, Probe, Share
from .settings import Effects
from .structure import UNLIMITED, clear, longest, statements

# Depths that are compared, and numbers of light samples (residual, derivative) with the directions
# that each is picked from: what is taken where nothing is measured first, then what saves most. The
# last is left out where one path gives both, by as many.
_LADDER = (2, 3, 4, 6, 8)
_PICKED = 4
_LIGHTS = (((1, 1), _PICKED), ((4, 4), _PICKED), ((1, 1), 1), ((4, 1), _PICKED))
# Of a derivative, where none is set and residuals vanish.
_TOLERANCE = 0.3
# A budget of so many seconds can pay for a probe, which takes at most this share of it and at most
# so many seconds.
_WORTH, _SHARE, _MOST = 10.0, 0.05, 3.0
_THIN = 0.1  # extinction along the side of a medium
_FORMAT = 29


@dataclass(frozen=True)
class Plan:
    """``paths``: as they are simulated; ``finish``: the last share of the budget with all effects;
    ``views``: those that are drawn from (None: all);
    ``statements``: effect → what is done about it, and why; ``cuts`` (of paths), ``derivatives``
    (of what is differentiated), ``samples``, ``caustics``: what the probe measured; ``work``:
    collisions of a path in a medium, at the start; ``seconds``, ``traced``: what it is billed, and
    the light paths that took (of checks of what is met, none)."""

    paths: Paths
    finish: float
    statements: dict[str, str]
    views: tuple[int, ...] | None = None
    cuts: tuple[Cut, ...] = ()
    derivatives: tuple[Cut, ...] = ()
    samples: tuple[Lights, ...] = ()
    caustics: Cut | None = None
    work: float = 0.0
    seconds: float = 0.0
    traced: int = 0

    def on(self, problem: Problem, finish: bool = False) -> Problem:
        """``problem``, its paths as planned; with all effects where it is the ``finish``."""
        whole = problem.integrator
        paths = self._finish(whole.paths) if finish else self.paths
        if paths != whole.paths:
            problem = _cut_to(problem, paths)
        return problem if self.views is None else problem.only(self.views)

    def staged(self, problem: Problem) -> bool:
        """Whether the last part of the budget differs from the first."""
        return self.finish > 0 and self._finish(problem.integrator.paths) != self.paths

    def _finish(self, whole: Paths) -> Paths:
        """All that ``whole`` has, by as many samples as before."""
        kept = "lights", "directions", "roulette", "crossed"
        own = {key: getattr(self.paths, key) for key in kept}
        return dataclasses.replace(whole, **own)

    def record(self) -> dict:
        """For the manifest."""
        return {
            "max_depth": _finite(self.paths.depth),
            "derivative_depth": _finite(self.paths.derivative),
            "light_samples": list(self.paths.lights),
            "directions": self.paths.directions,
            "roulette": self.paths.roulette,
            "caustics": self.paths.caustics,
            "views": None if self.views is None else list(self.views),
            "finish": self.finish,
            "probe_seconds": self.seconds,
            "probe_paths": self.traced,
            "work": self.work,
            "depths": [dataclasses.asdict(each) for each in self.cuts],
            "derivatives": [dataclasses.asdict(each) for each in self.derivatives],
            "lights": [dataclasses.asdict(each) for each in self.samples],
            "without_caustics": self.caustics and dataclasses.asdict(self.caustics),
        }


def _finite(depth: int) -> int | None:
    return None if depth == UNLIMITED else depth


def check(problem: Problem, settings: Effects, estimator: Estimator) -> None:
    """Raises InputError for what the integrator or the estimator cannot have. Needs no targets;
    traces nothing."""
    whole = problem.integrator
    follows = whole.cuts and estimator.plannable
    if (settings.cuts or settings.finish) and not follows:
        raise InputError(f"effects.…: {_unplannable(whole, estimator)}: take effects=full")
    if settings.derivative_depth is not None and not estimator.replays:
        raise InputError(
            f"effects.derivative_depth={settings.derivative_depth}: estimator={estimator.name} "
            "differentiates no paths: leave it out"
        )
    if not follows:
        return
    _depths(whole, settings)
    picks, lights = settings.directions not in (None, 1), settings.light_samples
    if (lights is not None or picks) and not whole.samples_lights:
        told = f"directions={settings.directions}" if picks else f"light_samples={lights}"
        raise InputError(
            f"effects.{told}: no light is sampled in a medium, a path finds it by leaving: leave "
            "it out"
        )
    if settings.caustics is not None and not whole.samples_lights:
        raise InputError(
            f"effects.caustics={str(settings.caustics).lower()}: no mirror or glass lights a "
            "medium here: leave it out"
        )


def decide(
    problem: Problem,
    settings: Effects,
    estimator: Estimator,
    loss,
    seconds: float | None = None,
    earlier: dict | None = None,
    described: str = "",
    prior: bool = False,
) -> Plan:
    """The plan for a run. What is set is done; what is not, a probe measures where ``seconds``, the
    budget, is one of time and can pay for it: with other budgets a run is to be the same on every
    machine. ``earlier``: the record of the plan of a run that goes on. ``described``: the loss in
    words, for the cache. ``prior``: whether there is one.

    Raises InputError as ``check`` does, and for a plan that drops the only paths to an unknown.
    """
    check(problem, settings, estimator)
    whole = problem.integrator
    if settings.derivative_tolerance is None:
        # Where residuals stay, they balance a prior, or each other, elsewhere than with all.
        rests = not all(unknown.moves(1.0) for unknown in problem.unknowns)
        vanish = settings.finish or problem.truth_known and not (prior or rests)
        asked = _TOLERANCE if vanish else settings.tolerance
        settings = dataclasses.replace(settings, derivative_tolerance=asked)
    follows = whole.cuts and estimator.plannable
    if whole.black_box:
        told = {"renderer": whole.name, "derivatives": estimator.derivatives(problem)}
        return Plan(whole.paths, 0.0, told)
    if earlier is not None:
        depth = earlier["max_depth"] or UNLIMITED
        paths = Paths(
            *(depth, earlier["derivative_depth"] or depth, tuple(earlier["light_samples"])),
            *(earlier["roulette"], earlier["caustics"]),
            directions=earlier["directions"],
        )
        kept = earlier["views"] and tuple(earlier["views"])
        plan, why = Plan(paths, settings.finish, {}, kept, seconds=earlier["probe_seconds"]), {}
    elif follows:
        # Renderings that are compared would differ by what they pick.
        if settings.directions is None and (
            not estimator.replays or cameras.unknown(problem.unknowns)
        ):
            settings = dataclasses.replace(settings, directions=1)
        paths = _as_set(problem, settings)
        crossed = estimator.differentiated(problem).integrator.paths.crossed
        found = Plan(dataclasses.replace(paths, crossed=crossed), settings.finish, {})
        carried = any(unknown.kind.carried for unknown in problem.unknowns)
        if settings.probe and carried and estimator.replays and (seconds or 0) >= _WORTH:
            measured = settings
            if estimator.own_lights:  # which others would not change
                ways = {"light_samples": list(paths.lights), "directions": paths.directions}
                measured = dataclasses.replace(settings, **ways)
            found = _probed(problem, measured, loss, min(_MOST, _SHARE * seconds), described, found)
        plan, why = _chosen(problem, settings, found)
        if estimator.own_lights and why.get("light samples") == "not measured":
            del why["light samples"]
    else:
        plan, why = Plan(whole.paths, settings.finish, {}), {}
    planned = plan.on(problem)
    told = statements(planned, estimator.derivatives(planned))
    if plan.paths.depth != whole.max_depth:
        told["paths"] += f"; {longest(whole.max_depth)} in the scene"
    if plan.views is not None:
        told["views"] = (
            f"{len(plan.views)} of {problem.views.count}: the others see no unknown at the start"
        )
    lights = plan.paths.lights
    if estimator.replays:
        told["differentiated"] = f"what comes by paths {longest(plan.paths.derivative)}"
    if plan.paths.roulette is not None:
        told["roulette"] = f"from vertex {plan.paths.roulette} on, as set"
    told["light samples"] = f"{lights[0]} for a residual"
    if not estimator.own_lights:
        told["light samples"] += f", {lights[1]} for a derivative"
    if plan.paths.directions > 1:
        told["light samples"] += f", each picked from {plan.paths.directions} directions"
    if estimator.own_lights:
        told["light samples"] += "; the derivative draws its own"
    if not whole.samples_lights:
        told["light samples"] = "none: a path finds its light by leaving the medium"
    for effect, reason in why.items():
        if effect != "caustics" or clear(planned):  # paths as planned may be too short for any
            told[effect] += f": {reason}"
    if plan.staged(problem):
        told["finish"] = f"the last {plan.finish:.0%} of the budget with all effects"
    return dataclasses.replace(plan, statements=told)


def _unplannable(whole: Integrator, estimator: Estimator) -> str:
    """Why paths are as the scene has them."""
    if whole.black_box:
        return "scene=external has pictures, and no paths"
    if whole.cuts:
        who = f"estimator={estimator.name} leaves the paths to Mitsuba, which"
    elif only_emits(whole.mitsuba):
        return "a medium that only emits has no part to leave out"
    elif whole.hide_emitters:
        who = "hide_emitters, also by photos.background=black, leaves the paths to Mitsuba, which"
    else:
        who = f"the scene's integrator {whole.name} is Mitsuba's and"
    return f"{who} traces them as the scene says"


def _as_set(problem: Problem, settings: Effects) -> Paths:
    """All that the scene has, but for what is set; light samples are picked. Raises InputError for
    what leaves no path to an unknown."""
    whole = problem.integrator
    depth, derivative = _depths(whole, settings)
    paths = Paths(
        *(depth, derivative, tuple(settings.light_samples or (1, 1)), settings.roulette),
        caustics=settings.caustics is not False,
        directions=settings.directions or (_PICKED if whole.samples_lights else 1),
    )
    for name, edges in (("max_depth", depth), ("derivative_depth", derivative)):
        if getattr(settings, name) is not None and edges < whole.max_depth:
            if key := _unmet(problem, Paths(edges, edges, caustics=paths.caustics)):
                limited = whole.max_depth != UNLIMITED
                most = f", at most the scene's {whole.max_depth}" if limited else ""
                raise InputError(
                    f"effects.{name}={edges}: no path of so few edges meets '{key}': give "
                    f"more{most}"
                )
    if not paths.caustics and clear(problem) and (key := _unmet(problem, paths)):
        raise InputError(
            f"effects.caustics=false: only light by way of mirrors or clear glass meets '{key}': "
            "leave it out"
        )
    return paths


def _unmet(problem: Problem, paths: Paths) -> str | None:
    """The key of an unknown that ``paths`` do not meet, and the scene's own do."""
    # One entry that is met is enough, and none must be overlooked.
    enough = np.nextafter(1, 0)
    lost = [key for key, share in _lost(problem, paths, enough)[0].items() if share == 1]
    whole = _lost(problem, problem.integrator.paths, enough)[0] if lost else {}
    unmet = next((key for key in lost if whole[key] < 1), None)
    if unmet is None and problem.unknowns.moving:
        unmet = coverage.unmoved(problem, _cut_to(problem, paths))
    return unmet


def _cut_to(problem: Problem, paths: Paths) -> Problem:
    return dataclasses.replace(problem, integrator=problem.integrator.cut(paths))


def _depths(whole: Integrator, settings: Effects) -> tuple[int, int]:
    """Edges of the longest path, and of the longest that is differentiated, as set."""
    depth = _at_most(whole.max_depth, settings.max_depth, "max_depth", "the scene's own paths have")
    derivative = _at_most(
        depth, settings.derivative_depth, "derivative_depth", "the paths to differentiate have"
    )
    return depth, derivative


def _at_most(whole: int, asked: int | None, name: str, what: str) -> int:
    if asked is not None and asked > whole:
        raise InputError(
            f"effects.{name}={asked}: {what} {longest(whole)}: at most that; scene.max_depth "
            "changes the scene"
        )
    return whole if asked is None else asked


def _chosen(problem: Problem, settings: Effects, found: Plan) -> tuple[Plan, dict[str, str]]:
    """``found`` with paths as set and else as measured, and why."""
    paths, why = found.paths, {}
    if settings.max_depth is not None:
        why["paths"] = "as set"
    elif found.cuts:
        depth, why["paths"] = rules.depth(found.cuts, settings.tolerance, paths.depth)
        paths = dataclasses.replace(paths, depth=depth, derivative=min(depth, paths.derivative))
    elif found.seconds and not problem.integrator.samples_lights and _empty(problem):
        why["paths"] = "not shortened, as the start is as good as empty"
    if settings.derivative_depth is not None:
        why["differentiated"] = "as set"
    elif found.derivatives:
        derivative, why["differentiated"] = rules.derivative(
            found.derivatives, settings.derivative_tolerance, paths.derivative
        )
        paths = dataclasses.replace(paths, derivative=min(derivative, paths.depth))
    if settings.light_samples is not None and settings.directions is not None:
        why["light samples"] = "as set"
    elif len(found.samples) > 1:
        chosen, why["light samples"] = rules.lights(found.samples)
        paths = dataclasses.replace(paths, lights=chosen.samples, directions=chosen.directions)
    elif found.seconds and problem.integrator.samples_lights:
        why["light samples"] = "not measured"
    if settings.caustics is not None:
        why["caustics"] = "as set"
    elif found.caustics is not None:
        caustics, why["caustics"] = rules.caustics(found.caustics, settings.tolerance)
        paths = dataclasses.replace(paths, caustics=caustics)
    if found.work:
        why["media"] = f"{found.work:.3g} collisions a path at the start"
    return dataclasses.replace(found, paths=paths), why


def _lost(
    problem: Problem, paths: Paths, enough: float, seconds: float | None = None
) -> tuple[dict[str, float], float]:
    """By key: of the entries that a view sees, the share that none of ``paths`` meets, no more
    exactly than whether it is above ``enough``; seconds spent. Nothing of the truth tells it. See
    ``coverage.missed``."""
    kinds = [u for u in problem.unknowns if u.kind.carried]
    judged = [u for u in kinds if not (u.kind.moves_geometry or u.unseen)]
    starts = {u.key: u.lit for u in judged}
    seen = {u.key: u.seen if u.told is None else u.told for u in judged}
    wide = {k: cone for k, cone in coverage.widest(problem).items() if k in starts}
    cut, found = _cut_to(problem, paths), ({}, 0.0)
    if judged:
        problem.unknowns.write(problem.unknowns.starts(lit=True))
        found = coverage.missed(cut, starts, seen, enough, seconds, wide)
    problem.unknowns.write(problem.unknowns.starts())
    return found


def _probed(
    problem: Problem, settings: Effects, loss, allowed: float, described: str, plan: Plan
) -> Plan:
    """``plan`` with what a probe of at most ``allowed`` seconds finds; from the cache where
    possible."""
    kinds = [(u.kind.settings, u.kind.source, u.low, u.high) for u in problem.unknowns]
    starts = problem.unknowns.start_hash, kinds, guests.installed()
    what = problem.content_hash, problem.target_hash, starts, described, mi.__version__
    asked = dataclasses.astuple(settings), allowed, dataclasses.astuple(plan.paths)
    # Where it was timed.
    machine = mi.variant(), dr.thread_count(), backend.device()
    key = "effects-" + digest("effects", _FORMAT, *what, *asked, *machine)

    def compute() -> dict[str, np.ndarray]:
        found = _measured(problem, settings, Probe(plan.on(problem), loss, 0, allowed), plan)
        return {"json": np.array(json.dumps(found.record()))}

    found = json.loads(str(cached(key, compute)["json"]))
    kept = found["views"]
    return dataclasses.replace(
        plan,
        views=kept and tuple(kept),
        cuts=tuple(_cut(row) for row in found["depths"]),
        derivatives=tuple(_cut(row) for row in found["derivatives"]),
        samples=tuple(
            Lights(**row | {"samples": tuple(row["samples"])}) for row in found["lights"]
        ),
        caustics=found["without_caustics"] and _cut(found["without_caustics"]),
        work=found["work"],
        seconds=found["probe_seconds"],
        traced=found["probe_paths"],
    )


def _cut(row: dict) -> Cut:
    image = row["image"] and Share(**row["image"])
    gradient = {key: Share(**share) for key, share in row["gradient"].items()}
    return Cut(**row | {"image": image, "gradient": gradient})


def _empty(problem: Problem) -> bool:
    """Of a scene that is a medium alone, whether its density is unknown and starts so thin that
    light hardly meets it twice, which tells nothing of how often it will scatter."""
    params = problem.unknowns.params
    size = float(dr.max(problem.scene.shapes()[0].bbox().extents()))
    return any(
        factor * unknown.start.max() * size < _THIN
        for unknown in problem.unknowns
        if unknown.key in params
        for _, word, factor in fed(params, unknown.key)
        if word == "sigma_t"
    )


def _measured(problem: Problem, settings: Effects, probe: Probe, plan: Plan) -> Plan:
    """What pays most first: a short budget ends before the rest. The derivative's depth from the
    shortest up to one that does; the paths' own from the longest down to one that does not."""
    paths, cuts, derivatives, samples, caustics = plan.paths, [], [], [], None
    checks, surfaces = 0.0, problem.integrator.samples_lights
    work = 0.0 if surfaces else probe.work()

    def unmet(own: Paths, views: tuple[int, ...] | None = None) -> float:
        """The largest share of an unknown's entries that ``own`` do not meet, in ``views``. Part of
        what the plan costs, and no part of the probe's share of the budget, of which all checks
        take no more than half."""
        nonlocal checks
        if checks >= probe.allowed / 2:
            return 1.0
        within = problem if views is None else problem.only(views)
        shares, seconds = _lost(within, own, rules.LOST, probe.allowed / 2 - checks)
        checks += seconds
        return max(shares.values(), default=0.0)

    def of_seen(found: Cut | None) -> Cut | None:
        """Without what no view sees: its gradient is zero, of which nothing is a share."""
        unseen = {unknown.key for unknown in problem.unknowns if unknown.unseen}
        if found is None or not unseen:
            return found
        shares = {key: share for key, share in found.gradient.items() if key not in unseen}
        return dataclasses.replace(found, gradient=shares)

    if surfaces and paths.depth > 1:
        ways = dict.fromkeys(
            (tuple(settings.light_samples or lights), settings.directions or directions)
            for lights, directions in _LIGHTS[: 3 if probe.problem.integrator.crosses else 4]
        )
        samples = probe.lights(paths, list(ways)) if len(ways) > 1 else []
    # In the finish a view may see an unknown that it does not see by shorter paths.
    # And where a light comes to shine later it shines nowhere yet.
    aims = any(unknown.kind.aims for unknown in problem.unknowns)
    views = None if plan.finish or aims else probe.views()
    if views is not None and unmet(paths, views) > rules.LOST:
        views = None  # one of the others shows in a few pixels what no more paths were to find
    ladder = [depth for depth in _LADDER if depth < paths.depth]
    if not surfaces and _empty(problem):
        ladder = []
    if settings.derivative_depth is None:
        for depth in ladder:
            found = of_seen(probe.cut(depth, derivative=True))
            if found is None:
                break
            derivatives.append(found)
            if rules.worst(found) < settings.derivative_tolerance:
                lost = unmet(dataclasses.replace(paths, derivative=depth))
                if lost <= rules.LOST:
                    paths = dataclasses.replace(paths, derivative=depth)
                    break
                derivatives[-1] = dataclasses.replace(found, lost=lost)
    # What paths do not carry, as exposures and cameras, is not among the shares of gradients.
    whole = any(u.kind.aside or not u.kind.carried for u in problem.unknowns)
    if settings.caustics is None and surfaces and clear(problem) and not whole:
        caustics = of_seen(probe.caustics())
        if caustics and rules.worst(caustics) < settings.tolerance:
            lost = unmet(dataclasses.replace(paths, caustics=False))
            caustics = dataclasses.replace(caustics, lost=lost)
            paths = dataclasses.replace(paths, caustics=lost > rules.LOST)
    if settings.max_depth is None and not whole:
        for depth in reversed(ladder):
            found = of_seen(probe.cut(depth, derivative=False))
            if found is None:
                break
            if rules.worst(found) < settings.tolerance and depth < paths.derivative:
                lost = unmet(dataclasses.replace(paths, depth=depth, derivative=depth))
                found = dataclasses.replace(found, lost=lost)
            cuts.insert(0, found)
            if not (rules.worst(found) < settings.tolerance and found.lost <= rules.LOST):
                break
    return dataclasses.replace(
        plan,
        views=views,
        cuts=tuple(cuts),
        derivatives=tuple(derivatives),
        samples=tuple(samples),
        caustics=caustics,
        work=work,
        seconds=probe.seconds + checks,
        traced=probe.paths,
    )
