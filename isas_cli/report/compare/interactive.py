"""The curves of the page, to be zoomed and with methods that a click on the legend hides.

Made with Plotly; its script is part of the Python package and goes into the page once. Bands and
medians of a method share a legend group, so they come and go together, in all panels of a plot.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import pandas
import plotly.graph_objects as go
import plotly.io
from matplotlib.ticker import EngFormatter
from plotly.subplots import make_subplots

from ..figures import COST_LABELS, GREY
from . import content
from .gather import Comparison, Method
from .looks import Look

_GRID = "#e4e4e4"
# Named one by one: the default set has a button that sends the plot to a server.
_BUTTONS = ["toImage", "zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d"]
_CONFIG = {"displaylogo": False, "responsive": True, "modeBarButtons": [_BUTTONS]}
_Line = tuple[list[float], list[float]]  # x and y of a trace


def embedded(figure: go.Figure, name: str) -> str:
    """The figure as a piece of HTML that needs Plotly's script earlier in the page.

    name: the id of the element, unique in the page; the same figure gives the same text.
    """
    return plotly.io.to_html(
        figure,
        config=_CONFIG,
        include_plotlyjs=False,
        full_html=False,
        default_height=f"{figure.layout.height}px",
        div_id=name,
    )


def errors(
    comparison: Comparison, scene: str, methods: list[Method], look: dict[str, Look]
) -> go.Figure | None:
    """Error against cost, a panel for each measure; buttons turn seconds into paths and back."""
    shown = content.measures(comparison, scene)
    if not shown:
        return None
    figure = panels([content.label(name, methods) for name in shown], 330)
    data: dict[str, list[_Line]] = {cost: [] for cost in COST_LABELS}
    for row, measure in enumerate(shown, start=1):
        for method in methods:
            lines = {c: _lines(comparison, scene, method.label, measure, c) for c in data}
            pieces = max(len(own) for own in lines.values()) // 3
            for cost, own in lines.items():  # a button gives every trace its line of either cost
                data[cost] += own + [([], [])] * (3 * pieces - len(own))
            for piece in range(pieces):
                at = len(data["seconds"]) - 3 * (pieces - piece)
                own = look[method.label]
                _add_piece(figure, row, method.label, own, data["seconds"][at : at + 3], piece)
        for cost, lines in data.items():
            lines.append(_guide(comparison, scene, methods, measure, cost))
        x, y = data["seconds"][-1]
        figure.add_scatter(
            x=x,
            y=y,
            name="slope −1/2",
            mode="lines",
            legendgroup="guide",
            showlegend=row == 1,
            line={"color": GREY, "dash": "dot", "width": 1.5},
            hoverinfo="skip",
            row=row,
            col=1,
        )
        _add_levels(figure, row, content.start(methods, measure), comparison, scene, measure)
        log_axis(figure.update_yaxes, [v for _, y in data["seconds"] for v in y], row=row)
    log_axis(figure.update_xaxes, [v for x, _ in data["seconds"] for v in x])
    figure.update_xaxes(title_text=COST_LABELS["seconds"], row=len(shown))
    figure.update_layout(updatemenus=[_cost_buttons(data, len(shown))])
    return figure


def _lines(comparison: Comparison, scene: str, label: str, measure: str, cost: str) -> list[_Line]:
    """Low, high and median of each piece of a method's curve, one after the other."""
    return [
        (_rounded(piece["x"]), _rounded(piece[name]))
        for piece in content.curve(comparison, scene, label, measure, cost)
        for name in ("low", "high", "median")
    ]


def _add_piece(
    figure: go.Figure, row: int, label: str, own: Look, lines: list[_Line], piece: int
) -> None:
    """The band and the median of one piece of a curve; thin from the second piece on, to which
    not all runs went."""
    (x, low), (_, high), (_, median) = lines
    shared = {"mode": "lines", "legendgroup": label, "name": label, "row": row, "col": 1}
    for y, fill in ((low, None), (high, "tonexty")):
        figure.add_scatter(
            x=x,
            y=y,
            line={"width": 0, "color": own.colour},
            fill=fill,
            fillcolor=_faint(own.colour),
            showlegend=False,
            hoverinfo="skip",
            **shared,
        )
    figure.add_scatter(
        x=x,
        y=median,
        line={"color": own.colour, "dash": own.dash, "width": 1 if piece else 2.2},
        showlegend=row == 1 and piece == 0,
        hovertemplate="%{y:.4g} at %{x:.4s}",
        **shared,
    )


