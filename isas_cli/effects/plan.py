"""What a run simulates: decided before its loop, from the settings, the scene and a short probe."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..rendering import coverage
from ..runtime.cache import cached, digest
from ..runtime.errors import InputError
from .probe import Depth, Lights, Probe, Share
from .settings import Effects
from .structure import UNLIMITED, longest, statements

if TYPE_CHECKING:
    from ..estimators.estimator import Estimator
    from ..scene.problem import Problem

# Depths that are compared, and numbers of light samples (residual, derivative).
_LADDER = (2, 3, 4, 6, 8)
_LIGHTS = ((1, 1), (4, 1), (4, 4))
# A budget of so many seconds can pay for a probe.
_WORTH = 10.0
_FORMAT = 4


@dataclass(frozen=True)
class Plan:
    """``max_depth``: edges of the longest path; ``lights``: samples of emitters at the first hit,
    for the residual and for the derivative; ``finish``: the last share of the budget with all
    effects; ``statements``: effect → what is done about it, and why; ``depths``, ``samples``: what
    the probe measured; ``seconds``: what it is billed."""

    max_depth: int
    lights: tuple[int, int]
    finish: float
    statements: dict[str, str]
    depths: tuple[Depth, ...] = ()
    samples: tuple[Lights, ...] = ()
    seconds: float = 0.0

    def on(self, problem: "Problem", finish: bool = False) -> "Problem":
        """``problem``, its paths as planned; with all effects where it is the ``finish``."""
        whole = problem.integrator
        depth = whole.max_depth if finish else self.max_depth
        if (depth, self.lights) == (whole.max_depth, whole.lights):
            return problem
        return dataclasses.replace(problem, integrator=whole.cut(depth, self.lights))

    def record(self) -> dict:
        """For the manifest."""
        return {
            "max_depth": None if self.max_depth == UNLIMITED else self.max_depth,
            "light_samples": list(self.lights),
            "finish": self.finish,
            "probe_seconds": self.seconds,
            "depths": [dataclasses.asdict(each) for each in self.depths],
            "lights": [dataclasses.asdict(each) for each in self.samples],
        }


def decide(
    problem: "Problem",
    settings: Effects,
    estimator: "Estimator",
    loss,
    seconds: float | None = None,
    earlier: dict | None = None,
    described: str = "",
) -> Plan:
    """The plan for a run. What is set is done; what is not, a probe measures where ``seconds``, the
    budget, is one of time and can pay for it: with other budgets a run is to be the same on every
    machine. ``earlier``: the record of the plan of a run that goes on. ``described``: the loss in
    words, for the cache.

    Raises InputError for a plan that the integrator or the estimator cannot follow, and for one
    that drops the only paths to an unknown.
    """
    whole = problem.integrator
    asked = settings.max_depth is not None or settings.light_samples is not None
    follows = whole.cuts and estimator.plannable
    if asked and not follows:
        who = (
            f"estimator={estimator.name} leaves the paths to Mitsuba"
            if whole.cuts
            else f"the scene's integrator {whole.name} is Mitsuba's and"
        )
        raise InputError(f"effects.…: {who} traces them as the scene says: take effects=full")
    depth, lights, why = whole.max_depth, (1, 1), {}
    depths, samples, spent = (), (), 0.0
    if earlier is not None:
        depth = earlier["max_depth"] or UNLIMITED
        lights = tuple(earlier["light_samples"])
        spent = earlier["probe_seconds"]
    elif follows:
        if settings.probe and estimator.replays and (seconds or 0) >= _WORTH:
            depths, samples, spent = _probed(problem, settings, loss, described)
            depth, why["paths"] = _depth(depths, settings.tolerance, depth)
            lights, why["light samples"] = _lights(samples)
        if settings.max_depth is not None:
            if settings.max_depth > whole.max_depth:
                raise InputError(
                    f"effects.max_depth={settings.max_depth}: the scene's own paths have "
                    f"{longest(whole.max_depth)}: at most that; scene.max_depth changes the scene"
                )
            depth, why["paths"] = settings.max_depth, "as set"
            if depth < whole.max_depth:
                _check_reach(problem, whole.cut(depth, lights))
        if settings.light_samples is not None:
            lights, why["light samples"] = tuple(settings.light_samples), "as set"
    plan = Plan(depth, lights, settings.finish, {}, depths, samples, spent)
    told = statements(plan.on(problem), estimator.derivatives(plan.on(problem)))
    if depth != whole.max_depth:
        told["paths"] += f"; {longest(whole.max_depth)} in the scene"
    told["light samples"] = f"{lights[0]} for a residual, {lights[1]} for a derivative"
    for effect, reason in why.items():
        told[effect] += f": {reason}"
    if plan.finish and depth != whole.max_depth:
        told["finish"] = f"the last {plan.finish:.0%} of the budget with all effects"
    return dataclasses.replace(plan, statements=told)


def _check_reach(problem: "Problem", integrator) -> None:
    """Raises InputError where paths of ``integrator`` no longer reach an unknown."""
    judged = {u.key: u.start for u in problem.unknowns if not u.kind.moves_geometry}
    cut = dataclasses.replace(problem, integrator=integrator)
    found = coverage.measure(cut, judged, 0)
    problem.unknowns.write(problem.unknowns.starts())
    for key, sensitivity in found.items():
        if not sensitivity.any():
            raise InputError(
                f"effects.max_depth={integrator.max_depth}: no path of so few edges meets "
                f"'{key}': give more, at most the scene's {problem.integrator.max_depth}"
            )


def _probed(problem: "Problem", settings: Effects, loss, described: str) -> tuple:
    """What the probe finds: depths, light samples, seconds; from the cache where possible."""
    starts = hashlib.blake2b(digest_size=16)
    for unknown in problem.unknowns:
        starts.update(f"{unknown.key} {unknown.start.shape}".encode() + unknown.start.tobytes())
    what = problem.content_hash, problem.target_hash, starts.hexdigest(), described
    asked = settings.max_depth, settings.light_samples, settings.tolerance
    key = "effects-" + digest("effects", _FORMAT, *what, *asked)

    def compute() -> dict[str, np.ndarray]:
        probe, whole = Probe(problem, loss, 0), problem.integrator.max_depth
        ladder = [depth for depth in _LADDER if depth < whole]
        depths, lights = [], []
        if ladder and settings.max_depth is None:
            depths = probe.depths([*ladder, whole])
        depth = settings.max_depth or _depth(depths, settings.tolerance, whole)[0]
        if settings.light_samples is None and depth > 1:
            lights = probe.lights(min(depth, whole), list(_LIGHTS))
        found = [dataclasses.asdict(each) for each in (*depths, *lights)]
        text = json.dumps({"found": found, "depths": len(depths), "seconds": probe.seconds})
        return {"json": np.array(text)}

    found = json.loads(str(cached(key, compute)["json"]))
    depths = tuple(
        Depth(
            row["depth"],
            Share(**row["image"]),
            {key: Share(**share) for key, share in row["gradient"].items()},
            row["time"],
        )
        for row in found["found"][: found["depths"]]
    )
    lights = tuple(
        Lights(**(row | {"samples": tuple(row["samples"])}))
        for row in found["found"][found["depths"] :]
    )
    return depths, lights, found["seconds"]


def _depth(depths, tolerance: float, whole: int) -> tuple[int, str]:
    """The shallowest of the ladder beyond which nothing counts."""
    chosen, why = whole, "all that the scene has"
    for each in reversed(depths[:-1]):
        bound = max(share.bound for share in each.gradient.values())
        told = f"longer ones are up to {bound:.2%} of a gradient (95 % bound)"
        if not bound < tolerance:
            return chosen, why if chosen != whole else told
        chosen, why = each.depth, told
    return chosen, why


def _lights(samples) -> tuple[tuple[int, int], str]:
    """The number with the least noise × time, if it is surely less than that of one each."""
    best = min(samples, key=lambda s: s.noise * s.time, default=None)
    if best is None or best.samples == (1, 1):
        return (1, 1), "more would not pay" if samples else "not measured"
    if (best.noise + 1.645 * best.error) * best.time >= 1:
        return (1, 1), "more would not surely pay"
    return best.samples, f"noise × time {best.noise * best.time:.2f} of that with one each"
