"""Files that a configuration names, found from anywhere."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from omegaconf import DictConfig, OmegaConf

# Where a configuration names files, singly or in lists.
_FILES = (
    *("scene.path", "scene.targets", "scene.masks"),
    *(f"scene.photos.{name}" for name in ("path", "mesh", "environment", "images", "masks")),
    "scene.photos.texture",  # or a number
)


def exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # a name that no file can have
        return False


def locate(cfg: DictConfig, started_in: str | None) -> None:
    """Makes relative paths in ``cfg`` absolute where they name something in the folder
    ``started_in``. Others stay as they are, and are looked for in the working directory: a record
    may have been moved with all that it names."""
    home = Path(started_in) if started_in else None
    if home is None or not home.is_dir():
        return

    def found(name: str) -> str:
        return str(home / name) if name and exists(home / name) else name

    for key in _FILES:
        named = OmegaConf.select(cfg, key)
        if named is not None and not isinstance(named, (int, float)):
            OmegaConf.update(cfg, key, _each(named, found))
    for unknown in cfg.scene.unknowns.values():
        # Without an ending it is a word, such as 'sphere'.
        if isinstance(unknown.start, str) and Path(unknown.start).suffix:
            unknown.start = found(unknown.start)


def _each(named, found: Callable[[str], str]):
    return found(named) if isinstance(named, str) else [found(name) for name in named]
