"""Profiles, source recordings and golden units into Plotly figures."""

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from softcal.app.charts.palette import Palette
from softcal.app.charts.style import apply_style, apply_theme, axis_titles, both_ways, dots, level_line
from softcal.app.texts.reasons import Translator
from softcal.core.lot import Lot
from softcal.core.profiles import Profile
from softcal.core.quality.control_chart import ControlChart
from softcal.core.recording import LabelledRecording
from softcal.db.entries import GoldenRun

SAMPLE_RATE_HZ = 20.0


def profile_figure(
    profile: Profile, start_mm: float, deepest_mm: float, fastest_mm_s: float, colours: Palette, translate: Translator
) -> go.Figure:
    """Draw position and speed over time with the bounds of the station, which has its own zero."""
    t_s, stage_mm = profile.sample(SAMPLE_RATE_HZ)
    figure = make_subplots(rows=2, shared_xaxes=True, vertical_spacing=0.07, row_heights=[0.6, 0.4])
    figure.add_scatter(x=t_s, y=start_mm + stage_mm, line={"color": colours.mapped, "width": 1.6}, row=1, col=1)
    figure.add_scatter(x=t_s, y=np.gradient(stage_mm, t_s), line={"color": colours.source, "width": 1.2}, row=2, col=1)
    level_line(figure, deepest_mm, colours.limit, f"{deepest_mm:g} mm", row=1, dash="dash")
    for sign in (-1, 1):
        level_line(figure, sign * fastest_mm_s, colours.limit, f"{sign * fastest_mm_s:g} mm/s", row=2, dash="dash")
    axis_titles(figure, 1, f"{translate('chart.stage')} [mm]")
    axis_titles(figure, 2, f"{translate('chart.speed')} [mm/s]", translate("chart.time"))
    return apply_theme(figure, colours, 440).update_layout(showlegend=False, margin_t=20)


def golden_figure(
    runs: Sequence[GoldenRun], chart: ControlChart | None, colours: Palette, translate: Translator
) -> go.Figure:
    """Draw the checks with a golden unit over time, with control limits where there are any."""
    figure = go.Figure()
    for passed, symbol, colour in ((True, "circle", colours.source), (False, "x", colours.limit)):
        group = [run for run in runs if run.passed is passed]
        x, y = [run.made_at for run in group], [run.value for run in group]
        dots(figure, x, y, colour, translate("golden.passed" if passed else "golden.failed"), 9, symbol=symbol)
    if chart is not None:
        figure.add_hline(chart.centre, line={"color": colours.text, "width": 1})
        figure.add_hline(chart.upper, line={"color": colours.limit, "width": 1.5, "dash": "dash"})
    figure.update_yaxes(rangemode="tozero")
    # Numbers, for the names of months would be English in every language.
    figure.update_xaxes(tickformat="%Y-%m-%d", nticks=6)
    return apply_style(figure, colours, translate("column.made"), f"{translate('chart.error')} [{runs[0].unit}]", 280)


def source_curve(source: LabelledRecording, lot: Lot, colours: Palette, translate: Translator) -> go.Figure:
    """Draw the output of a source over its reference, loading and unloading apart."""
    figure = both_ways(source.reference, source.unlabelled.output, colours, translate, 2500, 3)
    titles = (
        f"{translate('chart.reference')} [{lot.reference_unit}]",
        f"{translate('chart.output')} [{lot.output_unit}]",
    )
    return apply_style(figure, colours, *titles)
