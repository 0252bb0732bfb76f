"""report.html of a comparison: one file that opens offline and answers to clicks.

Plots are Plotly's, sliders are img-comparison-slider's and sorting is sortable-tablesort's; their
scripts go into the page as they are, and start by themselves.
"""

from __future__ import annotations

import contextlib
import json
import os
from importlib.resources import files
from pathlib import Path
from typing import Any

import plotly.offline
import yaml
from markupsafe import Markup

from ...records import Run, write_text
from ...records.follow import unended
from .. import interactive
from ..chart import Chart
from ..page import template
from . import animation, charts, facts, plots, sheet, slides, together
from .gather import Comparison, Method, by_scene
from .styles import repeated, styles

_SLIDER, _SORTER = "img-comparison-slider-8.0.7", "sortable-tablesort-4.1.7"
_LIST = ".made"  # in plots/: the stems of what was written there


def write(comparison: Comparison, output: Path) -> Path:
    """Writes plots/ (PNG, SVG, WebP) and report.html into `output`; returns the page's path. Plots
    of an earlier comparison go.

    Pictures and measures that the runs did not record are left out, with a warning on the page
    where somebody might miss them. Raises IsasError when the disk refuses.
    """
    output, own = Path(output), styles(comparison)
    warnings, scenes, made = [*comparison.warnings, *repeated(own)], [], []
    for number, (name, methods) in enumerate(by_scene(comparison.methods).items()):
        costs = charts.of_costs(comparison, name, methods, own)
        insides = charts.of_insides(methods, own)
        made += plots.write_plots(name, [*costs, *insides], output / "plots")
        pictures = sheet.write_sheets(methods, own, output / "plots")
        film = animation.write_animation(methods, own, output / "plots")
        if film is None:
            warnings.append(f"{name}: no animation, as its runs saved no pictures on the way")
        pictures += [film] if film else []
        made += [picture.path for picture in pictures]
        anchor = f"scene{number}"
        scene = _scene(comparison, name, anchor, methods, output)
        drawn = {"costs": _plots(anchor, costs), "insides": _plots(f"{anchor}in", insides)}
        scenes.append({**scene, **drawn, "pictures": pictures})
    chips = together.styled(comparison, own)
    whole = together.charts(comparison, chips)
    made += plots.write_plots("all", whole, output / "plots")
    shown = {"embedded": slides.file_address, "least_width": slides.least_width}
    text = template("isas_cli.report.compare", **shown).render(
        scenes=scenes,
        together=together.tables(comparison),
        together_plots=_plots("all", whole),
        baseline=comparison.across[0].baseline if comparison.across else "",
        methods=list(own),
        colours={label: style.colour for label, style in (chips | own).items()},
        warnings=warnings,
        runs=sum(len(method.runs) for method in comparison.methods),
        scripts=[Markup(text) for text in (plotly.offline.get_plotlyjs(), *_scripts())],
        styles=[Markup(_vendored(_SLIDER, "styles.css"))]
        + [Markup(_vendored(_SORTER, "sortable-base.css"))],
        licences={name: _vendored(name, "LICENSE") for name in (_SLIDER, _SORTER)},
    )
    path = output / "report.html"
    write_text(path, text)
    _keep_only({plot.stem for plot in made}, output / "plots")
    return path


def _keep_only(stems: set[str], folder: Path) -> None:
    """Takes other plots out of `folder`, which an earlier comparison wrote."""
    listed = folder / _LIST
    before = set(listed.read_text().splitlines()) if listed.is_file() else set()
    for path in folder.glob("*"):
        if path.stem in before - stems and path.suffix in (".png", ".svg", ".webp"):
            with contextlib.suppress(OSError):
                path.unlink()
    write_text(listed, "\n".join(sorted(stems)))


def _scene(
    comparison: Comparison,
    name: str,
    anchor: str,
    methods: list[Method],
    output: Path,
) -> dict[str, Any]:
    """The tables, sliders and records of a scene."""
    groups, exposure = slides.groups(methods)
    return dict(
        name=name,
        anchor=anchor,
        baseline=comparison.baseline[name],
        headlines=facts.headlines(comparison, name, methods),
        accuracy=facts.accuracy(comparison, name, methods),
        price=facts.price(comparison, name, methods),
        methods=facts.methods(comparison, name),
        exposure=exposure,
        groups=groups,
        effects=facts.effects(methods),
        records=[_record(m, run, output) for m in methods for run in m.runs],
    )


def _plots(anchor: str, drawn: list[Chart]) -> list[dict[str, str]]:
    """Zoomable plots: of each its heading, the piece of HTML, and a sentence on how to read it."""
    return [
        dict(
            title=chart.title,
            html=Markup(interactive.embedded(chart, f"{anchor}plot{index}")),
            note=chart.note,
        )
        for index, chart in enumerate(drawn)
    ]


def _record(method: Method, run: Run, output: Path) -> dict[str, str]:
    """What one run was made with."""
    seed = run.config.get("seed")
    return dict(
        name=f"{method.label}, seed {'not recorded' if seed is None else seed}",
        folder=os.path.relpath(run.folder, output),
        status=str((run.summary or {}).get("status") or unended(run.manifest)),
        config=yaml.safe_dump(run.config, sort_keys=False, allow_unicode=True),
        manifest=json.dumps(run.manifest, indent=2, ensure_ascii=False),
    )


def _scripts() -> list[str]:
    return [_vendored(_SLIDER, "index.js"), _vendored(_SORTER, "sortable.auto.min.js")]


def _vendored(library: str, name: str) -> str:
    return (files("isas_cli.report.compare") / "vendor" / library / name).read_text(
        encoding="utf-8"
    )
