"""Drift, map and predicted error of a unit in use over time, from what the registry keeps of it."""

from collections.abc import Mapping, Sequence
from typing import Any

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from softcal.app.charts.palette import Palette
from softcal.app.charts.style import axis_titles, coloured, dots
from softcal.app.texts.reasons import Words
from softcal.app.views.common import thinned
from softcal.app.views.long_term import Course

EVENTS = (("held", "x"), ("jumped", "diamond"))


def course_figure(course: Course, colours: Palette, words: Words) -> go.Figure:
    """Draw drift, gain, offset and predicted error; what was held and alarms stand out."""
    at = thinned(course.steps)
    t_h = [t_s / 3600 for t_s in course.column("t_s")][at]
    figure = make_subplots(rows=4, shared_xaxes=True, vertical_spacing=0.05)
    shift, sd = course.column("shift")[at], course.column("shift_sd")[at]
    edge = {"mode": "lines", "line": {"width": 0}, "hoverinfo": "skip", "showlegend": False, "row": 1, "col": 1}
    figure.add_scatter(x=t_h, y=[v - s for v, s in zip(shift, sd, strict=True)], **edge)
    upper = [v + s for v, s in zip(shift, sd, strict=True)]
    figure.add_scatter(x=t_h, y=upper, fill="tonexty", fillcolor=colours.band, **edge)
    line = {"color": colours.mapped, "width": 1.8}
    figure.add_scatter(x=t_h, y=shift, mode="lines", line=line, name=words("chart.drift"), row=1, col=1)
    for event, symbol in EVENTS:
        held = [step for step in course.steps if step["verdict"] == event]
        _marked(figure, held, "shift", "reason", words(f"event.{event}"), colours.raw, symbol=symbol, size=8, row=1)
    axis_titles(figure, 1, words("chart.drift_scale"))
    for row, (name, unit) in enumerate((("gain", ""), ("offset", course.output_unit)), 2):
        line = {"color": colours.source, "shape": "hv", "width": 1.6}
        figure.add_scatter(x=t_h, y=course.column(name)[at], line=line, mode="lines", showlegend=False, row=row, col=1)
        axis_titles(figure, row, f"{words(f'chart.{name}')} [{unit}]" if unit else words(f"chart.{name}"))
    line, values = {"color": colours.mapped, "shape": "hv", "width": 1.8}, course.column("predicted_rmse")[at]
    figure.add_scatter(x=t_h, y=values, mode="lines", line=line, showlegend=False, row=4, col=1)
    alarms, look = [step for step in course.steps if step["alarm"]], {"symbol": "triangle-up", "size": 9}
    _marked(figure, alarms, "predicted_rmse", "alarm", words("event.alarm"), colours.limit, row=4, **look)
    axis_titles(figure, 4, f"{words('lot.predicted')} [{course.reference_unit}]", words("chart.time_h"))
    figure.update_yaxes(rangemode="tozero", row=4, col=1)
    return coloured(figure, colours, 760)


def _marked(
    figure: go.Figure, steps: Sequence[Mapping[str, Any]], value: str, why: str, name: str, colour: str, **look: Any
) -> None:
    if steps:
        x, y = [step["t_s"] / 3600 for step in steps], [step[value] for step in steps]
        hover: dict[str, Any] = {"text": [step[why] for step in steps], "hovertemplate": "%{text}<extra></extra>"}
        dots(figure, x, y, colour, name, **hover, **look)
