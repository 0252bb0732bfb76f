"""Composing the configuration with Hydra, and saying in one line what is wrong with it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable

from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from . import config
from .errors import InputError, nearest

# scene.unknowns takes keys that no schema can list; '++' lets Hydra add them.
_UNKNOWNS = "scene.unknowns="


def translate(overrides: Iterable[str]) -> list[str]:
    """Overrides as typed → overrides as Hydra's grammar takes them.

    ``scene.unknowns={"a.b": {"start": 0.5}}`` is JSON, whose quoted keys Hydra's grammar does not
    know: it is rewritten with bare keys.
    """
    return [_translate_unknowns(o) if o.startswith(_UNKNOWNS) else o for o in overrides]


def _translate_unknowns(override: str) -> str:
    text = override[len(_UNKNOWNS) :]
    try:
        parsed = json.loads(text)
    except json.JSONDecodeError:
        return "++" + override  # perhaps it is in Hydra's own notation
    if not isinstance(parsed, dict) or not all(isinstance(v, dict) for v in parsed.values()):
        raise InputError(
            f'{override}: give {{"key": {{"start": 0.5}}}}: keys of the scene, each with a start '
            "and, if wanted, a range and an lr"
        )
    return f"++{_UNKNOWNS}{_hydra(parsed)}"


def _hydra(value) -> str:
    """A JSON value in Hydra's override grammar."""
    if isinstance(value, dict):
        return "{" + ",".join(f"{_key(k)}:{_hydra(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ",".join(_hydra(v) for v in value) + "]"
    if isinstance(value, str):
        return "'" + value.replace("\\", "\\\\").replace("'", "\\'") + "'"
    return json.dumps(value)


def _key(key: str) -> str:
    return re.sub(r"([\\()\[\]{}:=, \t])", r"\\\1", key)


def compose(overrides: list[str], hydra: bool = False) -> DictConfig:
    """The composed configuration. Raises InputError, one line, when it cannot be."""
    config.register()
    try:
        with initialize_config_dir(config.folder(), version_base="1.3", job_name="isas"):
            cfg = hydra_compose("config", overrides, return_hydra_config=hydra)
            OmegaConf.resolve(cfg.scene)
            return cfg
    except (HydraException, OmegaConfBaseException) as error:
        raise InputError(_explain(error, overrides)) from error


def options(group: str) -> list[str]:
    """Names that a configuration group offers, in alphabetical order."""
    from pathlib import Path

    return sorted(p.stem for p in (Path(config.folder()) / group).glob("*.yaml"))


def _explain(error: Exception, overrides: list[str]) -> str:
    text = str(error)
    missing = re.search(r"Could not find '([^'/]+)/([^']+)'", text)
    if missing:
        group, name = missing.groups()
        return f"{group}={name}: no such {group}; {nearest(name, options(group))}"
    unspecified = re.search(r"You must specify '(\w+)'", text)
    if unspecified:
        group = unspecified.group(1)
        return f"{group} is not given: say {group}=NAME; valid: {', '.join(options(group))}"
    unknown = re.search(r"Could not override '([^']+)'", text)
    if unknown:
        return _explain_key(unknown.group(1), overrides)
    size = re.search(r"Interpolation key 'scene\.sizes\.([^.]+)\.", text)
    if size:
        return f"size={size.group(1)}: {nearest(size.group(1), _sizes(overrides))}"
    absent = re.search(r"Missing mandatory value: (\S+)", text)
    if absent:
        return f"{absent.group(1)} is missing: give {absent.group(1)}=…"
    merging = re.search(r"Error merging override (\S.*)", text)
    if merging:
        cause = " ".join(str(error.__cause__ or "").split("\n")[0].split())
        return f"{merging.group(1).lstrip('+')}: {cause or 'does not fit'}"
    return " ".join(text.split("\nSee ")[0].split())


def _sizes(overrides: list[str]) -> list[str]:
    cfg = _raw([o for o in overrides if not o.startswith("size=")])
    return list(cfg.scene.sizes) if cfg is not None else []


def _explain_key(key: str, overrides: list[str]) -> str:
    cfg = _raw([o for o in overrides if o.split("=")[0].lstrip("+~").split("@")[0] != key])
    *parents, last = key.split(".")
    node, found = cfg, []
    for parent in parents:
        if not isinstance(node, DictConfig) or parent not in node:
            last = parent
            break
        node = node._get_node(parent)
        found.append(parent)
    valid = [".".join([*found, str(k)]) for k in node] if isinstance(node, DictConfig) else []
    return f"{key}: no such setting; {nearest('.'.join([*found, last]), valid)}"


def _raw(overrides: list[str]) -> DictConfig | None:
    """Composed without resolving anything, or None where that fails too."""
    try:
        with initialize_config_dir(config.folder(), version_base="1.3", job_name="isas"):
            return hydra_compose("config", overrides)
    except (HydraException, OmegaConfBaseException):
        return None


def instantiate(node: DictConfig, where: str):
    """The object that a node's ``_target_`` names: a dataclass, its fields type-checked.

    ``name`` is the group option's own label and is not passed on. Raises InputError naming the
    field for a value of the wrong type; the dataclass itself checks ranges.
    """
    import importlib

    plain = OmegaConf.to_container(node, resolve=True)
    module, _, name = plain.pop("_target_").rpartition(".")
    plain.pop("name", None)
    target = getattr(importlib.import_module(module), name)
    try:
        return OmegaConf.to_object(OmegaConf.merge(OmegaConf.structured(target), plain))
    except OmegaConfBaseException as error:
        message = str(error).split("\n")[0]
        field = f"{where}.{error.full_key}" if error.full_key else where
        raise InputError(f"{field}: {message}") from error
