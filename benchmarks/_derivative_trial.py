"""The derivatives of one scene's keys, by every way and at every point, as rows of a table.

The reference is Mitsuba's ``path`` at two pairs of values with the same random numbers, from which
the error of second order is taken out (Richardson); at an end of a range, at two values inside.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import mitsuba as mi
import numpy as np
from _derivative_methods import FUNCTIONALS, Trial

from isas_cli.unknowns import verdicts
from isas_cli.unknowns.kind import Kind

WAYS = ("prb", "path", "isas", "replayed")
# A standard error of a difference between two ways that is small enough, of the derivative; and of
# the picture, for what changes next to nothing.
ENOUGH, NOTHING = 0.015, 2e-4
# Estimates of every way at least, and differences for each.
_FEWEST, _MORE = 4, 4
# Of a range: half of the longer step inside, and the longer one at an end.
_INSIDE, _AT_END = 0.04, 0.03
# Low and high for parameters of which ``isas`` knows no bound, by the key's words.
_ENDS = {
    "opacity": (0.0, 1.0),
    "weight": (0.0, 1.0),
    "specular_transmittance": (0.0, 1.0),
    "transmittance": (0.0, 1.0),
    "clearcoat": (0.0, 1.0),
    "clearcoat_gloss": (0.0, 1.0),
    "anisotropic": (0.0, 1.0),
    "sheen": (0.0, 1.0),
    "sheen_tint": (0.0, 1.0),
    "spec_tint": (0.0, 1.0),
    "flatness": (0.0, 1.0),
    "diff_trans": (0.0, 2.0),
    "alpha_u": (0.03, 1.0),
    "alpha_v": (0.03, 1.0),
    "eta": (1.1, 2.2),
    "color0": (0.0, 1.0),
    "color1": (0.0, 1.0),
    "vertex_color": (0.0, 1.0),
    "vertex_grey": (0.0, 1.0),
    "face_color": (0.0, 1.0),
    "longitudinal_roughness": (0.1, 0.9),
    "azimuthal_roughness": (0.1, 0.9),
    "cutoff_angle": (20.0, 40.0),
    "beam_width": (5.0, 20.0),
    "normalmap": (0.3, 0.7),
    "nested_texture": (0.0, 1.0),
}
# Keys whose generic value alone says nothing at ends: a point of a map, not of a number.
_GENERIC_ALONE = ("sun_direction", "normalmap", "nested_texture", "S", "theta", "delta")


@dataclass(frozen=True)
class Point:
    """``label``: generic, low or high; ``side``: 0 inside, 1 or -1 where only larger or smaller
    values are legal; ``step``: the longer one; ``span``: what the parameter ranges over."""

    label: str
    value: np.ndarray
    side: int
    step: float
    span: float


def points(key: str, kind: Kind, ends: bool) -> list[Point]:
    """Where a key is looked at."""
    low, high = bounds(key, kind)
    here = kind.present
    span = high - low
    below, above = float(np.min(here)) - low, high - float(np.max(here))
    short = _AT_END * span
    # Near 0 a number that is to stay positive means more by its ratios.
    least = min(short, 0.25 * low) if low > 0 else short
    if below <= 0 or above <= 0:
        sides = (1, least) if below <= 0 else (-1, short)
        found = [Point("generic", here, *sides, span)]
    else:
        found = [Point("generic", here, 0, min(_INSIDE * span, below, above), span)]
    if ends and not set(key.split(".")) & set(_GENERIC_ALONE):
        found.append(Point("low", np.full_like(here, low), 1, least, span))
        found.append(Point("high", np.full_like(here, high), -1, short, span))
    return found


def bounds(key: str, kind: Kind) -> tuple[float, float]:
    """Lowest and highest value at which a key is looked at: its range, or what is sensible."""
    known = next((_ENDS[word] for word in reversed(key.split(".")) if word in _ENDS), None)
    size = float(np.abs(kind.present).max()) or 1.0
    low, high = known or (-size, size)
    if known is None and np.all(kind.present > 0):
        low, high = size / 4, size * 2
    return tuple(
        float(own) if np.isfinite(own) else float(other)
        for own, other in zip(kind.range, (low, high))
    )


def directions(key: str, kind: Kind) -> dict[str, np.ndarray]:
    """All entries alike, and of arrays each by another amount."""
    found = {"all": np.ones_like(kind.present)}
    if kind.present.size > 3 or key.endswith("_direction"):
        random = np.random.default_rng(kind.present.size)
        found["random"] = random.uniform(0, 2, kind.present.shape).astype(np.float32)
    return found


@dataclass
class Estimates:
    """By way and (key, point, direction): one ``(2,)`` a seed."""

    found: dict[tuple, list[np.ndarray]] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)

    def add(self, *where, value: np.ndarray) -> None:
        self.found.setdefault(where, []).append(value)

    def of(self, *where) -> tuple[np.ndarray, np.ndarray]:
        """Mean and its standard error, of each functional."""
        each = np.array(self.found.get(where, np.full((1, 2), np.nan)))
        if len(each) < 2:
            return each.mean(0), np.full(2, np.nan)
        return each.mean(0), each.std(0, ddof=1) / np.sqrt(len(each))


class Census:
    """Of one scene. ``seeds``: at most, of each estimate; ``seconds``: of each point, after which
    what is not sure stays so."""

    def __init__(self, trial: Trial, seeds: int, seconds: float):
        self.trial, self.seeds, self.seconds = trial, seeds, seconds
        self.estimates = Estimates()
        kinds = ("volpath", "prbvolpath") if trial.media else ("path", "prb")
        self.path, self.prb = map(trial.integrator, kinds)
        self.ways: dict[str, Callable] = {
            "prb": lambda values, seed: trial.by_mitsuba(self.prb, values, seed),
        }
        if not trial.media:  # where it takes minutes
            self.ways["path"] = lambda values, seed: trial.by_mitsuba(self.path, values, seed)
        if trial.problem is not None:
            self.ways["isas"] = lambda values, seed: trial.by_isas(trial.isas, values, seed)
        if trial.problem is not None and trial.replayed is not None:
            self.ways["replayed"] = lambda values, seed: trial.by_isas(trial.replayed, values, seed)

    def rows(self, ends: bool) -> Iterator[dict]:
        """All keys at their generic values, and each by itself at the ends of its range."""
        kinds = self.trial.kinds.items()
        still = {key: kind for key, kind in kinds if not kind.moves_geometry}
        every = {key: points(key, kind, ends) for key, kind in still.items()}
        present = {key: kind.present for key, kind in still.items()}
        self._pictures()
        if still:
            generic = {key: found[0] for key, found in every.items()}
            yield from self._at(generic, present)
        for key, found in every.items():
            for point in found[1:]:
                self.estimates.failed.clear()
                # All attached: the kernels stay those of the generic values.
                yield from self._at({key: point}, present | {key: point.value})
                self.trial.put({key: present[key]})

    def _pictures(self) -> None:
        for seed in range(8):
            self.estimates.add("picture", value=self.trial.picture(self.path, 500 + seed))
            try:
                self.estimates.add("picture_isas", value=self.trial.pictured(700 + seed))
            except Exception as error:  # whatever Mitsuba and Dr.Jit say
                self.estimates.failed["picture_isas"] = _said(error)
                break

    def _at(self, at: dict[str, Point], values: dict[str, np.ndarray]) -> Iterator[dict]:
        begun = time.perf_counter()
        for seed in range(self.seeds):
            for key, point in at.items():
                self._referred(key, point, seed)
            for way in self.ways:
                if way not in self.estimates.failed and not (
                    seed >= _FEWEST and all(self._sure(key, at[key], way) for key in at)
                ):
                    self._derived(way, at, values, 1000 + seed)
            if seed >= _FEWEST - 1 and (
                time.perf_counter() - begun > self.seconds
                or all(self._sure(key, at[key], *self._every) for key in at)
            ):
                break
        for key, point in at.items():
            yield from self._told(key, point)

    @property
    def _every(self) -> list[str]:
        return ["reference", *(way for way in self.ways if way not in self.estimates.failed)]

    def _referred(self, key: str, point: Point, seed: int) -> None:
        """Differences, which cost less than derivatives: as many as are needed, within limits."""
        for number in range(_MORE * seed, _MORE * (seed + 1)):
            if number >= _FEWEST and self._sure(key, point, "reference"):
                return
            for name, along in directions(key, self.trial.kinds[key]).items():
                long, short = self._differences(key, point, along, 10_000 + number)
                share = 4 / 3 if point.side == 0 else 2
                where = key, point.label, name
                best = share * short + (1 - share) * long
                self.estimates.add("reference", *where, value=best)
                self.estimates.add("short", *where, value=short)

    def _derived(self, way: str, at: dict[str, Point], values: dict, seed: int) -> None:
        try:
            both = self.ways[way](values, seed)
        except Exception as error:  # whatever Mitsuba and Dr.Jit say
            self.estimates.failed[way] = _said(error)
            return
        for key, point in at.items():
            for name, along in directions(key, self.trial.kinds[key]).items():
                found = [np.sum(each[key] * along) if key in each else np.nan for each in both]
                self.estimates.add(way, key, point.label, name, value=np.array(found))

    def _differences(self, key: str, point: Point, along: np.ndarray, seed: int):
        """By the longer and the shorter step."""

        def told(step: float) -> np.ndarray:
            self.trial.put({key: (point.value + step * along).astype(np.float32)})
            return self.trial.picture(self.path, seed)

        found = []
        size = point.step / max(1.0, float(along.max()))
        middle = told(0.0) if point.side else None
        for step in (size, size / 2):
            if point.side:
                found.append((told(point.side * step) - middle) / (point.side * step))
            else:
                found.append((told(step) - told(-step)) / (2 * step))
        self.trial.put({key: point.value})
        return found

    def _sure(self, key: str, point: Point, *ways: str) -> bool:
        """Whether the standard errors are small enough; of what is refused, they are."""
        picture, _ = self.estimates.of("picture")
        for name in directions(key, self.trial.kinds[key]):
            mean, _ = self.estimates.of("reference", key, point.label, name)
            enough = np.maximum(ENOUGH * np.abs(mean), NOTHING * picture / point.span)
            for way in ways:
                found, error = self.estimates.of(way, key, point.label, name)
                if np.all(np.isfinite(found)) and not np.all(error <= enough / np.sqrt(2)):
                    return False
        return True

    def _told(self, key: str, point: Point) -> Iterator[dict]:
        kind, found = self.trial.kinds[key], self.estimates
        for name in directions(key, kind):
            where = key, point.label, name
            short, _ = found.of("short", *where)
            for number, functional in enumerate(FUNCTIONALS):
                row = {
                    "key": key,
                    "kind": kind.name,
                    "point": point.label,
                    "value": float(np.mean(point.value)),
                    "span": point.span,
                    "direction": name,
                    "picture": found.of("picture")[0][number],
                    "picture_isas": found.of("picture_isas")[0][number],
                    "picture_isas_error": found.of("picture_isas")[1][number],
                    "short": short[number],
                    "functional": functional,
                }
                for way in ("reference", *WAYS):
                    mean, error = found.of(way, *where)
                    row |= {way: mean[number], f"{way}_error": error[number]}
                    if way in WAYS:
                        row[f"{way}_said"] = found.failed.get(way, self._refused(way, key))
                yield row

    def _refused(self, way: str, key: str) -> str:
        said = self.trial.refused.get(key, "") if way in ("isas", "replayed") else ""
        return f"refused: {said}" if said else ""


def _said(error: Exception) -> str:
    """The first words of what an error began with, on one line."""
    while error.__cause__ is not None:
        error = error.__cause__
    return " ".join(f"{type(error).__name__}: {error}".split())[:160]


def census(path: Path, subject: str, ends: bool, seeds: int, seconds: float) -> Iterator[dict]:
    """Rows of the scene of a file, which is about a plugin; keys that move things or are refused
    before there is a scene have one, without numbers."""
    trial = Trial.of(path, "thing")
    names = {holder.class_name(): subject for holder in _holders(trial.scene, subject)}

    def owned(row: dict) -> dict:
        kind, word = (
            verdicts.place(trial.params, row["key"]) if row["key"] in trial.params else ("", "")
        )
        return {"plugin": names.get(kind, ""), "class": kind, "word": word} | row

    for key, kind in trial.kinds.items():
        if kind.moves_geometry:
            yield owned({"key": key, "kind": kind.name, "point": "generic", "isas_said": "moves"})
    for key, said in trial.refused.items():
        if key not in trial.kinds:
            yield owned({"key": key, "point": "generic", "isas_said": f"refused: {said}"})
    yield from map(owned, Census(trial, seeds, seconds).rows(ends))


def _holders(scene: mi.Scene, subject: str) -> list:
    """The objects of a scene that the plugin ``subject`` has made: of its type, and on the thing on
    trial itself."""
    types = {
        "BSDF": mi.BSDF,
        "Emitter": mi.Emitter,
        "Medium": mi.Medium,
        "PhaseFunction": mi.PhaseFunction,
    }
    wanted = types.get(mi.PluginManager.instance().plugin_type(subject).name)
    found = [emitter for emitter in scene.emitters() if emitter.id() == "thing"]
    for shape in scene.shapes():
        if shape.id() == "thing":
            found += [shape.bsdf(), shape.emitter(), shape.interior_medium()]
    found += [medium.phase_function() for medium in found if isinstance(medium, mi.Medium)]
    return [each for each in found if wanted and isinstance(each, wanted)]
