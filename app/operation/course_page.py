"""The page of an adaptation over time; it needs plotly, which an adaptation does not."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from softcal.app.charts.long_term import course_figure
from softcal.app.charts.palette import LIGHT
from softcal.app.files.atomic import write_text
from softcal.app.operation.adapt import AdaptReport
from softcal.app.texts.catalogue import text
from softcal.app.views.long_term import Course


def write_course_page(path: Path, report: AdaptReport, maps: list[Mapping[str, Any]]) -> None:
    """Write drift, map, estimate and predicted error over time as one page."""
    lot, steps = report.lot, tuple(s for s in maps if s["t_s"] is not None)
    course = Course(report.serial, report.stream, steps, lot.output_unit, lot.reference_unit, lot.limit_rmse)
    figure = course_figure(course, LIGHT, partial(text, "en"), report.trace)
    figure.update_layout(title={"text": f"{report.serial}, stream {report.stream}", "x": 0.99, "xanchor": "right"})
    write_text(path, figure.to_html(include_plotlyjs=True))
