"""The bars and single-run curves of the page; see `interactive` for how they behave."""

from __future__ import annotations

import math

import pandas
import plotly.graph_objects as go

from ..figures import COST_LABELS, GREY
from . import content
from .gather import Comparison, Method
from .interactive import log_axis, panels
from .looks import Look
from .price import MONTE_CARLO

_ENDS = ("", "_low", "_high")


def speedups(
    comparison: Comparison, scene: str, methods: list[Method], look: dict[str, Look]
) -> go.Figure | None:
    """How many times sooner than the baseline each method reaches each level, as bars from 1."""
    base = comparison.baseline[scene]
    others = [method for method in methods if method.label != base]
    shown = [m for m in content.measures(comparison, scene) if content.levels(comparison, scene, m)]
    if not others or not shown:
        return None
    figure = panels([content.SHORT[name] for name in shown], 230, shared=False)
    width = 0.8 / len(others)
    for row, measure in enumerate(shown, start=1):
        every = {m.label: content.bars(comparison, scene, measure, m.label) for m in others}
        low, high = content.bar_limits([bar for bars in every.values() for bar in bars])
        for place, (label, bars) in enumerate(every.items()):
            ends = [(max(bar.low, low / 2), min(bar.high, high * 2)) for bar in bars]
            _add_bars(figure, row, -0.4 + width * place, width, look[label], label, bars, ends)
        levels = content.levels(comparison, scene, measure)
        _level_axis(figure, row, [content.level_name(level) for level in levels])
        log_axis(figure.update_yaxes, [low, high], row=row)
        figure.update_yaxes(range=[math.log10(low), math.log10(high)], row=row)
        figure.add_hline(y=1, row=row, col=1, line={"color": "black", "width": 1})
    figure.update_xaxes(title_text="share of the start's error", row=len(shown))
    figure.update_yaxes(title_text="speed-up")
    return figure


def _level_axis(figure: go.Figure, row: int, names: list[str]) -> None:
    """An x axis with a place for each level, bars no wider than if there were three of them."""
    figure.update_xaxes(
        tickvals=list(range(len(names))),
        ticktext=names,
        range=[-0.6, max(len(names), 3) - 0.4],
        showgrid=False,
        row=row,
    )


def _add_bars(
    figure: go.Figure,
    row: int,
    offset: float,
    width: float,
    own: Look,
    label: str,
    bars: list[content.Bar],
    ends: list[tuple[float, float]],
) -> None:
    """One method's bars in one panel; words stand where there is no bar."""
    figure.add_bar(
        x=list(range(len(bars))),
        # Above 0: the words of a bar without any height would hang into the axis' labels.
        y=[1e-6 if math.isnan(bar.ratio) else bar.ratio - 1 for bar in bars],
        base=1,
        width=width * 0.92,
        offset=offset,
        marker={"color": own.colour, "pattern": {"shape": own.pattern}},
        text=[bar.words for bar in bars],
        textposition="outside",
        textangle=-90,
        constraintext="none",
        textfont={"color": own.colour},
        error_y=_error_bars([bar.ratio for bar in bars], ends),
        hovertext=[_in_words(bar) for bar in bars],
        hoverinfo="text+name",
        name=label,
        legendgroup=label,
        showlegend=row == 1,
        row=row,
        col=1,
    )


def _error_bars(values: list[float], ends: list[tuple[float, float]]) -> dict:
    """Plotly's error bars from `values` to `ends`, none where one of these is not known."""

    def length(upper: float, lower: float) -> float | None:
        return upper - lower if math.isfinite(upper) and math.isfinite(lower) else None

    return {
        "type": "data",
        "symmetric": False,
        "array": [length(high, value) for value, (_, high) in zip(values, ends)],
        "arrayminus": [length(value, low) for value, (low, _) in zip(values, ends)],
        "thickness": 1.3,
        "width": 0,
    }


def prices(
    comparison: Comparison, scene: str, methods: list[Method], look: dict[str, Look]
) -> go.Figure | None:
    """Billed seconds of each halving, a panel for each measure; late slopes in the last panels."""
    shown = content.measures(comparison, scene)
    if not shown:
        return None
    titles = [f"seconds of the halving of the {content.SHORT[name]} to …" for name in shown]
    titles += [f"late slope of the {content.SHORT[name]}, dotted: −1/2" for name in shown]
    slope_height = 50 + 26 * len(methods)
    heights = [230.0] * len(shown) + [float(slope_height)] * len(shown)
    figure = panels(titles, 0, shared=False, heights=heights)
    for method in methods:  # entries of the legend: a dot also for those that begin with a cross
        marker = {"color": look[method.label].colour, "size": 8}
        figure.add_scatter(
            x=[None],
            y=[None],
            mode="markers",
            marker=marker,
            name=method.label,
            legendgroup=method.label,
            row=1,
            col=1,
        )
    slopes = [MONTE_CARLO]
    for row, measure in enumerate(shown, start=1):
        every = {m.label: content.price(comparison, scene, measure, m.label) for m in methods}
        every = {label: rows for label, rows in every.items() if len(rows)}
        _add_halvings(figure, row, every, look)
        levels = content.levels(comparison, scene, measure)
        _level_axis(figure, row, [content.level_name(level) for level in levels])
        for label, rows in every.items():
            _add_slope(figure, row + len(shown), label, rows.iloc[0], look[label])
            slopes += rows[[f"slope_seconds{end}" for end in _ENDS]].to_numpy().ravel().tolist()
        figure.add_vline(
            x=MONTE_CARLO, row=row + len(shown), col=1, line={"color": GREY, "dash": "dot"}
        )
        figure.update_yaxes(
            range=[len(every) - 0.5, -0.5], showgrid=False, automargin=True, row=row + len(shown)
        )
    figure.update_xaxes(title_text="d log error / d log seconds", row=2 * len(shown))
    slopes = [slope for slope in slopes if math.isfinite(slope)]
    margin = 0.05 * (max(slopes) - min(slopes)) + 0.02
    for row in range(len(shown) + 1, 2 * len(shown) + 1):
        figure.update_xaxes(range=[min(slopes) - margin, max(slopes) + margin], row=row)
    return figure


