"""A disk that fills up, for the tests of whatever writes, and folders that cannot be read."""

import errno
import os
import resource
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def full_disk(after_bytes: int):
    """Files cannot grow beyond `after_bytes`; writing more fails as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (after_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def lock(monkeypatch, folder: Path) -> None:
    """Nobody may list the folder: its mode would not keep root out."""
    for name, usual in (("scandir", os.scandir), ("listdir", os.listdir)):

        def listed(place=".", usual=usual):
            if str(place) == str(folder):
                raise PermissionError(errno.EACCES, "Permission denied", str(place))
            return usual(place)

        monkeypatch.setattr(os, name, listed)
