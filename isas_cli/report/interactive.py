"""Charts for a page, to be zoomed and with entries that a click on the legend hides.

Made with Plotly; its script is part of the Python package and goes into the page once. All traces
of an entry share a legend group, so they come and go together, in all panels of a chart.
"""

from __future__ import annotations

import math

import numpy as np
import plotly.graph_objects as go
import plotly.io
from plotly.subplots import make_subplots

from .chart import GREY, Axis, Bars, Chart, Panel, Points, Rule, Style

_GRID = "#e4e4e4"
_INCH, _TEXTS = 100, 40  # pixels: of an inch, and what a picture needs of it for texts
_DASHES = ("solid", "dash", "dot", "dashdot")
_PATTERNS = ("", "/", ".", "x")
_SYMBOLS = {"": "circle", "o": "circle", "x": "x-thin-open"}
# Named one by one: the default set has a button that sends the plot to a server.
_BUTTONS = ["toImage", "zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d"]
_CONFIG = {"displaylogo": False, "responsive": True, "modeBarButtons": [_BUTTONS]}


def embedded(chart: Chart, name: str) -> str:
    """The chart as a piece of HTML that needs Plotly's script earlier in the page.

    name: the id of the element, unique in the page; the same chart gives the same text.
    """
    figure = draw(chart)
    return plotly.io.to_html(
        figure,
        config=_CONFIG,
        include_plotlyjs=False,
        full_html=False,
        default_height=f"{figure.layout.height}px",
        div_id=name,
    )


def draw(chart: Chart) -> go.Figure:
    """The panels one below the other, column by column; of alternatives the first column, and
    buttons that put another in its place."""
    columns = list(zip(*chart.grid))
    panels = columns[0] if chart.alternatives else [p for column in columns for p in column]
    figure = _empty(panels)
    named: set[str] = set()
    for row, panel in enumerate(panels, start=1):
        for trace in _traces(panel, chart.styles):
            name = trace["name"]
            first = trace.pop("shown") and name not in named
            named |= {name} if first else set()
            figure.add_trace(trace | {"legendgroup": name, "showlegend": first}, row=row, col=1)
        for mark in panel.placed:
            if isinstance(mark, Rule):
                _add_rule(figure, row, mark, panel.y)
    if chart.alternatives:
        figure.update_layout(updatemenus=[_buttons(chart, columns)])
    return figure


def _empty(panels: list[Panel]) -> go.Figure:
    """Empty panels with one legend below them; axes that are equal to one above move with it."""
    heights = [_INCH * panel.height - _TEXTS for panel in panels]
    above, between, below, legend = 70, 70, 62, 24
    inside = sum(heights) + between * (len(panels) - 1)
    figure = make_subplots(
        rows=len(panels),
        cols=1,
        subplot_titles=[panel.title for panel in panels],
        vertical_spacing=between / inside,
        row_heights=heights,
    )
    figure.update_annotations(x=0, xanchor="left", font_size=13)
    figure.update_layout(
        template=go.layout.Template(),
        height=above + inside + below + legend,
        margin={"l": 60, "r": 20, "t": above, "b": below + legend},
        font={"family": "system-ui, sans-serif", "size": 12, "color": "#222222"},
        paper_bgcolor="white",
        plot_bgcolor="white",
        hovermode="closest",
        barmode="overlay",
        legend={
            "orientation": "h",
            "traceorder": "normal",
            "x": 0,
            "y": -below / inside,
            "yanchor": "top",
        },
    )
    lines = {"linecolor": "#999999", "zeroline": False, "automargin": True}
    for row, panel in enumerate(panels, start=1):
        alike = [other.x for other in panels].index(panel.x) + 1
        follows = {} if alike == row else {"matches": "x" if alike == 1 else f"x{alike}"}
        last = panel.x not in [other.x for other in panels[row:]]
        figure.update_xaxes(row=row, col=1, **lines, **_axis(panel.x, last), **follows)
        figure.update_yaxes(row=row, col=1, **lines, **_axis(panel.y))
    return figure


def _axis(axis: Axis, titled: bool = True) -> dict:
    """Plotly's words for an axis, of which it takes the limits of logarithmic ones as exponents."""
    made = {"showgrid": axis.grid, "gridcolor": _GRID, "type": "log" if axis.log else "linear"}
    made["title"] = {"text": axis.label if titled else ""}
    if axis.limits is not None:
        made["range"] = [math.log10(end) if axis.log else end for end in axis.limits]
    if axis.ticks is not None:
        made |= {"tickvals": list(axis.ticks), "ticktext": list(axis.ticks.values())}
    return made


def _traces(panel: Panel, styles: dict[str, Style]) -> list[dict]:
    """Plotly's traces of a panel's marks, always as many for as many marks; ``shown``: whether a
    legend may show it."""
    made = []
    for mark in panel.marks:
        if isinstance(mark, Points):
            made += _points(mark, styles[mark.entry])
        elif isinstance(mark, Bars):
            made.append(_bars(mark, styles[mark.entry]))
    return made


