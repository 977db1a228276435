"""Drift, map and predicted error of a unit in use over time; of a stream at hand its output and estimates too."""

from typing import Any

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from softcal.app.charts.palette import Palette
from softcal.app.charts.style import apply_theme, axis_titles, dots, level_line
from softcal.app.texts.reasons import Translator
from softcal.app.views.common import limit_number, thinning_slice
from softcal.app.views.long_term import Course, Trace

EVENTS = (("held", "x"), ("tried", "triangle-up"), ("jumped", "diamond"))
ROW_PX = 190
HOURS_FROM_S = 7200.0
"""A longer course is drawn in hours."""


def course_figure(course: Course, colours: Palette, translate: Translator, trace: Trace | None = None) -> go.Figure:
    """Draw drift, gain, offset and predicted error; where the map was held, where it jumped and alarms stand out."""
    time_s = [*course.column("t_s"), *(trace.t_s if trace else ())]
    scale, time_title = (3600.0, "chart.time_h") if max(time_s, default=0.0) > HOURS_FROM_S else (1.0, "chart.time")
    rows = 6 if trace else 4
    figure = make_subplots(rows=rows, shared_xaxes=True, vertical_spacing=0.04)
    at, first = thinning_slice(course.steps), 2 if trace else 1
    times = [t_s / scale for t_s in course.column("t_s")][at]

    def line(
        row: int, x: list[float], y: list[float], colour: str, title: str, is_map: bool = True, name: str | None = None
    ) -> None:
        look, legend = {"color": colour, "width": 1.6} | ({"shape": "hv"} if is_map else {}), {"showlegend": bool(name)}
        figure.add_scatter(x=x, y=y, line=look, mode="lines", name=name, row=row, col=1, **legend)
        axis_titles(figure, row, title)

    def band(row: int, x: list[float], lower: list[float], upper: list[float]) -> None:
        edge: dict[str, Any] = {"mode": "lines", "line": {"width": 0}, "hoverinfo": "skip", "showlegend": False}
        figure.add_scatter(x=x, y=lower, row=row, col=1, **edge)
        figure.add_scatter(x=x, y=upper, fill="tonexty", fillcolor=colours.band, row=row, col=1, **edge)

    def mark(row: int, which: str, by: str, value: str, hover_field: str, colour: str, symbol: str) -> None:
        steps = [step for step in course.steps if step[by] and (by == "alarm" or step[by] == which)]
        if steps:
            x, y = [step["t_s"] / scale for step in steps], [step[value] for step in steps]
            hover: dict[str, Any] = {
                "text": [step[hover_field] for step in steps],
                "hovertemplate": "%{text}<extra></extra>",
            }
            dots(figure, x, y, colour, translate(f"event.{which}"), 9, row, symbol=symbol, **hover)

    if trace:
        stream = [t_s / scale for t_s in trace.t_s]
        line(1, stream, trace.output, colours.source, f"{translate('chart.output')} [{course.output_unit}]", False)
        band(rows - 1, stream, trace.lower, trace.upper)
        title = f"{translate('chart.estimate')} [{course.reference_unit}]"
        line(rows - 1, stream, trace.estimate, colours.mapped, title, False)
    for name, colour in (("shift", colours.mapped), ("log_gain", colours.raw)):
        drift, sd = course.column(name)[at], course.column(f"{name}_sd")[at]
        band(first, times, *([v + sign * s for v, s in zip(drift, sd, strict=True)] for sign in (-1, 1)))
        line(first, times, drift, colour, translate("chart.drift_scale"), False, translate(f"chart.{name}"))
    for event, symbol in EVENTS:
        mark(first, event, "verdict", "shift", "reason", colours.raw, symbol)
    line(first + 1, times, course.column("gain")[at], colours.source, translate("chart.gain"))
    line(
        first + 2,
        times,
        course.column("offset")[at],
        colours.source,
        f"{translate('chart.offset')} [{course.output_unit}]",
    )
    title = f"{translate('lot.predicted')} [{course.reference_unit}]"
    line(rows, times, course.column("predicted_rmse")[at], colours.mapped, title)
    if (limit := course.limit_rmse) is not None:
        text = translate("chart.limit.named", limit=limit_number(limit, course.reference_unit))
        level_line(figure, limit, colours.limit, text, row=rows, dash="dash")
    mark(rows, "alarm", "alarm", "predicted_rmse", "alarm", colours.limit, "triangle-up")
    axis_titles(figure, rows, title, translate(time_title))
    figure.update_yaxes(rangemode="tozero", row=rows, col=1)
    return apply_theme(figure, colours, ROW_PX * rows)
