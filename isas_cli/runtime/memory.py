"""How much memory there is."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import psutil

# Control groups of both kinds: folder, limit, what is used, what of that only caches files.
_GROUPS = (
    (Path("/sys/fs/cgroup"), "memory.max", "memory.current", "inactive_file"),
    (
        Path("/sys/fs/cgroup/memory"),
        *("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
    ),
)

_PART = 1 << 20


def parts(count: int) -> Iterator[slice]:
    """Of ``count`` entries, a million at a time: what is computed of them in double precision takes
    several times their memory, which counts beside films and textures of many millions."""
    return (slice(first, first + _PART) for first in range(0, count, _PART))


def gib(size: float) -> str:
    """Bytes in words."""
    return f"{size / 2**30:.3g} GiB"


def available() -> float:
    """Bytes that this process may still take: of the machine, or of its control group."""
    free = [float(psutil.virtual_memory().available)]
    for folder, limit, used, cached in _GROUPS:
        try:
            most, taken = (int((folder / name).read_text()) for name in (limit, used))
            stat = dict(line.split() for line in (folder / "memory.stat").read_text().splitlines())
            # What only caches files goes when memory is asked for.
            free.append(most - taken + int(stat[cached]))
        except (OSError, ValueError, KeyError):
            pass  # not of this kind, or without a limit
    return min(free)


EXHAUSTED = (
    "memory is full: lower estimator.batch, the resolution of the views or evaluation.pixels, or "
    "take fewer views"
)


def exhausted(error: BaseException) -> bool:
    """Whether it says that memory is full: Python's, or of Dr.Jit, which has one kind for all."""
    return isinstance(error, MemoryError) or "out of memory" in str(error).lower()
