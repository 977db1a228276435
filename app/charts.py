"""Data into Plotly figures. Colours come from the palette, so that limit lines are seen in the dark too."""

from collections.abc import Callable

import numpy as np
import plotly.graph_objects as go

from softcal.app.palette import Palette
from softcal.app.views import LotView, UnitView, thinned
from softcal.core.recording import Array

Words = Callable[[str], str]

BINS = 60


def predicted_errors(view: LotView, colours: Palette, words: Words) -> go.Figure:
    """Draw how many units have which predicted error, with the lot's limit."""
    figure = go.Figure()
    for verdict, colour in colours.verdict.items():
        errors = [u.predicted_rmse for u in view.units if u.verdict == verdict and u.predicted_rmse is not None]
        if errors:
            figure.add_histogram(x=errors, name=words(f"verdict.{verdict}"), marker_color=colour)
    figure.update_layout(barmode="stack", bargap=0.05, yaxis_tickformat="d", yaxis_rangemode="tozero")
    if view.lot.limit_rmse is not None:
        _limit_line(figure, view.lot.limit_rmse, colours, words("chart.limit"))
    return _styled(figure, colours, f"{words('column.predicted')} [{view.lot.reference_unit}]", words("chart.count"))


def audit_scores(view: LotView, colours: Palette, words: Words) -> go.Figure:
    """Draw before, after and own of every audited unit."""
    figure = go.Figure()
    serials = [unit.serial for unit in view.audited]
    series = (("before", colours.raw), ("after", colours.mapped), ("own", colours.source))
    for name, colour in series:
        values = [getattr(unit, f"{name}_rmse") for unit in view.audited]
        figure.add_bar(x=serials, y=values, name=words(f"chart.{name}"), marker_color=colour)
    return _styled(figure, colours, words("column.serial"), f"RMSE [{view.lot.reference_unit}]")


def output_distributions(view: UnitView, colours: Palette, words: Words) -> go.Figure:
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
        line = {"color": colour, "width": 2, "shape": "hvh", "dash": "dot" if name == "raw" else "solid"}
        figure.add_scatter(x=edges[:-1], y=share / len(values), name=words(f"chart.{name}"), line=line)
    return _styled(figure, colours, f"[{view.lot.output_unit}]", words("chart.density"))


def map_curve(view: UnitView, colours: Palette, words: Words) -> go.Figure:
    """Draw what the map makes of a steady output."""
    level, mapped = view.map_curve()
    figure = go.Figure()
    figure.add_scatter(x=level, y=level, name=words("chart.identity"), line={"color": colours.grid, "dash": "dot"})
    figure.add_scatter(x=level, y=mapped, name=words("chart.mapped"), line={"color": colours.mapped, "width": 3})
    unit = view.lot.output_unit
    return _styled(figure, colours, f"{words('chart.raw')} [{unit}]", f"{words('chart.source')} [{unit}]")


def estimate_band(view: UnitView, colours: Palette, words: Words) -> go.Figure:
    """Draw the estimate over time with its interval."""
    result, unit = view.estimate, view.lot.reference_unit
    at = thinned(result.t_s)
    figure = go.Figure()
    figure.add_scatter(x=result.t_s[at], y=result.upper[at], line={"width": 0}, showlegend=False, hoverinfo="skip")
    figure.add_scatter(
        x=result.t_s[at],
        y=result.lower[at],
        name=words("chart.interval"),
        line={"width": 0},
        fill="tonexty",
        fillcolor=colours.band,
    )
    line = {"color": colours.mapped, "width": 1.5}
    figure.add_scatter(x=result.t_s[at], y=result.estimate[at], name=words("chart.estimate"), line=line)
    return _styled(figure, colours, words("chart.time"), f"{view.lot.reference_quantity} [{unit}]")


def hysteresis(view: UnitView, colours: Palette, words: Words) -> go.Figure:
    """Draw the output over the estimate, loading and unloading apart."""
    value, output = view.estimate.estimate, view.recording.output
    known = np.isfinite(value)
    value, output = value[known], output[known]
    rising = np.gradient(value) >= 0 if len(value) > 1 else np.ones(len(value), dtype=bool)
    figure = go.Figure()
    for name, rows, colour in (("loading", rising, colours.mapped), ("unloading", ~rising, colours.raw)):
        figure.add_scatter(**_dots(value[rows], output[rows]), name=words(f"chart.{name}"), marker_color=colour)
    unit = f"{words('chart.estimate')} [{view.lot.reference_unit}]"
    return _styled(figure, colours, unit, f"[{view.lot.output_unit}]")


def interval_by_load(view: UnitView, colours: Palette, words: Words) -> go.Figure:
    """Draw the half width of the 90 % interval over the load by direction, the unit's beside the source's."""
    found = view.explanation
    figure = go.Figure()
    for k, direction in enumerate(found.directions):
        dash = ("solid", "dash", "dot")[k % 3]
        name = words(f"chart.{direction}")
        unit_line = {"color": colours.mapped, "dash": dash, "width": 2.5}
        figure.add_scatter(x=found.levels, y=found.half_width[k], name=name, line=unit_line)
        source_line = {"color": colours.source, "dash": dash, "width": 1.5}
        name = f"{words('chart.source')}, {name}"
        figure.add_scatter(x=found.levels, y=found.source_half_width[k], name=name, line=source_line)
    unit = view.lot.reference_unit
    return _styled(figure, colours, f"{words('chart.estimate')} [{unit}]", f"± [{unit}]")


def contributions(view: UnitView, colours: Palette, words: Words) -> go.Figure:
    """Draw what the predicted error is made of, and where it stands against the limit."""
    found, unit = view.explanation, view.lot.reference_unit
    names, values = list(found.contributions)[::-1], list(found.contributions.values())[::-1]
    figure = go.Figure(go.Bar(x=values, y=names, orientation="h", marker_color=colours.source, showlegend=False))
    if found.forecast is not None:
        low, middle, high = found.forecast
        error = {"type": "data", "symmetric": False, "array": [high - middle], "arrayminus": [middle - low]}
        marker = {"color": colours.mapped, "size": 12, "symbol": "diamond"}
        total = words("column.predicted")
        figure.add_scatter(x=[middle], y=[total], mode="markers", marker=marker, error_x=error, name=total)
    if found.limit is not None:
        _limit_line(figure, found.limit, colours, words("chart.limit"))
    return _styled(figure, colours, f"[{unit}]", "").update_xaxes(rangemode="tozero").update_layout(showlegend=False)


def _dots(x: Array, y: Array) -> dict[str, object]:
    at = thinned(x, 2000)
    return {"x": x[at], "y": y[at], "mode": "markers", "marker_size": 4, "marker_opacity": 0.6}


def _limit_line(figure: go.Figure, at: float, colours: Palette, text: str) -> None:
    figure.add_vline(at, line_color=colours.limit, annotation_text=text, annotation_font_color=colours.limit)


def _styled(figure: go.Figure, colours: Palette, x_title: str, y_title: str) -> go.Figure:
    axis = {"gridcolor": colours.grid, "zerolinecolor": colours.grid, "linecolor": colours.grid}
    figure.update_xaxes(title=x_title, **axis)
    figure.update_yaxes(title=y_title, **axis)
    return figure.update_layout(
        height=320,
        margin={"l": 72, "r": 16, "t": 34, "b": 52},
        paper_bgcolor="rgba(0,0,0,0)",
        plot_bgcolor="rgba(0,0,0,0)",
        font_color=colours.text,
        legend={"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
    )
