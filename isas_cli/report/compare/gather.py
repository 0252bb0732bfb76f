"""Which runs there are, and which of them differ in nothing but their seed."""

from __future__ import annotations

import json
import math
import re
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...records import Run, load
from ...records import manifest as manifests
from ...records.files import walked
from ...records.follow import measures
from ...records.reader import read_json
from ...runtime.budget import Budget
from ...runtime.errors import InputError, nearest
from . import labels
from .labels import Settings
from .series import AXES, MEASURES, Series, known, read, seed

if TYPE_CHECKING:
    import pandas

# Any of these makes a folder one that somebody would miss in a comparison.
_MARKS = {"manifest.json", "history.csv", "summary.json"}
# Of photographs: where things lie, whose content the hashes cover.
_PLACES = ("path", "cameras", "mesh", "environment", "images", "masks", "texture")
# The rates are each method's own business: methods that differ in nothing else are one.
_OWN = "optimizer.lr=", "optimizer.factor="
_DEFAULT_BASELINE = "uniform"
# Of a run's notes, those without which its figures would be taken for what they are not.
_TOLD = "has no effect", "no perfect fit"
# How much longer than another a method went on by the same budget, as a share, that is said.
_UNEQUAL = 0.05


@dataclass(frozen=True)
class Method:
    """All runs of one scene that differ in nothing but seed (and name, folder, machine).

    scene: with what tells problems of the same name apart, such as ``pottery size=tiny``;
    runs: by seed, each with at least two rows of history.
    """

    scene: str
    label: str
    runs: list[Run]

    @property
    def sampler(self) -> str:
        return self.label.partition(" ")[0]


@dataclass(frozen=True)
class Problems:
    """One measure on all scenes. ``times``: method → scene → billed seconds ``(levels, seeds)`` to
    each level, +inf: not reached; ``spent``: likewise ``(seeds,)``, how far each run went;
    ``finals``: likewise final errors, as shares of the start's; ``budgets``: by scene, seconds."""

    measure: str
    baseline: str
    times: dict[str, dict[str, np.ndarray]]
    spent: dict[str, dict[str, np.ndarray]]
    finals: dict[str, dict[str, np.ndarray]]
    budgets: dict[str, float]


@dataclass(frozen=True)
class Comparison:
    """Everything that tables, plots and page are made from.

    methods: scene by scene, the baseline first; baseline: scene → label; curves, accuracy, price,
    summary: see `curves.table`, `accuracy.table`, `price.table`, `summary.table`, numbers
    throughout; warnings: what was left out and why, and what the runs themselves warn of; across:
    all scenes together, see `across.problems`.
    """

    methods: list[Method]
    baseline: dict[str, str]
    curves: pandas.DataFrame
    accuracy: pandas.DataFrame
    price: pandas.DataFrame
    summary: pandas.DataFrame
    warnings: list[str]
    across: list[Problems] = field(default_factory=list)


def gather(
    folders: list[Path], baseline: str | None
) -> tuple[list[Method], dict[str, str], list[str]]:
    """The methods found in ``folders`` and below, the baseline of each scene, and warnings.

    Used are runs with two evaluations or more, also those that ended early (an interrupted or a
    numerically failed run says what it reached; leaving failures out would flatter their method).
    Raises InputError where a folder holds no run, no run can be used, or no scene has ``baseline``
    (a full label, or a sampler that only one of a scene's methods has).
    """
    warnings: list[str] = []
    usable = list(_usable(folders, warnings))
    if not usable:
        reason = warnings[0] if warnings else "none found"
        raise InputError(f"{_listed(folders)}: no run that can be compared: {reason}")
    found = [
        method
        for scene, runs in _scenes(usable, warnings).items()
        for method in _methods(scene, runs, warnings)
    ]
    chosen = _baselines(found, baseline, warnings)
    found.sort(key=lambda m: (m.scene, m.label != chosen[m.scene], m.label))
    warnings += _of_runs(found)
    return found, chosen, warnings


def by_scene(methods: list[Method]) -> dict[str, list[Method]]:
    """The methods of each scene, in their order."""
    grouped: dict[str, list[Method]] = defaultdict(list)
    for method in methods:
        grouped[method.scene].append(method)
    return dict(grouped)


def by_measure(methods: list[Method]) -> Iterator[tuple[str, str, dict[str, list[Series]]]]:
    """Of each scene and measure: the runs' series by their method's label, where there are any."""
    for scene, group in by_scene(methods).items():
        for measure in MEASURES:
            found = {m.label: known(m.runs, measure) for m in group}
            yield scene, measure, {label: series for label, series in found.items() if series}


def _listed(folders: list[Path]) -> str:
    return ", ".join(str(folder) for folder in folders)


