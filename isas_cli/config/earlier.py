"""Configurations of earlier records as they would be written today."""

from __future__ import annotations

from typing import Any

from .schema import PRESETS

_OF_ESTIMATORS = ("batch", "freeze", "derivative_sampling")


def modern(config: dict[str, Any]) -> dict[str, Any]:
    """``config`` of a run, whichever version wrote it, with an estimator of its own.

    Until 0.1 samplers of the names of PRESETS held the settings of what is an estimator now, and
    the sampler that drew their pixels as ``base``. Modules have moved since as well.
    """
    config = _with_unknowns(config)
    if isinstance(optimizer := config.get("optimizer"), dict) and "filter" not in optimizer:
        config = {**config, "optimizer": _with_filter({**_OF_OPTIMIZER, **optimizer})}
    sampler, estimator = config.get("sampler"), config.get("estimator")
    if not isinstance(sampler, dict) or not isinstance(estimator or {}, dict):
        return config
    # Before there were plans of effects, everything was simulated.
    effects = config.get("effects", _ALL_EFFECTS)
    if isinstance(effects, dict) and "directions" not in effects:
        whole = effects.get("name") == _ALL_EFFECTS["name"]
        effects = {**effects, "directions": _ALL_EFFECTS["directions"] if whole else None}
    if effects is not config.get("effects"):
        config = {**config, "effects": effects}
    if "name" in (estimator or {}):
        missing = _ONE_WAY.get(estimator["name"], {}).keys() - estimator.keys()
        return {**config, "estimator": {**_ONE_WAY["two_path"], **estimator}} if missing else config
    common = {key: value for key, value in (estimator or {}).items() if key in _OF_ESTIMATORS}
    chosen = sampler.get("name")
    if chosen in PRESETS:
        common.pop("derivative_sampling", None)
        own = {k: v for k, v in sampler.items() if k not in ("name", "_target_", "base")}
        base = dict(sampler.get("base") or {"name": "uniform"})
        if base["name"] == "uniform":
            base["name"] = chosen
        config = {**config, "sampler": base}
        name = chosen
    else:
        own, name = {}, "two_path"
    target = f"isas_cli.estimators.{name}.Settings"
    found = {"name": name, "_target_": target, **_ONE_WAY.get(name, {}), **common, **_known(own)}
    return {**config, "estimator": found, "prior": config.get("prior") or _NO_PRIOR}


def _with_filter(optimizer: dict[str, Any]) -> dict[str, Any]:
    """What was ``smoothing`` is the width of a filter."""
    found = dict(optimizer)
    if width := found.pop("smoothing", 0.0):
        return {**found, "filter": {**_GAUSSIAN, "width": width}}
    return {**found, "filter": _NO_FILTER}


def _with_unknowns(config: dict[str, Any]) -> dict[str, Any]:
    """Unknowns with the settings that they got since."""
    scene = config.get("scene")
    unknowns = scene.get("unknowns") if isinstance(scene, dict) else None
    if not isinstance(unknowns, dict) or not all(isinstance(u, dict) for u in unknowns.values()):
        return config
    found = {key: {**_OF_UNKNOWNS, **each} for key, each in unknowns.items()}
    return {**config, "scene": {**scene, "unknowns": found}}


_OF_OPTIMIZER = {"half": 40.0}
_OF_UNKNOWNS = {"during": None, "schedule": None, "final": None, "prior": 1.0}
# Before both paths of a pixel were differentiated.
_ONE_WAY = {"two_path": {"crossed": False}}
_ALL_EFFECTS = {
    "name": "full",
    "_target_": "isas_cli.effects.settings.Effects",
    "probe": False,
    "max_depth": None,
    "derivative_depth": None,
    "light_samples": None,
    "directions": 1,
    "roulette": None,
    "caustics": None,
    "tolerance": 0.005,
    "derivative_tolerance": 0.3,
    "finish": 0.0,
}
_NO_FILTER = {"name": "none", "_target_": "isas_cli.filters.none.Nothing"}
_GAUSSIAN = {"name": "gaussian", "_target_": "isas_cli.filters.gaussian.Gaussian"}
_NO_PRIOR = {"name": "none", "_target_": "isas_cli.losses.priors.Nothing"}


def _known(settings: dict[str, Any]) -> dict[str, Any]:
    """Without what was every sampler's and meant nothing here."""
    return {k: v for k, v in settings.items() if k not in ("floor", "refresh", "stage1")}
