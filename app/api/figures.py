"""Figures of the Python API: a recording over time; a unit's map, its loop and its estimate. Needs plotly."""

from functools import partial

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from softcal.app.charts.palette import LIGHT
from softcal.app.charts.style import apply_style, apply_theme, axis_titles, both_ways
from softcal.app.charts.unit import estimate_band, hysteresis, map_curve
from softcal.app.texts.catalogue import text
from softcal.app.views.common import thinning_slice
from softcal.app.views.unit import UnitSignals
from softcal.core.recording import Array

RENDER = partial(text, "en")
BACKGROUND = {"paper_bgcolor": "white", "plot_bgcolor": "white"}
"""A notebook may be dark: letters and lines are those of the light theme."""


def draw_recording(title: str, t_s: Array, series: list[tuple[str, Array]]) -> go.Figure:
    """Draw columns over time, one below the other.

    Args:
        series: what stands at the axis, with its physical unit, and (n,) values; NaN breaks the line.
    """
    rows = thinning_slice(t_s)
    figure = make_subplots(rows=len(series), shared_xaxes=True, vertical_spacing=0.08)
    for row, (name, values) in enumerate(series, 1):
        line = {"color": LIGHT.raw if row == 1 else LIGHT.source, "width": 1.3}
        figure.add_scatter(x=t_s[rows], y=values[rows], name=name, line=line, row=row, col=1)
        axis_titles(figure, row, name, RENDER("chart.time") if row == len(series) else None)
    return apply_theme(figure, LIGHT, 100 + 170 * len(series)).update_layout(
        showlegend=False, title=title, **BACKGROUND
    )


def draw_unit(signals: UnitSignals, reference: Array | None, title: str) -> go.Figure:
    """Draw a unit's map, its output over the load, and its estimate with the 90 % band.

    Args:
        reference: (n,) load beside the output; None draws the output over the estimate.
    """
    lot = signals.lot
    load = f"{lot.reference_quantity} [{lot.reference_unit}]"
    loop, over_time = hysteresis(signals, LIGHT, RENDER), estimate_band(signals, LIGHT, RENDER)
    if reference is not None:
        is_valid = np.isfinite(reference)
        loop = both_ways(reference[is_valid], signals.recording.output[is_valid], LIGHT, RENDER, 2000, 4)
        loop = apply_style(loop, LIGHT, load, f"{RENDER('chart.output')} [{lot.output_unit}]")
        rows = thinning_slice(signals.recording.t_s)
        line = {"color": LIGHT.source, "dash": "dot", "width": 1.2}
        over_time.add_scatter(x=signals.recording.t_s[rows], y=reference[rows], name=lot.reference_quantity, line=line)
    figure = make_subplots(rows=2, cols=2, specs=[[{}, {}], [{"colspan": 2}, None]], vertical_spacing=0.16)
    for part, (row, col) in ((map_curve(signals, LIGHT, RENDER), (1, 1)), (loop, (1, 2)), (over_time, (2, 1))):
        for trace in part.data:
            figure.add_trace(trace, row=row, col=col)
        figure.update_xaxes(title=part.layout.xaxis.title.text, row=row, col=col)
        figure.update_yaxes(title=part.layout.yaxis.title.text, row=row, col=col)
    legend = {"orientation": "h", "yref": "paper", "y": -0.12, "yanchor": "top", "x": 0}
    return apply_theme(figure, LIGHT, 640).update_layout(title=title, legend=legend, margin_b=100, **BACKGROUND)
