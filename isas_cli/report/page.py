"""report.html: one file that says what a run was, what it found, and what that cost.

The page stands alone: pictures are inside it, it loads nothing and runs no script.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, Template

from ..records import KEY_PREFIX, VALUE_PREFIX, Run, write_text
from ..records.follow import unended
from .figures import Picture

_MEASURES = ("loss", "image_rmse", "parameter_rmse")


def write_page(run: Run, pictures: list[Picture], plots: list[Picture]) -> Path:
    """Writes report.html into the run's folder and returns its path; IsasError if the disk refuses.

    pictures, plots: PNG or WebP files that lie on the disk, shown in this order.
    """
    # That of a process that died says why, and nothing of its steps.
    summary = _from_history(run) | (run.summary or {})
    config = run.folder / "config.yaml"
    text = template("isas_cli.report", number=number, embedded=_embedded).render(
        summary=summary,
        results=_results(summary),
        effects=run.manifest.get("effects") or {},
        targets=run.manifest.get("targets") or {},
        parameter_rmse_is=run.parameter_rmse_is,
        truth_known=_value(summary, "start", "parameter_rmse") is not None,
        phases=_phases(summary),
        rate=_rate(summary),
        pictures=pictures,
        plots=plots,
        config=config.read_text(encoding="utf-8") if config.is_file() else "",
        manifest=json.dumps(run.manifest, indent=2),
    )
    path = run.folder / "report.html"
    write_text(path, text)
    return path


def template(package: str, **filters: Callable) -> Template:
    """report.html among a package's templates: text is escaped, a missing value is an error."""
    environment = Environment(
        loader=PackageLoader(package),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(filters)
    return environment.get_template("report.html")


def number(value: float | None) -> str:
    """A number as the page shows it: integers whole, others to four digits, – where not known."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "–"
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:,.0f}" if 1e3 <= abs(value) < 1e9 else f"{value:.4g}"


def _from_history(run: Run) -> dict[str, Any]:
    """What the rows written so far tell of a run that has no summary."""
    rows = run.history.astype(object).where(run.history.notna(), None).to_dict("records")
    last = rows[-1] if rows else {}
    return {
        "status": unended(run.manifest),
        "scene": _named(run.config.get("scene")),
        "sampler": _named(run.config.get("sampler")),
        "loss": _named(run.config.get("loss")),
        "seed": run.config.get("seed"),
        "iterations": last.get("iteration"),
        "paths": last.get("paths"),
        "seconds_billed": last.get("seconds"),
        "seconds_by_phase": {},
        "seconds_unbilled": {},
        "start": rows[0] if rows else {},
        "final": last,
        "warnings": [],
    }


def _named(choice: Any) -> str:
    """The name of a configuration group: its `name` entry, or the group itself if it is a word."""
    name = choice.get("name") if isinstance(choice, dict) else choice
    return str(name) if name else "not recorded"


def _results(summary: dict[str, Any]) -> list[tuple[str, Any, Any, Any]]:
    """Rows (measure, start, final, final / start) of what is known at the start or at the end."""
    ends: Iterable[str] = {**(summary["start"] or {}), **(summary["final"] or {})}
    rows = []
    prefixes = KEY_PREFIX, VALUE_PREFIX
    for name in (*_MEASURES, *(name for name in ends if name.startswith(prefixes))):
        start, final = _value(summary, "start", name), _value(summary, "final", name)
        if start is not None or final is not None:
            ratio = final / start if start and final is not None else None
            rows.append((name, start, final, ratio))
    return rows


def _phases(summary: dict[str, Any]) -> list[tuple[str, dict[str, float]]]:
    """The two halves of the time table: what counts against the budget and what does not."""
    return [
        ("seconds billed", summary.get("seconds_by_phase") or {}),
        ("seconds not billed", summary.get("seconds_unbilled") or {}),
    ]


def _rate(summary: dict[str, Any]) -> float | None:
    """Light paths per billed second."""
    paths, seconds = summary["paths"], summary["seconds_billed"]
    return float(paths / seconds) if paths and seconds else None


def _value(summary: dict[str, Any], end: str, name: str) -> float | None:
    """A measure at `start` or `final`, None where it is not known."""
    return (summary[end] or {}).get(name)


def _embedded(picture: Picture) -> str:
    """The picture's file as a data: address, so that the page needs no other file."""
    kind = picture.path.suffix.removeprefix(".")
    return f"data:image/{kind};base64," + base64.b64encode(picture.path.read_bytes()).decode()
