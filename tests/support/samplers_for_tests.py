"""The samplers that draw pixels for path replay."""

from __future__ import annotations

from functools import cache

from gradient_estimates import configured

from isas_cli.config.compose import options
from isas_cli.config.presets import PRESETS
from isas_cli.estimators.two_path import Settings


@cache
def pixel_samplers() -> list[str]:
    """Their names, by what they need and that estimator gives."""
    names = (name for name in options("sampler") if name not in PRESETS)
    return [name for name in names if configured("sampler", name).needs <= Settings.gives]
