"""What a run was made with, so that its figures can be trusted later."""

from __future__ import annotations

import datetime
import os
import platform
import sys
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING

import psutil

from .. import __version__
from ..runtime import guests
from ..runtime.backend import Backend
from ..runtime.budget import Budget
from . import follow
from .files import OWN_UNIT, RELATIVE

if TYPE_CHECKING:
    from ..scene.problem import Problem

_PACKAGES = ("mitsuba", "drjit", "mitsuba-oidn", "hydra-core", "OpenImageIO", "numpy", "pandas")


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def process() -> dict:
    """Which process writes, where and since when: whether it still lives can be asked."""
    return {
        "started": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"),
        "host": platform.node(),
        "pid": os.getpid(),
        "pid_namespace": follow.pid_namespace(),
        "ticks": follow.ticks_of(os.getpid()),
    }


def alive(manifest: dict) -> bool:
    """Whether another process of this machine still writes the run of ``manifest``."""
    latest = [manifest, *manifest.get("resumed", [])][-1]
    return latest.get("pid") != os.getpid() and follow.alive(manifest) is True


def _made() -> dict:
    """By what, as which command, and by which process."""
    return {
        "isas": __version__,
        "command": sys.argv,
        "folder": os.getcwd(),
        **process(),
        "packages": {p: _version(p) for p in _PACKAGES},
        **({"guests": found} if (found := guests.installed()) else {}),
    }


def versions(entry: dict) -> dict[str, str]:
    """Of what figures depend on, by name, as a manifest or its ``entry`` of a continuation says."""
    known = entry.get("packages") or {}
    told = {name: known.get(name.lower().replace(".", "")) or "?" for name in ("Mitsuba", "Dr.Jit")}
    return {"isas": entry.get("isas") or "?"} | told | (entry.get("guests") or {})


def continuation(
    backend: Backend, iteration: int, seconds: float, earlier_budget: Budget | None, failed: bool
) -> dict:
    """The manifest's entry for a continuation that starts at ``iteration``, ``seconds`` billed.

    ``earlier_budget``: the budget before, None where it is the same; ``failed``: whether it had
    ended in a numerical failure."""
    return {
        **({"failed": True} if failed else {}),
        **({"earlier_budget": str(earlier_budget)} if earlier_budget else {}),
        **_made(),
        "threads": backend.threads,
        "device": backend.device,
        "iteration": iteration,
        "seconds": seconds,
    }


def headline(unit: str | None) -> str:
    """What ``parameter_rmse`` is, in words that a label can take; ``unit``: of all unknowns, None
    where they differ."""
    return RELATIVE if unit is None else unit or OWN_UNIT


def describe(
    backend: Backend,
    problem: "Problem",
    seed: int,
    target_seed: int,
    effects: dict[str, str],
    plan: dict | None = None,
    floor: dict | None = None,
) -> dict:
    """Versions, machine, seeds, content hashes, what is simulated, and the command line.

    ``effects``: effect → what is done about it; ``plan``: the same in numbers, with what was
    measured for it (``effects.Plan``); ``floor``: the targets' noise and what fitting it leaves
    (``engine.floor.Floor``), or what is known of photographs'; None of what has none."""
    integrator = problem.integrator
    return {
        **_made(),
        "python": platform.python_version(),
        "variant": backend.variant,
        "llvm": {"path": str(backend.llvm_path or ""), "version": backend.llvm_version},
        "threads": backend.threads,
        "machine": {
            "device": backend.device,
            "system": platform.platform(),
            "cores": os.cpu_count(),
            "memory_bytes": psutil.virtual_memory().total,
        },
        "seeds": {"run": seed, "target": target_seed},
        "scene_hash": problem.content_hash,
        "target_hash": problem.target_hash,
        "start_hash": problem.unknowns.start_hash,
        "integrator": {"class": integrator.name, "max_depth": integrator.max_depth},
        "effects": effects,
        **({} if plan is None else {"plan": plan}),
        **({} if floor is None else {"targets": floor}),
        "views": [list(size) for size in problem.film_sizes],
        "parameter_rmse_is": headline(problem.unknowns.unit),
        "unknowns": {
            u.key: {
                "kind": u.kind.name,
                "unit": u.kind.unit,
                "shape": list(u.start.shape),
                "range": [u.low, u.high],
                "lr": u.lr,
                "during": list(u.during),
                "schedule": u.schedule,
                "final": u.final,
                "prior": u.prior,
                "entries": int(u.start.size),
                "entries_seen": int(u.seen.sum()),
            }
            for u in problem.unknowns
        },
    }
