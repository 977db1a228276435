"""Drift, map and predicted error of a unit in use over time, from what the registry keeps of it."""

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from softcal.app.charts.palette import Palette
from softcal.app.charts.style import coloured
from softcal.app.texts.reasons import Words
from softcal.app.views.common import thinned
from softcal.app.views.long_term import Course

EVENTS = (("held", "x"), ("jumped", "diamond"))


def course_figure(course: Course, colours: Palette, words: Words) -> go.Figure:
    """Draw drift with its uncertainty, gain, offset and predicted error; what was held and alarms stand out."""
    at = thinned(course.steps)
    t_h = [t_s / 3600 for t_s in course.column("t_s")][at]
    figure = make_subplots(rows=4, shared_xaxes=True, vertical_spacing=0.05)
    _drift(figure, course, t_h, at, colours, words)
    for row, (name, unit) in enumerate((("gain", ""), ("offset", course.output_unit)), 2):
        line = {"color": colours.source, "shape": "hv", "width": 1.6}
        figure.add_scatter(x=t_h, y=course.column(name)[at], line=line, mode="lines", showlegend=False, row=row, col=1)
        title = f"{words(f'chart.{name}')} [{unit}]" if unit else words(f"chart.{name}")
        figure.update_yaxes(title=title, automargin=True, row=row, col=1)
    _predicted(figure, course, t_h, at, colours, words)
    figure.update_xaxes(title=words("chart.time_h"), row=4, col=1)
    return coloured(figure, colours, 760)


def _drift(figure: go.Figure, course: Course, t_h: list[float], at: slice, colours: Palette, words: Words) -> None:
    shift, sd = course.column("shift")[at], course.column("shift_sd")[at]
    edge = {"mode": "lines", "line": {"width": 0}, "hoverinfo": "skip", "showlegend": False, "row": 1, "col": 1}
    figure.add_scatter(x=t_h, y=[v - s for v, s in zip(shift, sd, strict=True)], **edge)
    upper = [v + s for v, s in zip(shift, sd, strict=True)]
    figure.add_scatter(x=t_h, y=upper, fill="tonexty", fillcolor=colours.band, **edge)
    line = {"color": colours.mapped, "width": 1.8}
    figure.add_scatter(x=t_h, y=shift, mode="lines", line=line, name=words("chart.drift"), row=1, col=1)
    for event, symbol in EVENTS:
        steps = [step for step in course.steps if step["verdict"] == event]
        if steps:
            figure.add_scatter(
                x=[step["t_s"] / 3600 for step in steps],
                y=[step["shift"] for step in steps],
                text=[step["reason"] for step in steps],
                mode="markers",
                marker={"symbol": symbol, "color": colours.raw, "size": 8},
                hovertemplate="%{text}<extra></extra>",
                name=words(f"event.{event}"),
                row=1,
                col=1,
            )
    figure.update_yaxes(title=words("chart.drift_scale"), automargin=True, row=1, col=1)


def _predicted(figure: go.Figure, course: Course, t_h: list[float], at: slice, colours: Palette, words: Words) -> None:
    line = {"color": colours.mapped, "shape": "hv", "width": 1.8}
    values = course.column("predicted_rmse")[at]
    figure.add_scatter(x=t_h, y=values, mode="lines", line=line, showlegend=False, row=4, col=1)
    alarms = [step for step in course.steps if step["alarm"]]
    if alarms:
        figure.add_scatter(
            x=[step["t_s"] / 3600 for step in alarms],
            y=[step["predicted_rmse"] for step in alarms],
            text=[step["alarm"] for step in alarms],
            mode="markers",
            marker={"symbol": "triangle-up", "color": colours.limit, "size": 9},
            hovertemplate="%{text}<extra></extra>",
            name=words("event.alarm"),
            row=4,
            col=1,
        )
    title = f"{words('lot.predicted')} [{course.reference_unit}]"
    figure.update_yaxes(title=title, automargin=True, rangemode="tozero", row=4, col=1)
