"""Names of a sweep's folders: the same settings always get the same one."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection
from pathlib import Path

import yaml
from omegaconf import DictConfig, OmegaConf

from ...config.roles import Role, meaning


def register() -> None:
    """Make ``${job_name:}`` and ``${fingerprint:}`` known to OmegaConf, in every process that
    resolves a sweep's configuration."""
    for name, resolve in (("job_name", _job_name), ("fingerprint", _fingerprint)):
        OmegaConf.register_new_resolver(name, resolve, replace=True)


def same(cfg: DictConfig, folder: Path) -> bool:
    """Whether the run in ``folder`` was made with these settings."""
    try:
        text = (folder / "config.yaml").read_text(encoding="utf-8")
        recorded = OmegaConf.create(text)
        return isinstance(recorded, DictConfig) and _text(recorded) == _text(cfg)
    except (OSError, ValueError, yaml.YAMLError):
        return False


def _fingerprint(*, _root_: DictConfig) -> str:
    """Eight hexadecimal digits of all settings but the seed."""
    text = _text(_root_, (Role.PLACE, Role.SEED))
    return hashlib.sha256(text.encode()).hexdigest()[:8]


def _job_name(*, _root_: DictConfig) -> str:
    """``seed3-1f0c9a7e``, behind the run's own name where one was given."""
    name = f"seed{_root_.seed}-{_fingerprint(_root_=_root_)}"
    typed = [override.partition("=")[0].lstrip("+") for override in _root_.hydra.overrides.task]
    return f"{_root_.name}-{name}" if "name" in typed else name


def _text(cfg: DictConfig, besides: Collection[Role] = (Role.PLACE,)) -> str:
    """The settings as text, whatever their order, but for those of some roles. Each is resolved in
    its place: it may refer to one that is left out."""
    plain = {}
    for key in cfg:
        if meaning(key).role not in besides:
            value = cfg[key]
            is_node = OmegaConf.is_config(value)
            plain[key] = OmegaConf.to_container(value, resolve=True) if is_node else value
    return json.dumps(plain, sort_keys=True, default=str)
