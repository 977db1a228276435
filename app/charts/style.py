"""How every Plotly figure of the screens looks; its colours come from the palette."""

import math
from typing import Any

import numpy as np
import plotly.graph_objects as go

from softcal.app.charts.palette import FONTS, Palette
from softcal.app.texts.reasons import Translator
from softcal.app.views.common import thinning_slice
from softcal.core.recording import Array

HEIGHT = 320
TICK_STEPS = 6
CLEAR = "rgba(0,0,0,0)"
LEVEL_BARS = {"orientation": "h", "textposition": "outside", "cliponaxis": False}
"""Level bars whose values stand behind them."""


def apply_style(figure: go.Figure, colours: Palette, x_title: str, y_title: str, height: int = HEIGHT) -> go.Figure:
    """Give a figure the look of the screens and its axes their titles, each with its unit."""
    # Thousands, not "k" and "M": these are measured values, not sums of money.
    shared = {"title_standoff": 8, "automargin": True, "exponentformat": "power"}
    figure.update_xaxes(title=x_title, **shared).update_yaxes(title=y_title, **shared)
    return apply_theme(figure, colours, height)


def apply_theme(figure: go.Figure, colours: Palette, height: int = HEIGHT) -> go.Figure:
    """Give a figure that has its titles the ground, text and grid of the theme."""
    axis = {"gridcolor": colours.grid, "zerolinecolor": colours.grid, "linecolor": colours.grid}
    figure.update_xaxes(**axis).update_yaxes(**axis)
    figure.update_annotations(font_color=colours.text)
    return figure.update_layout(
        template="none",
        height=height,
        margin={"l": 72, "r": 16, "t": 48, "b": 52},
        paper_bgcolor=CLEAR,
        plot_bgcolor=CLEAR,
        font={"family": FONTS, "color": colours.text, "size": 13},
        hoverlabel={"bgcolor": colours.grid, "font_color": colours.text},
        # Above the figure, not so far above the bars: where its names wrap they would come to lie over these.
        legend={"orientation": "h", "yref": "container", "y": 1.0, "yanchor": "top", "x": 0},
    )


def dots(
    figure: go.Figure,
    x: Any,
    y: Any,
    colour: str,
    name: str | None,
    size: int = 4,
    row: int | None = None,
    col: int = 1,
    **more: Any,
) -> None:
    """Draw points, in one of several figures where a row is given."""
    marker = {"color": colour, "size": size, "symbol": more.pop("symbol", None), "opacity": more.pop("opacity", None)}
    figure.add_scatter(x=x, y=y, mode="markers", marker=marker, name=name, row=row, col=col if row else None, **more)


def both_ways(
    load: Array, output: Array, colours: Palette, translate: Translator, max_points: int, size: int
) -> go.Figure:
    """Draw an output over a load, loading and unloading apart: at most so many dots of each."""
    rising = np.gradient(load) >= 0 if len(load) > 1 else np.ones(len(load), dtype=bool)
    figure = go.Figure()
    for name, rows, colour in (("loading", rising, colours.mapped), ("unloading", ~rising, colours.raw)):
        x, y = load[rows], output[rows]
        at = thinning_slice(x, max_points)
        dots(figure, x[at], y[at], colour, translate(f"chart.{name}"), size, opacity=0.6)
    return figure.update_layout(legend_itemsizing="constant")


def axis_titles(figure: go.Figure, row: int, y_title: str, x_title: str | None = None) -> None:
    """Give one of several figures that stand below one another its titles."""
    figure.update_yaxes(title=y_title, automargin=True, row=row, col=1)
    if x_title is not None:
        figure.update_xaxes(title=x_title, row=row, col=1)


def nice_step(span: float) -> float:
    """Return 1, 2 or 5 times a power of ten, so that about `TICK_STEPS` make the span."""
    power = 10.0 ** math.floor(math.log10(span / TICK_STEPS))
    return next(step * power for step in (1, 2, 5, 10) if step * power * TICK_STEPS >= span)


def log_ticks(low: float, high: float) -> list[float]:
    """Return ticks of a logarithmic axis: 1, 2 and 5 of every decade, of less than a decade even steps."""
    if high < 10 * low:
        step = nice_step(high - low)
        return [k * step for k in range(math.ceil(low / step), math.floor(high / step) + 1)]
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)))
    return [k * 10.0**power for power in powers for k in (1, 2, 5)]


def integer_ticks(figure: go.Figure, max_count: float) -> None:
    """Give the upright axis of counts ticks at whole numbers alone, from 0 to `max_count`."""
    figure.update_yaxes(rangemode="tozero", tick0=0, dtick=max(1.0, nice_step(max(max_count, 1.0))), tickformat="d")


def steps(heights: Array) -> Array:
    """Return heights of bins for a line of shape `hv` over their edges, to the last edge."""
    return np.append(heights, heights[-1])


def level_line(figure: go.Figure, at: float, colour: str, text: str, row: int = 1, dash: str = "solid") -> None:
    """Draw a horizontal line with its name at the right end."""
    figure.add_hline(
        at,
        line={"color": colour, "width": 1.5, "dash": dash},
        annotation={"text": text, "font": {"color": colour, "size": 12}, "xanchor": "right", "yanchor": "bottom"},
        row=row,
        col=1,
    )
