"""`isas variance`: how noisy the loss gradient is with each sampler, at one fixed point."""

from __future__ import annotations

from pathlib import Path

from ..config.compose import compose, options, translate
from ..config.grammar import override
from ..config.presets import PRESETS
from ..config.roles import meaning
from ..runtime import interrupt
from ..runtime.errors import InputError
from . import one
from .sweeps import race

_OWN = ("samplers", "contestants", "repeats", "at", "best", "hydra.run.dir")
_REPEATS, _BEST = 1024, 256
# What ratios are of: measured even when it is not asked for.
_REFERENCES = ("uniform", "gradient")


def main(arguments: list[str]) -> int:
    """Measure what ``arguments`` (as typed) say. Raises IsasError; else returns the exit status."""
    one.no_flags("variance", arguments)
    own, overrides = _own(arguments)
    with one.argv(["isas", "variance", *arguments]), interrupt.prompt():
        settings = {
            "repeats": _whole("repeats", own.get("repeats", str(_REPEATS)), 2),
            "at": _share(own.get("at", "0")),
            "best": _whole("best", own.get("best", str(_BEST)), 0),
        }
        cfgs = _configurations(own, overrides)
        common = next(iter(cfgs.values()))
        folder = _folder(own, common)
        one.check_folder(folder, common.overwrite)
        # The first import of Mitsuba, which takes a second.
        from ..measure.variance.run import Plan, run

        asked = "samplers" in own or "contestants" in own
        return run(Plan(cfgs, folder, **settings, asked=asked))


def _own(arguments: list[str]) -> tuple[dict[str, str], list[str]]:
    """The command's own settings by name, and the overrides that all samplers share."""
    own, overrides = race.options_of(arguments, _OWN)
    one.no_sweep(overrides, "leave it out")
    for argument in overrides:
        group = argument.partition("=")[0].lstrip("+~").split("@")[0]
        if group.split(".")[0] == "sampler":
            raise InputError(
                f"{argument}: there are several: samplers=[A,B], or "
                "contestants=[{sampler:ours,sampler.floor:0.1},…]"
            )
        # It would pass for something that has an effect.
        if meaning(group).looped:
            raise InputError(f"{argument}: isas variance has no use for it; leave it out")
    return own, overrides


def _configurations(own: dict[str, str], overrides: list[str]) -> dict:
    """What each sampler's configuration is, by its label; the references come first."""
    if "samplers" not in own and "contestants" not in own:
        drawing = (name for name in options("sampler") if name not in PRESETS)
        own = {**own, "samplers": f"[{','.join(drawing)}]"}
    differences = race.differences(own)
    for difference in differences:
        if "sampler" not in difference:
            raise InputError("contestants: each needs its sampler: {sampler:ours,…}")
        if difference["sampler"] in PRESETS:
            raise InputError(
                f"sampler={difference['sampler']} is short for an estimator, and variances are "
                "measured of path replay's gradient: name samplers that draw pixels"
            )
        for key in difference:
            if key.split(".")[0] != "sampler":
                raise InputError(
                    f"contestants: {key}: all estimate the same gradient and differ in their "
                    "sampler's settings only; give it once, as KEY=VALUE"
                )
    plain = [{"sampler": name} for name in _REFERENCES]
    differences = plain + [d for d in differences if d not in plain]
    common, cfgs = translate(overrides), {}
    for difference in differences:
        more = translate([f"{key}={override(value)}" for key, value in difference.items()])
        cfgs[_label(difference)] = compose([*common, *more])
    return cfgs


def _label(difference: dict) -> str:
    others = [f"{k.removeprefix('sampler.')}={v}" for k, v in difference.items() if k != "sampler"]
    return " ".join([str(difference["sampler"]), *others])


def _whole(name: str, text: str, least: int) -> int:
    if not text.isascii() or not text.isdigit() or int(text) < least:
        raise InputError(f"{name}={text}: a whole number, at least {least}")
    return int(text)


def _share(text: str) -> float:
    try:
        at = float(text)
    except ValueError:
        at = -1.0
    if not 0 <= at <= 1:
        raise InputError(f"at={text}: a number from 0, the start values, to 1, the truth")
    return at


def _folder(own: dict[str, str], cfg) -> Path:
    if "hydra.run.dir" in own:
        return race.folder_of(own["hydra.run.dir"])
    return Path("runs") / "variance" / cfg.scene.name / str(cfg.name)
