"""Files that a configuration names, found from anywhere."""

from __future__ import annotations

import contextlib
import datetime
import importlib.resources
import os
import re
import shlex
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

# Where a configuration names files, singly or in lists.
_FILES = (
    *("scene.path", "scene.targets", "scene.masks"),
    *(f"scene.photos.{name}" for name in ("path", "mesh", "environment", "images", "masks")),
    "scene.photos.texture",  # or a number
)
# Of these, what is looked for in the set first.
_IN_SET = ("scene.photos.images", "scene.photos.masks")
# Whose words may be files.
_COMMAND = "scene.external.command"
_SCENES = "isas_cli.scenes"
# What folders of runs, failed ones too, of races and of comparisons hold.
_MADE = {"config.yaml", "manifest.json"}, {"config.yaml", "log.txt"}, {"race.yaml"}, {"races.yaml"}
_MADE += ({"methods.csv", "report.html"},)


def exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # a name that no file can have
        return False


def of_set(path: str) -> Path:
    """The folder of photographs that ``photos.path`` names: one's own, or one that comes along."""
    folder = Path(path)
    if folder.is_dir():
        return folder
    return Path(str(importlib.resources.files(_SCENES))) / "assets" / folder


def locate(cfg: DictConfig, started_in: str | None) -> None:
    """Makes relative paths in ``cfg`` absolute where they name something in the folder
    ``started_in``. Others stay as they are, and are looked for in the working directory: a record
    may have been moved with all that it names."""
    home = Path(started_in) if started_in else None
    if home is None or not home.is_dir():
        return

    def found(name: str) -> str:
        return str(home / name) if name and exists(home / name) else name

    for key, named in _said(cfg):
        OmegaConf.update(cfg, key, _each(named, found))
    words, there = _words(cfg), _in_command(cfg, home)
    if there and not home.samefile("."):  # its program is called as ISAS_ALLOW names it
        whole = [found(word) if word in there else word for word in words]
        OmegaConf.update(cfg, _COMMAND, shlex.join(whole))
    for unknown in cfg.scene.unknowns.values():
        # Without an ending it is a word, such as 'sphere'.
        if isinstance(unknown.start, str) and Path(unknown.start).suffix:
            unknown.start = found(unknown.start)


def named(cfg: DictConfig) -> list[tuple[str, str]]:
    """The files and folders that ``cfg`` names: (setting, name)."""
    listed = []
    for key, value in _said(cfg):
        listed += [(key, each) for each in ([value] if isinstance(value, str) else value)]
    for key, unknown in cfg.scene.unknowns.items():
        if unknown is not None and isinstance(start := unknown.get("start"), str):
            if Path(start).suffix:
                listed.append((f"scene.unknowns.{key}.start", start))
    listed += [(_COMMAND, word) for word in _in_command(cfg, Path())]
    if function := OmegaConf.select(cfg, "scene.external.function"):
        module = function.rpartition(".")[0].replace(".", "/")
        files = (f"{module}.py", f"{module}/__init__.py")  # where they are not installed
        listed += [("scene.external.function", name) for name in files if _is_file(Path(name))]
    return listed


def _said(cfg: DictConfig) -> Iterator[tuple[str, Any]]:
    """Settings that name files or folders, and what they name: the set of photographs before what
    may lie in it, which is not named here."""
    for key in _FILES:
        value = OmegaConf.select(cfg, key)
        if value is None or isinstance(value, (int, float)):
            continue
        if key in _IN_SET:
            path = OmegaConf.select(cfg, "scene.photos.path")
            if value == "none" or path is not None and (of_set(path) / value).is_dir():
                continue
        yield key, value


def _words(cfg: DictConfig) -> list[str]:
    try:
        return shlex.split(OmegaConf.select(cfg, _COMMAND) or "")
    except ValueError:
        return []


def _in_command(cfg: DictConfig, folder: Path) -> list[str]:
    """The words of a renderer's command that are files, seen from ``folder``: its program only
    where it is not looked for among the installed ones."""
    words = _words(cfg)
    own = words if words and "/" in words[0] else words[1:]
    return [word for word in own if _is_file(folder / word)]


