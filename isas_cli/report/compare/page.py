"""report.html of a comparison: one file that opens offline and answers to clicks.

Plots are Plotly's, sliders are img-comparison-slider's and sorting is sortable-tablesort's; their
scripts go into the page as they are, and start by themselves.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import plotly.offline
import yaml
from markupsafe import Markup

from ...records import Run, write_atomically
from ..figures import Picture
from ..page import template
from . import animation, facts, interactive, interactive_bars, plots, sheet, slides
from .gather import Comparison, Method, by_scene
from .looks import Look, looks

_SLIDER, _SORTER = "img-comparison-slider-8.0.7", "sortable-tablesort-4.1.7"
_HOW_CURVES = (
    "Median over runs with its 95 % bootstrap band (up to five runs: their range); thin where only "
    "some runs went so far. A click on a method hides it, drawing a frame zooms, a double click "
    "zooms back, the buttons change the cost."
)
_HOW_BARS = (
    "Billed seconds of the baseline divided by the method's own: above 1 is sooner. Lines: 95 % "
    "bootstrap interval."
)
_HOW_PRICE = (
    "What it took from twice the level to the level (cross: not reached), and the slope of log "
    "error against log seconds over the last decade of time. Monte Carlo has −1/2: each halving "
    "costs four times the one before."
)


@dataclass(frozen=True)
class _Plot:
    """A zoomable plot: its heading, the piece of HTML, and a sentence on how to read it."""

    title: str
    html: Markup
    note: str


@dataclass(frozen=True)
class _Record:
    """What one run was made with."""

    name: str
    folder: str
    status: str
    config: str
    manifest: str


@dataclass(frozen=True)
class _Scene:
    """Everything that the page says of one scene."""

    name: str
    anchor: str
    baseline: str
    headlines: list[str]
    accuracy: list[facts.Table]
    price: list[facts.Table]
    methods: facts.Table
    curves: list[_Plot]
    others: list[_Plot]
    exposure: str
    groups: list[slides.Group]
    pictures: list[Picture]
    effects: list[tuple[list[str], dict[str, str]]]
    records: list[_Record]


def write(comparison: Comparison, output: Path) -> Path:
    """Writes plots/ (PNG, SVG, WebP) and report.html into `output`; returns the page's path.

    Pictures and measures that the runs did not record are left out, with a warning on the page
    where somebody might miss them. Raises IsasError when the disk refuses.
    """
    output, look = Path(output), looks(comparison)
    plots.write_plots(comparison, output / "plots")
    warnings, scenes = list(comparison.warnings), []
    for number, (name, methods) in enumerate(by_scene(comparison.methods).items()):
        pictures = sheet.write_sheets(methods, look, output / "plots")
        film = animation.write_animation(methods, look, output / "plots")
        if film is None:
            warnings.append(f"{name}: no animation, as its runs saved no pictures on the way")
        pictures += [film] if film else []
        scenes.append(_scene(comparison, name, f"scene{number}", methods, look, pictures, output))
    shown = {"embedded": slides.file_address, "least_width": slides.least_width}
    text = template("isas_cli.report.compare", **shown).render(
        scenes=scenes,
        look=look,
        warnings=warnings,
        runs=sum(len(method.runs) for method in comparison.methods),
        scripts=[Markup(text) for text in (plotly.offline.get_plotlyjs(), *_scripts())],
        styles=[Markup(_vendored(_SLIDER, "styles.css"))]
        + [Markup(_vendored(_SORTER, "sortable-base.css"))],
        licences={name: _vendored(name, "LICENSE") for name in (_SLIDER, _SORTER)},
    )
    path = output / "report.html"

    def save(temporary: Path) -> None:
        temporary.write_text(text, encoding="utf-8")

    write_atomically(path, save)
    return path


def _scene(
    comparison: Comparison,
    name: str,
    anchor: str,
    methods: list[Method],
    look: dict[str, Look],
    pictures: list[Picture],
    output: Path,
) -> _Scene:
    groups, exposure = slides.groups(methods)
    curves, others = _plots(comparison, name, anchor, methods, look)
    return _Scene(
        name=name,
        anchor=anchor,
        baseline=comparison.baseline[name],
        headlines=facts.headlines(comparison, name, methods),
        accuracy=facts.accuracy(comparison, name, methods),
        price=facts.price(comparison, name, methods),
        methods=facts.methods(comparison, name),
        curves=curves,
        others=others,
        exposure=exposure,
        groups=groups,
        pictures=pictures,
        effects=facts.effects(methods),
        records=[_record(m, run, output) for m in methods for run in m.runs],
    )


def _plots(
    comparison: Comparison, scene: str, anchor: str, methods: list[Method], look: dict[str, Look]
) -> tuple[list[_Plot], list[_Plot]]:
    """What accuracy costs, and what happened inside the runs; without what was not recorded."""
    bars = interactive_bars
    every = [
        ("Error against cost", interactive.errors(comparison, scene, methods, look), _HOW_CURVES),
        ("Speed-up over the baseline", bars.speedups(comparison, scene, methods, look), _HOW_BARS),
        ("Price of accuracy", bars.prices(comparison, scene, methods, look), _HOW_PRICE),
        ("Time by phase", bars.times(methods), "Only billed phases count against the budget."),
        ("Gradients", bars.training(methods, look), "At each evaluation; a line for each run."),
    ]
    made = [
        _Plot(title, Markup(interactive.embedded(figure, f"{anchor}plot{index}")), note)
        for index, (title, figure, note) in enumerate(every)
        if figure is not None
    ]
    inside = ("Time by phase", "Gradients")
    return [p for p in made if p.title not in inside], [p for p in made if p.title in inside]


def _record(method: Method, run: Run, output: Path) -> _Record:
    seed = run.config.get("seed")
    return _Record(
        name=f"{method.label}, seed {'not recorded' if seed is None else seed}",
        folder=os.path.relpath(run.folder, output),
        status=str((run.summary or {}).get("status", "no summary: stopped before its end")),
        config=yaml.safe_dump(run.config, sort_keys=False, allow_unicode=True),
        manifest=json.dumps(run.manifest, indent=2, ensure_ascii=False),
    )


def _scripts() -> list[str]:
    return [_vendored(_SLIDER, "index.js"), _vendored(_SORTER, "sortable.auto.min.js")]


def _vendored(library: str, name: str) -> str:
    return (files("isas_cli.report.compare") / "vendor" / library / name).read_text(
        encoding="utf-8"
    )