def _points(mark: Points, style: Style) -> list[dict]:
    shared = {"type": "scatter", "name": mark.entry}
    line = {"color": style.colour, "dash": _DASHES[style.kind], "width": mark.line * 1.2}
    modes = [name for name, on in (("lines", mark.line), ("markers", mark.symbol)) if on]
    trace = {
        **shared,
        "x": _rounded(mark.x),
        "y": _rounded(mark.y),
        "mode": "+".join(modes),
        "line": line | {"shape": "hv" if mark.steps else "linear"},
        "marker": {"color": style.colour, "size": 8, "symbol": _SYMBOLS[mark.symbol]},
        "hovertemplate": "%{y:.4g} at %{x:.4s}",
        "shown": mark.symbol != "x",
    }
    if mark.words is not None:
        trace |= {"hovertext": list(mark.words), "hovertemplate": "%{hovertext}"}
    if mark.band:
        x, y = _outline(mark)
        band = {"x": x, "y": y, "mode": "lines", "line": {"width": 0}, "fill": "toself"}
        band |= {"fillcolor": _faint(style.colour), "hoverinfo": "skip", "shown": False}
        return [shared | band, trace]
    if mark.low is not None:
        values = mark.x if mark.sideways else mark.y
        trace["error_x" if mark.sideways else "error_y"] = _error_bars(values, mark.low, mark.high)
    return [trace]


def _bars(mark: Bars, style: Style) -> dict:
    # Above 0: the words of a bar without any height would hang into the axis' labels.
    length = np.where(np.isfinite(mark.length), mark.length, 1e-6)
    trace = {
        "type": "bar",
        "name": mark.entry,
        "base": _rounded(mark.base),
        "width": mark.width,
        "marker": {"color": style.colour, "pattern": {"shape": _PATTERNS[style.kind]}},
        "text": list(mark.instead),
        "textposition": "outside" if mark.instead else "none",
        "textangle": -90,
        "constraintext": "none",
        "textfont": {"color": style.colour},
        "hovertext": list(mark.words),
        "hoverinfo": "text+name",
        "shown": True,
    }
    if mark.sideways:
        return trace | {"orientation": "h", "x": _rounded(length), "y": _rounded(mark.at)}
    if mark.low is not None:
        trace["error_y"] = _error_bars(mark.base + mark.length, mark.low, mark.high)
    return trace | {"x": _rounded(mark.at), "y": _rounded(length)}


def _error_bars(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> dict:
    """From ``values`` to the ends, none where one of these is not known."""
    return {
        "type": "data",
        "symmetric": False,
        "array": _rounded(high - values),
        "arrayminus": _rounded(values - low),
        "thickness": 1.3,
        "width": 0,
    }


def _outline(mark: Points) -> tuple[list, list]:
    """A band as closed lines with gaps between them."""
    x, y = [None], [None]
    known = np.isfinite(mark.low) & np.isfinite(mark.high)
    for piece in np.split(np.arange(len(known)), np.flatnonzero(~known)):
        own = piece[known[piece]]
        if own.size:
            x += [*_rounded(mark.x[own]), *_rounded(mark.x[own[::-1]]), None]
            y += [*_rounded(mark.low[own]), *_rounded(mark.high[own[::-1]]), None]
    return x, y


def _add_rule(figure: go.Figure, row: int, mark: Rule, axis: Axis) -> None:
    line = {"color": mark.colour, "width": 1, "dash": "dot" if mark.dotted else "solid"}
    if mark.upright:
        figure.add_vline(x=mark.at, row=row, col=1, line=line)
        return
    figure.add_hline(y=mark.at, row=row, col=1, line=line)
    if mark.text:
        figure.add_annotation(
            text=mark.text,
            xref="x domain",
            x=1,
            # Annotations, unlike shapes, want a logarithmic axis' exponent.
            y=math.log10(mark.at) if axis.log else mark.at,
            xanchor="right",
            yanchor="bottom",
            yshift=-2,
            showarrow=False,
            font={"size": 10, "color": GREY},
            row=row,
            col=1,
        )


def _buttons(chart: Chart, columns: list[tuple[Panel, ...]]) -> dict:
    """Plotly's own buttons, one for each column."""
    buttons = []
    for panels in columns:
        traces = [trace for panel in panels for trace in _traces(panel, chart.styles)]
        layout = {}
        for row, panel in enumerate(panels, start=1):
            last = panel.x not in [other.x for other in panels[row:]]
            name = "xaxis" if row == 1 else f"xaxis{row}"
            layout |= {f"{name}.{key}": value for key, value in _axis(panel.x, last).items()}
        lines = {"x": [trace["x"] for trace in traces], "y": [trace["y"] for trace in traces]}
        buttons.append({"label": panels[0].x.label, "method": "update", "args": [lines, layout]})
    return {
        "type": "buttons",
        "direction": "right",
        "buttons": buttons,
        "x": 0,
        "xanchor": "left",
        "y": 1,
        "yanchor": "bottom",
        "pad": {"b": 24},
        "font": {"size": 11},
    }


def _rounded(values: np.ndarray) -> list[float | None]:
    """Five digits, more than a screen can show, at half the size of all of them; None for a gap,
    and for no values at all: a click on the legend passes over a trace without any."""
    return [float(f"{v:.5g}") if math.isfinite(v) else None for v in values] or [None]


def _faint(colour: str) -> str:
    """The colour of a band: the entry's own, mostly transparent."""
    red, green, blue = (int(colour[at : at + 2], 16) for at in (1, 3, 5))
    return f"rgba({red},{green},{blue},0.18)"
