"""Samplers that stand for an estimator with uniform pixels, such as ``sampler=plateau``."""

from __future__ import annotations

import re

from ..runtime.errors import InputError

PRESETS = ("plateau", "mitsuba", "finite_differences")
# Settings of these estimators, which may be said of the preset.
_OF_ESTIMATORS = tuple(
    f"sampler.{name}"
    for name in (
        *("gradient", "smooth", "scheme", "pairs", "spp", "common", "residual", "residual_spp"),
        *("silhouettes", "step"),
    )
)


# Those of a sweep's words, such as choice(plateau,mitsuba).
_NAME = re.compile(r"[\w.-]+(?![\w.-]*\()")


def unpacked(overrides: list[str], within: str) -> list[str]:
    """What is typed of a preset, such as ``sampler=plateau``, as what it stands for:
    ``sampler.scheme=…`` is ``estimator.scheme=…``, and with ``sampler.base=gradient`` (``within``)
    the pixels are drawn by that sampler."""
    found = []
    typed = (o.partition("=")[2] for o in overrides if o.startswith("sampler="))
    named = [_NAME.findall(each) for each in typed]
    preset = next((name for name in PRESETS if [name] in named), None)
    # Of another sampler's setting the answer should name the sampler.
    other = any(not set(names) & set(PRESETS) for names in named)
    base = next((o for o in overrides if o.lstrip("+").startswith(f"{within}=")), None)
    for override in overrides:
        key, equals, value = override.lstrip("+").partition("=")
        if preset and base and override == f"sampler={preset}":
            found.append(f"estimator={preset}")
        elif preset and override == base:
            found.append(f"sampler={value}")
        elif preset and key.startswith(f"{within}."):
            found.append(f"sampler{key[len(within) :]}={value}")
        elif equals and not other and key in _OF_ESTIMATORS:
            found.append(f"estimator.{key.partition('.')[2]}={value}")
        else:
            found.append(override)
    return found


def check(sampler: str | None, estimator: str | None) -> None:
    """Raises InputError for a preset beside another estimator than its own."""
    if sampler in PRESETS and sampler != estimator:
        raise InputError(
            f"sampler={sampler} is a preset for estimator={sampler}: with estimator={estimator} "
            "say which pixels are drawn, such as sampler=uniform"
        )
