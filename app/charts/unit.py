"""One unit into figures: its outputs, its map, its estimates, its recordings."""

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from softcal.app.charts.palette import Palette
from softcal.app.charts.style import apply_style, apply_theme, axis_titles, both_ways, steps
from softcal.app.texts.reasons import Translator
from softcal.app.views.common import thinning_slice
from softcal.app.views.unit import UnitSignals
from softcal.core.lot import Lot
from softcal.core.recording import LabelledRecording, OutputRecording

BINS = 60


def output_distributions(view: UnitSignals, colours: Palette, translate: Translator) -> go.Figure:
    """Draw the distribution of the source's output and of the unit's, raw and mapped."""
    figure = go.Figure()
    series = (
        ("source", view.source.unlabelled.output, colours.source),
        ("raw", view.recording.output, colours.raw),
        ("mapped", view.mapped, colours.mapped),
    )
    low = min(float(values.min()) for _, values, _ in series)
    high = max(float(values.max()) for _, values, _ in series)
    for name, values, colour in series:
        share, edges = np.histogram(values, bins=BINS, range=(low, high))
        line = {"color": colour, "width": 2, "shape": "hv", "dash": "dot" if name == "raw" else "solid"}
        figure.add_scatter(x=edges, y=steps(share) / len(values), name=translate(f"chart.{name}"), line=line)
    return apply_style(
        figure, colours, f"{translate('chart.output')} [{view.lot.output_unit}]", translate("chart.density")
    )


def map_curve(view: UnitSignals, colours: Palette, translate: Translator) -> go.Figure:
    """Draw what the map makes of a steady output."""
    level, mapped = view.map_curve()
    figure = go.Figure()
    figure.add_scatter(
        x=level, y=level, name=translate("chart.identity"), line={"color": colours.source, "dash": "dot"}
    )
    figure.add_scatter(x=level, y=mapped, name=translate("chart.mapped"), line={"color": colours.mapped, "width": 3})
    unit = view.lot.output_unit
    return apply_style(figure, colours, f"{translate('chart.raw')} [{unit}]", f"{translate('chart.source')} [{unit}]")


def estimate_band(view: UnitSignals, colours: Palette, translate: Translator) -> go.Figure:
    """Draw the estimate over time with its interval."""
    result, unit = view.estimate, view.lot.reference_unit
    at = thinning_slice(result.t_s)
    figure, t_s, edge = go.Figure(), result.t_s[at], {"width": 0}
    figure.add_scatter(x=t_s, y=result.upper[at], line=edge, showlegend=False, hoverinfo="skip")
    filled = {"fill": "tonexty", "fillcolor": colours.band}
    figure.add_scatter(x=t_s, y=result.lower[at], name=translate("chart.interval"), line=edge, **filled)
    line = {"color": colours.mapped, "width": 1.5}
    figure.add_scatter(x=t_s, y=result.estimate[at], name=translate("chart.estimate"), line=line)
    return apply_style(figure, colours, translate("chart.time"), f"{view.lot.reference_quantity} [{unit}]")


def hysteresis(view: UnitSignals, colours: Palette, translate: Translator) -> go.Figure:
    """Draw the output over the estimate, loading and unloading apart."""
    value, output = view.estimate.estimate, view.recording.output
    finite = np.isfinite(value)
    unit = f"{translate('chart.estimate')} [{view.lot.reference_unit}]"
    figure = both_ways(value[finite], output[finite], colours, translate, 2000, 4)
    return apply_style(figure, colours, unit, f"{translate('chart.output')} [{view.lot.output_unit}]")


def recording(
    shown_recording: OutputRecording | LabelledRecording, lot: Lot, colours: Palette, translate: Translator
) -> go.Figure:
    """Draw a recording over time: the output, and the reference below it where there is one."""
    labelled, plain = (
        (shown_recording, shown_recording.unlabelled)
        if isinstance(shown_recording, LabelledRecording)
        else (None, shown_recording)
    )
    at = thinning_slice(plain.t_s)
    figure = make_subplots(rows=1 if labelled is None else 2, shared_xaxes=True, vertical_spacing=0.08)
    series = [(translate("chart.output"), lot.output_unit, plain.output, colours.raw)]
    if labelled is not None:
        series.append((lot.reference_quantity, lot.reference_unit, labelled.reference, colours.source))
    for row, (name, unit, values, colour) in enumerate(series, 1):
        line = {"color": colour, "width": 1.3}
        figure.add_scatter(x=plain.t_s[at], y=values[at], name=name, line=line, row=row, col=1)
        axis_titles(figure, row, f"{name} [{unit}]", translate("chart.time") if row == len(series) else None)
    return apply_theme(figure, colours, 220 + 160 * (len(series) - 1)).update_layout(showlegend=False, margin_t=20)