def _usable(folders: list[Path], warnings: list[str]) -> Iterator[Run]:
    seen: set[Path] = set()
    for folder in folders:
        if not folder.is_dir():
            raise InputError(f"{folder}: no such folder: give runs' folders or folders of runs")
        refused: list[OSError] = []
        below = list(_find(folder, refused))
        unread = [f"left out: {error.filename}: {error.strerror}" for error in refused]
        if not below:
            none = f"{folder} holds no run, nor does any folder below it"
            raise InputError("; ".join([none, *unread]))
        warnings += unread
        for path in below:
            if path.resolve() in seen:
                continue
            seen.add(path.resolve())
            try:
                run = load(path)
            except InputError as error:
                warnings.append(f"left out: {_failure(path) or error}")
                continue
            if reason := _unusable(run):
                warnings.append(f"left out: {path}: {reason}")
            else:
                yield run


def _find(folder: Path, refused: list[OSError]) -> Iterator[Path]:
    """Folders that hold (part of) a run, in order; hidden ones are not searched. ``refused`` gets
    why others could not be."""
    for path, names, files in walked(folder, refused.append):
        names[:] = [name for name in names if not name.startswith(".")]
        if _MARKS & set(files) and not measures(path):
            yield path


def _failure(folder: Path) -> str | None:
    """Why a job ended before it had a record, where it could still say so."""
    try:
        summary = read_json(folder / "summary.json")
    except InputError:
        return None
    return f"{folder}: {_failed(summary)}" if summary.get("status") == "failed" else None


def _failed(summary: dict) -> str:
    return f"failed: {' '.join(str(summary.get('error', 'it does not say why')).split())}"


def _unusable(run: Run) -> str | None:
    """Why a run that could be read cannot be compared."""
    summary, history = run.summary or {}, run.history
    if summary.get("status") == "failed" and not summary.get("killed"):
        return _failed(summary)
    missing = [c for c in ("iteration", *AXES, *MEASURES) if c not in history.columns]
    if missing:
        return f"damaged: history.csv has no column {', '.join(missing)}"
    if len(history) < 2:
        return f"{len(history)} evaluations: two are needed"
    if history["iteration"].iloc[0] != 0:
        return "damaged: history.csv does not begin at the start"
    for axis in AXES:
        cost = history[axis].to_numpy(dtype=float)
        if not np.isfinite(cost).all() or (np.diff(cost) < 0).any() or cost[0] < 0:
            return f"damaged: {axis} in history.csv do not grow from row to row"
    if all(read(run, measure) is None for measure in MEASURES):
        return "no error above 0 at its start and a finite one after it"
    if not run.config:
        return "it has no config.yaml: which method it is cannot be told"
    return None


def _scenes(runs: list[Run], warnings: list[str]) -> dict[str, list[Run]]:
    """Runs by scene. Runs of a scene whose content, targets or starts differ pose different
    problems: their errors cannot be compared, so each problem gets a name of its own."""
    problems: dict[str, dict[tuple, list[Run]]] = defaultdict(lambda: defaultdict(list))
    for run in runs:
        problems[_scene_name(run)][_identity(run)].append(run)
    named = {}
    for name, groups in problems.items():
        settings = [_told(members[0]) for members in groups.values()]
        names = labels.scenes(name, settings)
        named |= dict(zip(names, groups.values()))
        if len(names) > 1:
            warnings.append(
                f"{name}: not all runs pose the same problem (scene, targets or start values "
                f"differ), so they are compared apart, each as a scene of its own: "
                f"{', '.join(names)}"
            )
    return named


def _scene_name(run: Run) -> str:
    scene = run.config.get("scene")
    name = scene.get("name") if isinstance(scene, dict) else scene
    return str(name or (run.summary or {}).get("scene") or "unnamed")


def _hashes(run: Run) -> Settings:
    named = {name: run.manifest.get(name) for name in ("scene_hash", "target_hash", "start_hash")}
    return {name: str(value)[:8] for name, value in named.items() if value}


def _identity(run: Run) -> tuple:
    """Equal for runs that start at the same place of the same problem."""
    problem, _ = labels.split(labels.flatten(run.config))
    hashes = _hashes(run)
    if {"scene_hash", "target_hash"} <= hashes.keys():  # however the configuration puts it
        problem = {key: value for key, value in problem.items() if _of_unknowns(key)}
    if "start_hash" in hashes:
        problem = {k: value for k, value in problem.items() if not re.search(r"\.start(\.|$)", k)}
    return (*hashes.items(), *sorted(problem.items()))


