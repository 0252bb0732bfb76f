"""Arrays kept between runs: rendered targets and what views see. Of bounded size, oldest first."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import sys
import time
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from .errors import InputError, IsasError
from .files import write_atomically

if TYPE_CHECKING:
    import numpy as np

_DEFAULT_GIB = 4.0
# Seconds between writes of what is not whole yet: at least, and times as many as one took.
_KEPT_EVERY, _TIMES = 20.0, 50.0
_OLD = 3600.0  # seconds after which nobody writes a file any more
# What isas itself puts there: a word, a digest, and whatever else; and what is not whole yet.
_ENTRY = re.compile(r"[a-z]+-[0-9a-f]{32}[\w-]*\.npz")
_LEFT_OVER = re.compile(rf"\.{_ENTRY.pattern}\.\d+\.tmp")
_too_large: set[str] = set()  # what was said to be


def folder() -> Path:
    """$ISAS_CACHE_DIR, else the user's cache folder."""
    if os.environ.get("ISAS_CACHE_DIR"):
        return Path(os.path.expanduser(os.environ["ISAS_CACHE_DIR"]))
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "isas"


def limit() -> int:
    """Bytes that the cache may hold: $ISAS_CACHE_GIB, else 4 GiB; 0: nothing is kept. Raises
    InputError for what is no number."""
    text = os.environ.get("ISAS_CACHE_GIB") or str(_DEFAULT_GIB)
    try:
        gib = float(text)
        if not 0 <= gib < 2**20:
            raise ValueError
    except ValueError:
        raise InputError(f"ISAS_CACHE_GIB={text}: a number of GiB, at least 0") from None
    return int(gib * 2**30)


def size() -> int:
    """Bytes that it holds."""
    return sum(stat.st_size for _, stat in _entries())


def cached(key: str, compute: Callable[[], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Arrays stored under ``key``, computed and stored when absent or unreadable.

    What has not been used for longest goes first where the cache outgrows its ``limit``; what is
    larger than that by itself is not stored, which is said. A cache that cannot be written costs
    the next run its time, never this run its result.
    """
    import numpy as np  # which `isas doctor` need not wait for

    path, most = folder() / f"{key}.npz", limit()
    if not most:
        return compute()
    try:
        with np.load(path) as stored:
            found = {name: stored[name] for name in stored.files}
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
        pass
    else:
        with contextlib.suppress(OSError):
            os.utime(path)  # used just now
        return found
    arrays = compute()
    _store(path, arrays, most)
    return arrays


@contextlib.contextmanager
def unfinished(key: str) -> Iterator[tuple[dict[str, np.ndarray], Callable]]:
    """For a long computation that can go on: what an earlier one that stopped has left under
    ``key`` (nothing: empty), and ``keep(arrays)``, to be called after each part with a function
    that gives all there is. It is written now and then, and where the computation is stopped; where
    it ends nothing stays.
    """
    import numpy as np

    if not limit():
        yield {}, lambda arrays: None
        return
    path, latest = folder() / f"{key}.npz", []
    due = [time.monotonic() + _KEPT_EVERY]

    def write() -> None:
        begun = time.monotonic()
        with contextlib.suppress(OSError, IsasError):
            _store(path, latest[0](), limit())
        now = time.monotonic()
        due[0] = now + max(_KEPT_EVERY, _TIMES * (now - begun))

    def keep(arrays: Callable[[], dict]) -> None:
        latest[:] = [arrays]
        if time.monotonic() > due[0]:
            write()

    found = {}
    with contextlib.suppress(OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
        with np.load(path) as stored:
            found = {name: stored[name] for name in stored.files}
    try:
        yield found, keep
    except BaseException:
        if latest:
            write()
        raise
    with contextlib.suppress(OSError):
        path.unlink()


def digest(*parts) -> str:
    """A short hash of JSON-able parts."""
    return hashlib.blake2b(json.dumps(parts, sort_keys=True).encode(), digest_size=16).hexdigest()


def _store(path: Path, arrays: dict[str, np.ndarray], most: int) -> None:
    """Where it can be, and is not larger than ``most`` bytes: all else would go, and it next."""
    size = sum(array.nbytes for array in arrays.values())
    if size > most:
        kind = path.name.partition("-")[0]
        if kind not in _too_large:
            _too_large.add(kind)
            with contextlib.suppress(OSError):
                print(
                    f"{path.stem} takes {size / 2**30:.3g} GiB, more than the cache may hold, "
                    f"{most / 2**30:.3g} GiB: it is not kept; ISAS_CACHE_GIB=N lets it hold more",
                    file=sys.stderr,
                    flush=True,
                )
        return
    with contextlib.suppress(OSError, IsasError):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, lambda temporary: _save(temporary, arrays))
        _shrink(most, keep=path)


def _save(path: Path, arrays: dict[str, np.ndarray]) -> None:
    import numpy as np

    with open(path, "wb") as file:
        np.savez(file, **arrays)


def _entries() -> list[tuple[Path, os.stat_result]]:
    """Stored files, the one that was not used for longest first. Another process may take some."""
    found = []
    for path in _named(_ENTRY):
        with contextlib.suppress(OSError):
            found.append((path, path.stat()))
    return sorted(found, key=lambda each: each[1].st_mtime)


def _named(pattern: re.Pattern) -> list[Path]:
    """Files of such names: the folder may hold others, which are somebody's own."""
    return [path for path in folder().glob("*") if pattern.fullmatch(path.name)]


def _shrink(most: int, keep: Path) -> None:
    for left_over in _named(_LEFT_OVER):  # of a process that was killed while it wrote
        with contextlib.suppress(OSError):
            if time.time() - left_over.stat().st_mtime > _OLD:
                left_over.unlink()
    entries = _entries()
    held = sum(stat.st_size for _, stat in entries)
    for path, stat in entries:
        if held <= most:
            return
        if path != keep:
            with contextlib.suppress(OSError):  # where users share it, another's may have to stay
                path.unlink(missing_ok=True)
                held -= stat.st_size
