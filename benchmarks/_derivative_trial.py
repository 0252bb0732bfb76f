"""The derivatives of one scene's keys, by every way and at every point, as rows of a table.

The reference is Mitsuba's ``path`` at two pairs of values with the same random numbers, from which
the error of second order is taken out (Richardson); at an end of a range, at two values inside.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import mitsuba as mi
import numpy as np
import pandas
from _derivative_methods import FUNCTIONALS, Trial
from _derivative_points import Point, directions, points
from scipy import stats

from isas_cli.unknowns import verdicts

WAYS = ("prb", "path", "isas", "replayed")
# A standard error of a difference between two ways that is small enough, of the derivative; and of
# the picture, for what changes next to nothing.
ENOUGH, NOTHING = 0.015, 2e-4
# Estimates of every way at least, and differences for each.
_FEWEST, _MORE = 6, 4
# Standard errors by which a difference is taken for one.
_SURE = 4.0


@dataclass
class Estimates:
    """By way and (key, point, direction): one ``(2,)`` a seed; ``given``: means and standard errors
    of an earlier table."""

    found: dict[tuple, list[np.ndarray]] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)
    given: dict[tuple, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)

    def add(self, *where, value: np.ndarray) -> None:
        self.found.setdefault(where, []).append(value)

    def of(self, *where) -> tuple[np.ndarray, np.ndarray]:
        """Mean and its standard error, of each functional: so much larger that the mean of a normal
        number would lie beyond four of them as seldom as if the error itself were known."""
        if where in self.given:
            return self.given[where]
        each = np.array(self.found.get(where, np.full((1, 2), np.nan)))
        if len(each) < 2:
            return each.mean(0), np.full(2, np.nan)
        return each.mean(0), _student(len(each)) * each.std(0, ddof=1) / np.sqrt(len(each))


@cache
def _student(count: int) -> float:
    return float(stats.t.isf(stats.norm.sf(_SURE), count - 1) / _SURE)


class Census:
    """Of one scene. ``seeds``: at most, of each estimate; ``seconds``: of each point, after which
    what is not sure stays so; ``known``: earlier rows of the scene, of which all but what ``isas``
    itself gives is kept."""

    def __init__(
        self, trial: Trial, seeds: int, seconds: float, known: pandas.DataFrame | None = None
    ):
        self.trial, self.seeds, self.seconds = trial, seeds, seconds
        self.estimates = Estimates()
        kinds = ("volpath", "prbvolpath") if trial.media else ("path", "prb")
        self.path, self.prb = map(trial.integrator, kinds)
        self.ways: dict[str, Callable] = {}
        if known is None:
            self.ways["prb"] = lambda *at: trial.by_mitsuba(self.prb, *at)
        if known is None and not trial.media:  # where it takes minutes
            self.ways["path"] = lambda *at: trial.by_mitsuba(self.path, *at)
        if trial.problem is not None:
            self.ways["isas"] = lambda *at: trial.by_isas(trial.isas, *at)
        if trial.problem is not None and trial.replayed is not None:
            self.ways["replayed"] = lambda *at: trial.by_isas(trial.replayed, *at)
        self._known = known
        if known is not None:
            self._take(known)

    def _take(self, known: pandas.DataFrame) -> None:
        for where, rows in known.groupby(["key", "point", "direction"]):
            both = rows.set_index("functional").loc[list(FUNCTIONALS)]
            for way in ("reference", "short", "prb", "path"):
                error = both[f"{way}_error"] if way != "short" else both["short"] * np.nan
                self.estimates.given[(way, *where)] = both[way].to_numpy(), error.to_numpy()
            picture = both["picture"].to_numpy()
            self.estimates.given["picture",] = picture, picture * 0

    def rows(self, ends: bool) -> Iterator[dict]:
        """All keys at the file's values, and each by itself at the ends of its range."""
        kinds = self.trial.kinds.items()
        still = {key: kind for key, kind in kinds if not kind.moves_geometry}
        every = {key: points(key, kind, ends) for key, kind in still.items()}
        present = {key: kind.present for key, kind in still.items()}
        together = {key: found[0] for key, found in every.items() if found[0].value is present[key]}
        self._pictures()
        if together:
            yield from self._at(together, present)
        for key, found in every.items():
            for point in found[1:] if key in together else found:
                self.estimates.failed.clear()
                # All attached: the kernels stay those of the generic values.
                yield from self._at({key: point}, present | {key: point.value})
                self.trial.put({key: present[key]})

    def _pictures(self) -> None:
        for seed in range(8):
            if self._known is None:
                self.estimates.add("picture", value=self.trial.picture(self.path, 500 + seed))
            try:
                self.estimates.add("picture_isas", value=self.trial.pictured(700 + seed))
            except Exception as error:  # whatever Mitsuba and Dr.Jit say
                self.estimates.failed["picture_isas"] = _said(error)
                break

    def _at(self, at: dict[str, Point], values: dict[str, np.ndarray]) -> Iterator[dict]:
        begun = time.perf_counter()
        for seed in range(self.seeds):
            for key, point in at.items() if self._known is None else ():
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
                        row[f"{way}_said"] = found.failed.get(way, self._heard(way, *where))
                yield row

    def _heard(self, way: str, key: str, point: str, direction: str) -> str:
        """What is said instead of a number: by ``isas``, or in the earlier table."""
        if way in ("isas", "replayed"):
            said = self.trial.refused.get(key, "")
            return f"refused: {said}" if said else ""
        if self._known is None:
            return ""
        here = self._known[["key", "point", "direction"]] == [key, point, direction]
        return self._known.loc[here.all(axis=1), f"{way}_said"].fillna("").iloc[0]


def _said(error: Exception) -> str:
    """The first words of what an error began with, on one line."""
    while error.__cause__ is not None:
        error = error.__cause__
    return " ".join(f"{type(error).__name__}: {error}".split())[:160]


def census(path: Path, subject: str, ends: bool, *limits) -> Iterator[dict]:
    """Rows of the scene of a file, which is about a plugin; keys that move things or are refused
    before there is a scene have one, without numbers. ``limits``: of ``Census``."""
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
    yield from map(owned, Census(trial, *limits).rows(ends))


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