def _of_unknowns(key: str) -> bool:
    """Whether it says what is unknown, and how, in a scene whose content is known otherwise."""
    if key.startswith("scene.photos."):
        return key.rpartition(".")[2] not in _PLACES
    return ".unknowns." in key or key.startswith("scene.poses.")


def _told(run: Run) -> Settings:
    problem, _ = labels.split(labels.flatten(run.config))
    return problem | _hashes(run)


def _methods(scene: str, runs: list[Run], warnings: list[str]) -> list[Method]:
    groups: dict[tuple, list[Run]] = defaultdict(list)
    for run in runs:
        _, settings = labels.split(labels.flatten(run.config))
        settings |= _code(run, settings) | _limits(run)
        groups[tuple(sorted(settings.items()))].append(run)
    named = labels.methods([dict(settings) for settings in groups])
    machines = sorted({_machine(run) for run in runs})
    if len(machines) > 1:
        warnings.append(
            f"{scene}: made on different machines or by other versions ({'; '.join(machines)}): "
            "compare paths rather than seconds"
        )
    if len({_evaluated(run) for run in runs}) > 1:
        warnings.append(
            f"{scene}: evaluated otherwise (evaluation.…, or over a loss's windows) in some runs: "
            "compare neither errors that are nearly 0 nor times to levels"
        )
    headlines = sorted({run.parameter_rmse_is for run in runs})
    if len(headlines) > 1:
        warnings.append(
            f"{scene}: parameter_rmse is not the same in all runs ({'; '.join(headlines)}): "
            "compare its ratio to the start's"
        )
    found = [
        Method(scene, label, _by_seed(scene, label, members, warnings))
        for label, members in zip(named, groups.values())
    ]
    warnings += [*_at_unequal_time(scene, found), *_simulated_otherwise(scene, found)]
    return found


def _code(run: Run, settings: Settings) -> Settings:
    """Classes of packages beside isas with the version of their code: changed code is another
    method. With the versions of all of them, where none is called as the class's package is."""
    guests = run.manifest.get("guests") or {}
    known = {name.replace("-", "_"): version for name, version in guests.items()}
    return {
        key: f"{value}@{known.get(package, ','.join(known.values()))}"
        for key, value in settings.items()
        if key.endswith("._target_")
        and (package := value.partition(".")[0]) != "isas_cli"
        and known
    }


def _limits(run: Run) -> Settings:
    """The budget as it was heeded: without any limit there is one."""
    budget = _budget(run)
    return {} if budget is None else labels.flatten({"budget": vars(budget)})


def _budget(run: Run) -> Budget | None:
    given = run.config.get("budget")
    try:
        return Budget(**{limit.name: given.get(limit.name) for limit in fields(Budget)})
    except (AttributeError, TypeError, InputError):  # as somebody wrote it
        return None


def _evaluated(run: Run) -> str:
    """Equal for runs whose errors are those of the same pixels, seen as well."""
    loss = run.config.get("loss")
    side = loss.get("side") if isinstance(loss, dict) else None
    return repr((sorted((run.config.get("evaluation") or {}).items()), side))


def _at_unequal_time(scene: str, methods: list[Method]) -> list[str]:
    """That of methods which were all given the same seconds some went on for longer: what is begun
    is ended, and a step has no bound; or stopped sooner, where they were to."""
    ends: dict[tuple[Budget, bool], dict[str, float]] = defaultdict(dict)
    for method in methods:
        budget = _budget(method.runs[0])
        done = all((run.summary or {}).get("status") == "done" for run in method.runs)
        if done and budget == Budget(budget and budget.seconds):
            last = [run.history["seconds"].iloc[-1] for run in method.runs]
            converged = bool(method.runs[0].config["budget"].get("converged"))
            ends[budget, converged][method.label] = float(np.median(last))
    warnings = []
    for (_, converged), found in ends.items():
        why = "they stopped at their targets' noise" if converged else "a step has no bound"
        first, last = (most(found, key=found.__getitem__) for most in (min, max))
        if found[last] > (1 + _UNEQUAL) * found[first]:
            warnings.append(
                f"{scene}: final errors are of unequal time ({first} {found[first]:.3g} s, {last} "
                f"{found[last]:.3g} s), as {why}: compare times to levels"
            )
    return warnings


def _simulated_otherwise(scene: str, methods: list[Method]) -> list[str]:
    """Where a method's runs have measured by themselves, and unlike, what they simulate."""
    told = []
    for method in methods:
        plans = {
            json.dumps([run.manifest.get("plan", {}).get(x) for x in _PLAN]) for run in method.runs
        }
        if len(plans) > 1:
            told.append(
                f"{scene}, {method.label}: its seeds simulate unlike things ({len(plans)} plans), "
                "as each measured what pays for itself: race them, or set effects.… for all"
            )
    return told