def elsewhere(cfg: DictConfig, started_in: str | None) -> str | None:
    """Of files that ``cfg`` names relative to the working directory, one that is another file than
    what the same name means in ``started_in``, where both are there."""
    if started_in is None:
        return None
    for key, name in named(cfg):
        here, there = Path(name), Path(started_in) / name
        if exists(here) and exists(there) and here.resolve() != there.resolve():
            return f"{key}={name}"
    return None


def newer(cfg: DictConfig, than: str) -> str | None:
    """A file that ``cfg`` names, that a scene's XML does or that lies in a folder of photographs,
    changed after the time ``than`` (ISO 8601); None where none was. Sets that come along change
    with isas alone, and are not asked."""
    try:
        since = datetime.datetime.fromisoformat(than).timestamp()
    except ValueError:
        return None
    for key, name in [*named(cfg), *_of_set(cfg)]:
        path = Path(name)
        files = [path]
        with contextlib.suppress(OSError, UnicodeDecodeError):
            if path.suffix.lower() == ".xml":
                files += _within(path, {path})
            elif path.is_dir():
                files += _below(path)
        for file in files:
            with contextlib.suppress(OSError):
                if file.is_file() and file.stat().st_mtime > since:
                    return str(file) if file != path else f"{key}={name}"
    return None


def _of_set(cfg: DictConfig) -> Iterator[tuple[str, str]]:
    """What settings name from a set of photographs on, which may lie beside it."""
    path = OmegaConf.select(cfg, "scene.photos.path")
    for key in (*_IN_SET, "scene.photos.cameras"):
        if path is not None and (value := OmegaConf.select(cfg, key)) is not None:
            yield key, str(of_set(path) / value)


def _below(folder: Path) -> Iterator[Path]:
    """The files in a folder and the folders in it, but for hidden ones and what isas makes."""
    seen: set[str] = set()  # links may lead round
    for place, folders, files in os.walk(folder, followlinks=True):
        real = os.path.realpath(place)
        if real in seen or any(made <= {*files} for made in _MADE):
            folders.clear()
            continue
        seen.add(real)
        folders[:] = [name for name in folders if not name.startswith(".")]
        yield from (Path(place, name) for name in files if not name.startswith("."))


def _within(
    path: Path, seen: set[Path], around: tuple[Path, ...] = (), outer: dict[str, str] | None = None
) -> list[Path]:
    """What a scene's XML names beside itself or in the folders ``around``, those of the scenes that
    it is part of and of its ``<path>``, and files of scenes that are part of it do. ``outer``: the
    defaults of the scenes that it is part of, which go before its own."""
    found, text, defaults = [], path.read_text("utf-8"), {}
    for tag in re.findall(r"<default\s[^>]*>", text):
        given = dict(re.findall(r"""(name|value)\s*=\s*["']([^"']*)["']""", tag))
        defaults[given.get("name")] = given.get("value", "")
    defaults |= outer or {}
    for name in sorted(filter(None, defaults), key=len, reverse=True):  # $texture before $tex
        text = text.replace(f"${name}", defaults[name])
    named = r"""(?:value|filename)\s*=\s*["']([^"']+)["']"""
    folders = [path.parent, *around]
    for tag in re.findall(r"<path\s[^>]*>", text):
        folders += [path.parent / each for each in re.findall(named, tag)]
    for name in re.findall(named, text):
        each = next((f / name for f in folders if _is_file(f / name)), path.parent / name)
        found.append(each)
        if each.suffix.lower() == ".xml" and each not in seen and _is_file(each):
            found += _within(each, seen | {each}, tuple(folders), defaults)
    return found


def _is_file(path: Path) -> bool:
    """Numbers are values, too, and may be longer than any name."""
    try:
        return path.is_file()
    except OSError:
        return False


def _each(named, found: Callable[[str], str]):
    return found(named) if isinstance(named, str) else [found(name) for name in named]