def _guide(
    comparison: Comparison, scene: str, methods: list[Method], measure: str, cost: str
) -> _Line:
    """The line of slope −1/2 through the middle of a panel's curves."""
    pieces = [
        piece for m in methods for piece in content.curve(comparison, scene, m.label, measure, cost)
    ]
    if not pieces:
        return [], []
    x, y = ([v for piece in pieces for v in piece[name]] for name in ("x", "median"))
    return content.guide(min(x), max(x), min(y), max(y))


def _add_levels(
    figure: go.Figure, row: int, start: float, comparison: Comparison, scene: str, measure: str
) -> None:
    """Level lines: the start's error and the shares of it that the tables speak of."""
    for level in [1.0, *content.levels(comparison, scene, measure)]:
        figure.add_hline(y=level * start, row=row, col=1, line={"color": "#b0b0b0", "width": 0.8})
        figure.add_annotation(
            text="start" if level == 1 else content.level_name(level),
            xref="x domain",
            x=1,
            y=math.log10(level * start),  # annotations, and only they, want a log axis' exponent
            xanchor="right",
            yanchor="bottom",
            yshift=-2,
            showarrow=False,
            font={"size": 10, "color": GREY},
            row=row,
            col=1,
        )


def _cost_buttons(data: dict[str, list[_Line]], rows: int) -> dict:
    """Plotly's own buttons: which cost the x axis shows."""
    last = "xaxis" if rows == 1 else f"xaxis{rows}"
    buttons = []
    for cost, lines in data.items():
        ticks = log_ticks([v for x, _ in lines for v in x])
        layout = {f"{last}.title.text": COST_LABELS[cost]}
        for axis in ["xaxis", *(f"xaxis{row}" for row in range(2, rows + 1))]:
            layout |= {f"{axis}.{name}": value for name, value in ticks.items()}
            layout |= {f"{axis}.autorange": True}
        traces = {"x": [x for x, _ in lines], "y": [y for _, y in lines]}
        buttons.append({"label": COST_LABELS[cost], "method": "update", "args": [traces, layout]})
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


def log_axis(update: Callable[..., object], values: list[float], **where: int) -> None:
    """Makes the axes that `update` changes logarithmic, labelled for `values`."""
    update(type="log", **log_ticks(values), **where)


def log_ticks(values: list[float]) -> dict[str, list]:
    """Labels at 1, 2 and 5 (over three decades and more at powers of ten, eight at most) and beyond
    both ends of `values`, as a zoomed-out axis shows these too. Plotly's own would be single digits
    without a power."""
    known = [value for value in values if 0 < value < math.inf] or [1.0]
    low, high = math.floor(math.log10(min(known))), math.ceil(math.log10(max(known)))
    steps = (1, 2, 5) if max(known) < 1e3 * min(known) else (1,)
    every = 1 + (high - low) // 9
    places = [step * 10.0**power for power in range(low - 1, high + 2, every) for step in steps]
    return {"tickvals": places, "ticktext": [_short(place) for place in places]}


def _short(value: float) -> str:
    """A tick's label: 0.002, 50, 200k, 5M, or a power of ten."""
    if 1e3 <= value < 1e12:
        return EngFormatter(sep="")(value)
    return f"{value:g}"


def panels(
    titles: list[str], height: float, shared: bool = True, heights: list[float] | None = None
) -> go.Figure:
    """Empty panels one below the other with one legend below them.

    height: of each in pixels; heights: one for each instead; shared: all have the same x axis.
    """
    heights = heights or [height] * len(titles)
    above, below, legend = 70, 62, 24
    between = 44 if shared else 70
    inside = sum(heights) + between * (len(titles) - 1)
    figure = make_subplots(
        rows=len(titles),
        cols=1,
        shared_xaxes=shared,
        subplot_titles=titles,
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
        legend={
            "orientation": "h",
            "traceorder": "normal",
            "x": 0,
            "y": -below / inside,
            "yanchor": "top",
        },
    )
    figure.update_xaxes(gridcolor=_GRID, linecolor="#999999", zeroline=False)
    figure.update_yaxes(gridcolor=_GRID, linecolor="#999999", zeroline=False)
    return figure


def _rounded(values: pandas.Series) -> list[float]:
    """Five digits, more than a screen can show, at half the size of all of them."""
    return [float(f"{value:.5g}") for value in values]


def _faint(colour: str) -> str:
    """The colour of a band: the method's own, mostly transparent."""
    red, green, blue = (int(colour[at : at + 2], 16) for at in (1, 3, 5))
    return f"rgba({red},{green},{blue},0.18)"