def _add_halvings(
    figure: go.Figure, row: int, every: dict[str, pandas.DataFrame], look: dict[str, Look]
) -> None:
    """Marginal seconds of each halving, side by side; a cross at the top where not reached."""
    names = ["seconds", "seconds_low", "seconds_high"]
    known = pandas.concat(every.values())[names].to_numpy().ravel()
    known = known[(known > 0) & (known < math.inf)]
    low, high = (known.min() / 1.3, known.max() * 1.6) if len(known) else (0.1, 10.0)
    for place, (label, rows) in enumerate(every.items()):
        x = [level + 0.5 * (place + 0.5) / len(every) - 0.25 for level in range(len(rows))]
        ends = [(max(a, low / 2), min(b, high * 2)) for a, b in rows[names[1:]].to_numpy()]
        reached = [math.isfinite(y) for y in rows["seconds"]]
        figure.add_scatter(
            x=x,
            y=[y if has else high / 1.2 for y, has in zip(rows["seconds"], reached)],
            mode="markers",
            marker={
                "color": look[label].colour,
                "size": 8,
                "symbol": ["circle" if has else "x-thin-open" for has in reached],
            },
            error_y=_error_bars(rows["seconds"].tolist(), ends),
            hovertext=[
                f"{y:.4g} s" if has else "not reached" for y, has in zip(rows["seconds"], reached)
            ],
            hoverinfo="text+name",
            name=label,
            legendgroup=label,
            showlegend=False,
            row=row,
            col=1,
        )
    log_axis(figure.update_yaxes, [low, high], row=row)
    span = [math.log10(low), math.log10(high)]
    figure.update_yaxes(range=span, title_text="billed seconds", row=row)
    if not len(known):
        figure.update_yaxes(showticklabels=False, showgrid=False, row=row)


def _add_slope(figure: go.Figure, row: int, label: str, first: pandas.Series, own: Look) -> None:
    """The late slope of one method with its interval."""
    slope, low, high = (first[f"slope_seconds{end}"] for end in _ENDS)
    figure.add_scatter(
        x=[slope],
        y=[label],
        mode="markers",
        marker={"color": own.colour, "size": 8},
        error_x=_error_bars([slope], [(low, high)]),
        hovertemplate="%{x:.3f}",
        name=label,
        legendgroup=label,
        showlegend=False,
        row=row,
        col=1,
    )


def times(methods: list[Method]) -> go.Figure | None:
    """Stacked bars of seconds by phase: billed ones above, the others below."""
    halves = {t: table for t, table in content.phases(methods).items() if len(table.columns)}
    if not halves:
        return None
    titles = [f"{title} seconds, median over runs" for title in halves]
    figure = panels(titles, 60 + 30 * len(methods), shared=False)
    figure.update_layout(barmode="stack")
    for row, (title, table) in enumerate(halves.items(), start=1):
        shades = content.shades(title, len(table.columns))
        for phase, shade in zip(table.columns, shades):
            figure.add_bar(
                x=table[phase],
                y=list(table.index),
                orientation="h",
                name=f"{phase} ({title})",
                marker={"color": shade},
                hovertemplate="%{x:.4g} s",
                row=row,
                col=1,
            )
    figure.update_yaxes(autorange="reversed", showgrid=False, automargin=True)
    return figure


def training(methods: list[Method], look: dict[str, Look]) -> go.Figure | None:
    """Gradient norm, gradient noise and non-finite counts against billed seconds, run by run."""
    known = {
        name: {m.label: list(content.histories(m, name)) for m in methods}
        for name in content.TRAINING
    }
    shown = [name for name, runs in known.items() if any(runs.values())]
    if not shown:
        return None
    figure = panels([content.TRAINING[name] for name in shown], 210)
    named = set()
    for row, name in enumerate(shown, start=1):
        for label, runs in known[name].items():
            own = look[label]
            for seconds, values in runs:
                figure.add_scatter(
                    x=seconds.tolist(),
                    y=values.tolist(),
                    mode="lines",
                    line={
                        "color": own.colour,
                        "dash": own.dash,
                        "width": 1.2,
                        "shape": "hv" if name == "nonfinite" else "linear",
                    },
                    name=label,
                    legendgroup=label,
                    showlegend=label not in named,
                    hovertemplate="%{y:.4g} at %{x:.4g} s",
                    row=row,
                    col=1,
                )
                named.add(label)
        if name != "nonfinite":
            every = [v for runs in known[name].values() for _, values in runs for v in values]
            log_axis(figure.update_yaxes, every, row=row)
        else:
            some = any(values.any() for runs in known[name].values() for _, values in runs)
            ticks = {"rangemode": "tozero"} if some else {"range": [0, 1], "tickvals": [0, 1]}
            figure.update_yaxes(row=row, **ticks)
    costs = [s for runs in known.values() for own in runs.values() for x, _ in own for s in x]
    log_axis(figure.update_xaxes, costs)
    figure.update_xaxes(title_text=COST_LABELS["seconds"], row=len(shown))
    return figure


def _in_words(bar: content.Bar) -> str:
    """A bar in words."""
    if math.isnan(bar.ratio):
        return bar.words
    spread = "" if math.isnan(bar.low) else f" [{bar.low:.3g}, {bar.high:.3g}]"
    return f"{bar.ratio:.3g}×{spread}"
