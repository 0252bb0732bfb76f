"""What a run was made with, so that its figures can be trusted later."""

from __future__ import annotations

import datetime
import os
import platform
import sys
from importlib.metadata import PackageNotFoundError, version

import psutil

from . import __version__
from .backend import Backend
from .problem import Problem

_PACKAGES = ("mitsuba", "drjit", "mitsuba-oidn", "hydra-core", "OpenImageIO", "numpy", "pandas")


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def describe(backend: Backend, problem: Problem, seed: int, target_seed: int) -> dict:
    """Versions, machine, seeds, content hashes and command line of the present process."""
    return {
        "isas": __version__,
        "command": sys.argv,
        "folder": os.getcwd(),
        "started": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"),
        "python": platform.python_version(),
        "packages": {p: _version(p) for p in _PACKAGES},
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
        "views": [list(size) for size in problem.film_sizes],
        "unknowns": {
            u.key: {
                "shape": list(u.start.shape),
                "range": [u.low, u.high],
                "lr": u.lr,
                "entries": int(u.start.size),
                "entries_seen": int(u.seen.sum()),
            }
            for u in problem.unknowns
        },
    }
