"""Profiles, source recordings and golden units into Plotly figures."""

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from softcal.app.charts.palette import Palette
from softcal.app.charts.style import axis_titles, both_ways, coloured, dots, level_line, styled
from softcal.app.texts.reasons import Words
from softcal.core.lot import Lot
from softcal.core.profiles import Profile
from softcal.core.quality.control_chart import ControlChart
from softcal.core.recording import LabelledRecording
from softcal.db.entries import GoldenRun

SHOWN_HZ = 20.0


def profile_figure(
    profile: Profile, start_mm: float, deepest_mm: float, fastest_mm_s: float, colours: Palette, words: Words
) -> go.Figure:
    """Draw position and speed over time with the bounds of the station, which has its own zero."""
    t_s, stage_mm = profile.sample(SHOWN_HZ)
    figure = make_subplots(rows=2, shared_xaxes=True, vertical_spacing=0.07, row_heights=[0.6, 0.4])
    figure.add_scatter(x=t_s, y=start_mm + stage_mm, line={"color": colours.mapped, "width": 1.6}, row=1, col=1)
    figure.add_scatter(x=t_s, y=np.gradient(stage_mm, t_s), line={"color": colours.source, "width": 1.2}, row=2, col=1)
    level_line(figure, deepest_mm, colours.limit, f"{deepest_mm:g} mm", row=1, dash="dash")
    for sign in (-1, 1):
        level_line(figure, sign * fastest_mm_s, colours.limit, f"{sign * fastest_mm_s:g} mm/s", row=2, dash="dash")
    axis_titles(figure, 1, f"{words('chart.stage')} [mm]")
    axis_titles(figure, 2, f"{words('chart.speed')} [mm/s]", words("chart.time"))
    return coloured(figure, colours, 440).update_layout(showlegend=False, margin_t=20)


def golden_figure(runs: Sequence[GoldenRun], chart: ControlChart | None, colours: Palette, words: Words) -> go.Figure:
    """Draw the checks with a golden unit over time, with control limits where there are any."""
    figure = go.Figure()
    for passed, symbol, colour in ((True, "circle", colours.source), (False, "x", colours.limit)):
        mine = [run for run in runs if run.passed is passed]
        x, y = [run.made_at for run in mine], [run.value for run in mine]
        dots(figure, x, y, colour, words("golden.passed" if passed else "golden.failed"), 9, symbol=symbol)
    if chart is not None:
        figure.add_hline(chart.centre, line={"color": colours.text, "width": 1})
        figure.add_hline(chart.upper, line={"color": colours.limit, "width": 1.5, "dash": "dash"})
    figure.update_yaxes(rangemode="tozero")
    # Numbers, for the names of months would be English in every language.
    figure.update_xaxes(tickformat="%Y-%m-%d", nticks=6)
    return styled(figure, colours, words("column.made"), f"{words('chart.error')} [{runs[0].unit}]", 280)


def source_curve(source: LabelledRecording, lot: Lot, colours: Palette, words: Words) -> go.Figure:
    """Draw the output of a source over its reference, loading and unloading apart."""
    figure = both_ways(source.reference, source.unlabelled.output, colours, words, 2500, 3)
    titles = f"{words('chart.reference')} [{lot.reference_unit}]", f"{words('chart.output')} [{lot.output_unit}]"
    return styled(figure, colours, *titles)