# Of a run's plan of effects: what it decides.
_PLAN = "max_depth", "derivative_depth", "light_samples", "directions", "caustics", "views"


def _machine(run: Run) -> str:
    manifest = run.manifest
    begun = {**(manifest.get("machine") or {}), "threads": manifest.get("threads", "?")}
    each = (
        f"{part.get('device', 'unknown device')}, {part.get('threads', '?')} threads"
        for part in (begun, *manifest.get("resumed", []))
    )
    variant = manifest.get("variant", "unknown variant")
    versions = ", ".join(" ".join(each) for each in manifests.versions(manifest).items())
    return f"{' then '.join(dict.fromkeys(each))}, {variant}, {versions}"


def _by_seed(scene: str, label: str, runs: list[Run], warnings: list[str]) -> list[Run]:
    """One run for each seed: of several the last that ended as planned, else the last."""

    def rank(run: Run) -> tuple:
        done = (run.summary or {}).get("status") == "done"
        return done, str(run.manifest.get("started", "")), str(run.folder)

    kept: dict[str, Run] = {}
    for run in sorted(runs, key=rank, reverse=True):
        first = kept.setdefault(str(seed(run)), run)
        if first is not run:
            warnings.append(
                f"left out: {run.folder}: {scene}, {label} has seed {seed(run)} twice; "
                f"{first.folder} is the one used"
            )
    return sorted(kept.values(), key=lambda run: (seed(run) is None, seed(run)))


def _baselines(methods: list[Method], wanted: str | None, warnings: list[str]) -> dict[str, str]:
    chosen = {}
    missing = []
    for scene, group in by_scene(methods).items():
        found = _named(group, wanted) if wanted else []
        if len(found) > 1:
            raise InputError(
                f"--baseline {wanted}: {scene} has several: {', '.join(sorted(found))}"
            )
        if not found:
            missing.append(scene)
            found = _named(group, _DEFAULT_BASELINE)
            if len(found) > 1:
                found = sorted(found, key=lambda label: (_ends(group, label), label))
                warnings.append(
                    f"{scene}: {len(found)} methods are {_DEFAULT_BASELINE}: the baseline is "
                    f"{found[0]}, which ends lowest: --baseline METHOD names another"
                )
            found = found or sorted(m.label for m in group)
        chosen[scene] = found[0]
    if wanted and len(missing) == len(chosen):
        known = dict.fromkeys(name for m in methods for name in (m.sampler, m.label))
        raise InputError(f"--baseline {wanted}: no method has this name; {nearest(wanted, known)}")
    if wanted:
        warnings += [f"{s}: no method {wanted}: compared with {chosen[s]}" for s in missing]
    return chosen


def _ends(group: list[Method], label: str) -> float:
    """The median final error of a method: of its parameters, or else of the images."""
    (runs,) = (m.runs for m in group if m.label == label)
    last = [run.history.iloc[-1] for run in runs]
    known = [row.get("parameter_rmse", math.nan) for row in last]
    known = known if np.isfinite(known).all() else [row["image_rmse"] for row in last]
    return float(np.median(known))


def _named(group: list[Method], name: str) -> list[str]:
    """The labels that ``name`` means: the one that it is, with the rate or without, else those of
    the sampler."""
    exact = [label for label, plain in names(group).items() if name in (label, plain)]
    return exact or [m.label for m in group if m.sampler == name]


def names(group: list[Method]) -> dict[str, str]:
    """Label → name without the rates, where that still tells the methods of a scene apart."""
    plain = {m.label: " ".join(w for w in m.label.split() if not w.startswith(_OWN)) for m in group}
    return plain if len(set(plain.values())) == len(plain) else {m.label: m.label for m in group}


def _of_runs(methods: list[Method]) -> list[str]:
    """How runs ended if not as planned, and what they warn of, or note of ``_TOLD``; once for all
    seeds alike."""
    lines = []
    for method in methods:
        said: dict[str, list[str]] = defaultdict(list)
        for run in method.runs:
            end = f"used up to {run.history['seconds'].iloc[-1]:.4g} s"
            if run.summary is None:
                lines.append(f"{run.folder}: killed, or not yet at its end: {end}")
            elif run.summary.get("status") != "done":
                lines.append(f"{run.folder}: {run.summary.get('status')}: {end}")
            summary = run.summary or {}
            notes = [n for n in summary.get("notes") or [] if any(told in n for told in _TOLD)]
            for text in [*(summary.get("warnings") or []), *notes]:
                said[text].append(str(seed(run)))
        for text, seeds in said.items():
            lines.append(f"{method.scene}, {method.label}, seed {', '.join(seeds)}: {text}")
    return lines
