"""What a scene takes by itself, where nothing else is said: ``method`` in its YAML.

Sampler, estimator (``name``) with settings, settings of the optimiser and of rendered targets, a
budget. They are composed like words that were typed before all others, so that what is typed counts
instead.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import yaml
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from ..runtime.errors import InputError
from . import paths, searchpath
from .grammar import override
from .presets import PRESETS

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable

# Taken out as a whole.
NONE = "scene.method=null"
# Chosen for the estimator that the scene names; another one's are its own.
_OF_ESTIMATOR = ("estimator", "optimizer")
_YES = "true", "yes", "on", "1"
# What photographs take whose object has an unknown pose, or begins as a hull.
_OF_MOVING = {"sampler": "ours", "estimator": "silhouettes"}
# Settings of which one is enough: what is typed of a line leaves out all that a scene has of it.
_INSTEAD = {
    key: line
    for line in (
        ("budget", "budget.seconds", "budget.iterations", "budget.paths"),
        ("target", "target.spp", "target.noise"),
    )
    for key in line
}


def completed(overrides: list[str]) -> list[str]:
    """``overrides``, as Hydra's grammar takes them, after what their scene takes by itself.

    A word that is typed leaves out its own setting; another estimator, also by a preset such as
    ``sampler=mitsuba``, what is set for the scene's; a budget, the scene's; ``NONE``, all.
    """
    typed = dict(o.lstrip("+").partition("=")[::2] for o in overrides)
    if NONE in overrides or "scene" not in typed:
        return overrides
    scene = whole(typed["scene"])
    own = flat(said(typed["scene"], "method"))
    if "photos" in scene and _moving(scene, typed, overrides):
        own = _OF_MOVING | own
    preset = typed.get("sampler") in PRESETS
    chosen = typed.get("estimator", typed["sampler"] if preset else own.get("estimator"))
    # The renderer's derivative is another estimator in all but its name.
    same = chosen == own.get("estimator") and typed.get("estimator.gradient", "kernel") == "kernel"

    def left(key: str) -> bool:
        group, dot, _ = key.partition(".")
        if group == "target" and "scene.targets" in typed:  # which are not rendered
            return False
        if key in _INSTEAD:
            return not any(each in _INSTEAD[key] for each in typed)
        if dot and group in _OF_ESTIMATOR and not same:
            return False
        return key not in typed and not (key == "estimator" and preset)

    return [f"{key}={override(value)}" for key, value in own.items() if left(key)] + overrides


def _moving(scene: dict[str, Any], typed: dict[str, str], overrides: list[str]) -> bool:
    """Whether a ``scene`` of photographs with ``overrides``, ``typed`` by key, makes the object's
    pose unknown, or leaves its shape to a hull, which is unknown. No files are read, but for the
    one that may name a plane."""
    own = {k: override(v) for k, v in (scene["photos"] or {}).items() if v is not None}
    own |= {key.removeprefix("scene.photos."): value for key, value in typed.items()}
    said = {key: value.strip("'\"") for key, value in own.items()}
    if any(said.get(name, "").lower() in _YES for name in ("pose", "edges")):
        return True
    if any(said.get(name, "null") != "null" for name in ("mesh", "plane", "sphere")):
        return False
    unknowns = (o for o in overrides if o.lstrip("+").startswith("scene.unknowns"))
    chosen = " ".join([*(scene.get("unknowns") or {}), *unknowns])
    if chosen and ".vertices" not in chosen:
        return False
    if said.get("start", "null") != "null":
        return True
    file = paths.of_set(said.get("path", "")) / said.get("cameras", "cameras.json")
    try:
        return "printed_board_rect_m" not in file.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return True


def taken(cfg: DictConfig) -> list[str]:
    """What ``cfg`` has from its scene, as it would be typed."""
    own = flat(cfg.scene.method or OmegaConf.create())
    if cfg.scene.photos.path is not None and cfg.estimator.name == _OF_MOVING["estimator"]:
        own = _OF_MOVING | own
    same = own.get("estimator") == cfg.estimator.name
    found = []
    for key, value in own.items():
        group, dot, _ = key.partition(".")
        held = OmegaConf.select(cfg, key if dot else f"{key}.name")
        if held == value and (same or not dot or group not in _OF_ESTIMATOR):
            found.append(f"{key}={override(value)}")
    return found


def options(group: str) -> list[str]:
    """Names that a configuration group offers, in alphabetical order."""
    return list(searchpath.files(group))


def said(scene: str, group: str) -> DictConfig:
    """What a scene says of ``group``; nothing of a scene that is none."""
    found = whole(scene).get(group)
    if found is not None and not isinstance(found, dict):
        file = searchpath.files("scene")[scene]
        raise InputError(f"{file}: {group}: holds no settings by name")
    return OmegaConf.create(found or {})


def whole(scene: str, *above: str) -> dict[str, Any]:
    """The YAML of a scene, over those of the scenes in its defaults (``above``: whose defaults name
    it), nothing resolved; nothing of a scene that is none."""
    file = searchpath.files("scene").get(scene)
    if file is None or scene in above:
        return {}
    own = OmegaConf.to_container(read(file))
    names = [str(each).partition("@")[0] for each in own.pop("defaults", None) or ()]
    names += ["_self_"] * ("_self_" not in names)  # as Hydra does
    bases = {name: whole(name.removeprefix("/scene/"), scene, *above) for name in names}
    try:
        return OmegaConf.to_container(OmegaConf.merge(*(bases | {"_self_": own}).values()))
    except OmegaConfBaseException as error:
        raise InputError(f"{file}: {str(error).splitlines()[0]}") from error


def read(file: "Traversable") -> DictConfig:
    """The YAML of a choice. Raises InputError, one line, where it is none."""
    try:
        found = OmegaConf.create(file.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise InputError(f"{file}: {' '.join(str(error).split())}") from error
    if not isinstance(found, DictConfig):
        raise InputError(f"{file}: holds no settings by name")
    return found


def flat(method: DictConfig) -> dict[str, Any]:
    """``{"estimator": {"name": "plateau", "spp": 4}}`` → ``{"estimator": "plateau",
    "estimator.spp": 4}``."""
    found = {}
    # What refers to other settings does so where it is put.
    for group, value in OmegaConf.to_container(method).items():
        several = value.items() if isinstance(value, dict) else (("name", value),)
        for name, each in several:
            found[group if name == "name" else f"{group}.{name}"] = each
    return found
