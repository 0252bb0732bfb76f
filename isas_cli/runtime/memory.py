"""How much memory there is."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

import psutil

from .errors import InputError

# Control groups of both kinds: what the list of this process's own calls them, their folder,
# limit, what is used, what of that only caches files.
_GROUPS = (
    ("", Path("/sys/fs/cgroup"), "memory.max", "memory.current", "inactive_file"),
    (
        *("memory", Path("/sys/fs/cgroup/memory")),
        *("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
    ),
)
_OWN = Path("/proc/self/cgroup")

_PART = 1 << 20


def parts(count: int) -> Iterator[slice]:
    """Of ``count`` entries, a million at a time: what is computed of them in double precision takes
    several times their memory, which counts beside films and textures of many millions."""
    return (slice(first, first + _PART) for first in range(0, count, _PART))


def gib(size: float) -> str:
    """Bytes in words."""
    return f"{size / 2**30:.3g} GiB"


def available() -> float:
    """Bytes that this process may still take: of the machine, or of its control groups."""
    free = [float(psutil.virtual_memory().available)]
    for folder, limit, used, cached in _groups():
        try:
            most, taken = (int((folder / name).read_text()) for name in (limit, used))
            stat = dict(line.split() for line in (folder / "memory.stat").read_text().splitlines())
            # What only caches files goes when memory is asked for.
            free.append(most - taken + int(stat[cached]))
        except (OSError, ValueError, KeyError):
            pass  # not of this kind, or without a limit
    return min(free)


def _groups() -> Iterator[tuple[Path, str, str, str]]:
    """As ``_GROUPS``: those of this process and all around them, each of which may have a limit."""
    try:
        lines = [line.split(":", 2) for line in _OWN.read_text().splitlines()]
    except OSError:
        lines = []
    for kind, root, *names in _GROUPS:
        own = [PurePosixPath(path) for _, kinds, path in lines if kind in kinds.split(",")]
        # A container may see its own group as the root, and be told another path.
        around = {PurePosixPath("/"), *own, *(above for each in own for above in each.parents)}
        for each in around:
            yield root / each.relative_to("/"), *names


EXHAUSTED = (
    "memory is full: lower estimator.batch, the resolution of the views or evaluation.pixels, or "
    "take fewer views"
)


def exhausted(error: BaseException | None) -> bool:
    """Whether it, or what it came of, says that memory is full: Python's, or of Dr.Jit, which has
    one kind for all."""
    if error is None:
        return False
    said = str(error).lower().replace("_", " ")  # CUDA's and OptiX's names have these
    full = isinstance(error, MemoryError) or "out of memory" in said
    return full or exhausted(error.__cause__)


@contextmanager
def kept(command: str, folder: Path) -> Iterator[None]:
    """Within the context ``folder`` has a record, with which ``command`` goes on. Raises InputError
    where memory is full: what a new run may lower stays as it is then."""
    try:
        yield
    except Exception as error:
        if isinstance(error, InputError) or not exhausted(error):
            raise
        again = shlex.quote(f"resume={folder}")
        raise InputError(
            f"memory is full: {command} {again} goes on from the last checkpoint when there is room"
        ) from error
