"""Audited units into figures: estimate against reference, and the error over the load."""

from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from softcal.app.charts.palette import Palette
from softcal.app.charts.style import dots, level_line, styled
from softcal.app.texts.reasons import Words
from softcal.app.views.audited import AuditedView
from softcal.app.views.common import number, thinned

POINTS = 400
"""Dots of one unit; more cost the browser and show nothing."""


def estimate_over_reference(view: AuditedView, colours: Palette, words: Words) -> go.Figure:
    """Draw every unit's estimates over the reference, with the limit to both sides."""
    figure, unit = go.Figure(), view.lot.reference_unit
    ends = np.array([view.edges[0], view.edges[-1]])
    for k, one in enumerate(view.units):
        at = thinned(one.reference, POINTS)
        hover = f"{one.serial}: %{{x:.3g}} → %{{y:.3g}} {unit}<extra></extra>"
        more: dict[str, Any] = {"opacity": 0.45, "legendgroup": "units", "showlegend": k == 0, "hovertemplate": hover}
        dots(figure, one.reference[at], one.estimate[at], colours.mapped, words("chart.audited"), 3, **more)
    line = {"color": colours.text, "width": 1.5}
    figure.add_scatter(x=ends, y=ends, mode="lines", line=line, name=words("chart.equal"))
    if limit := view.limit_rmse:
        named = {"name": words("chart.limit.both", limit=number(limit, unit, limit)), "legendgroup": "l"}
        dashed = {"color": colours.limit, "width": 1.5, "dash": "dash"}
        for shift in (limit, -limit):
            figure.add_scatter(x=ends, y=ends + shift, mode="lines", line=dashed, showlegend=shift > 0, **named)
    figure.update_layout(legend_itemsizing="constant")
    title = f"{words('chart.reference')}: {view.lot.reference_quantity} [{unit}]"
    return styled(figure, colours, title, f"{words('chart.estimate')} [{unit}]")


def error_over_load(view: AuditedView, colours: Palette, words: Words) -> go.Figure:
    """Draw the RMSE of every unit by load, the largest by name, and the lot's limit."""
    figure, unit = make_subplots(), view.lot.reference_unit
    for k, one in enumerate(view.units):
        is_worst = k == 0
        figure.add_scatter(
            x=view.middles,
            y=view.band_errors(one),
            mode="lines+markers",
            connectgaps=False,
            line={"color": colours.raw if is_worst else colours.mapped, "width": 2.5 if is_worst else 1},
            marker_size=6 if is_worst else 3,
            name=words("chart.largest", serial=one.serial) if is_worst else words("chart.others"),
            legendgroup="worst" if is_worst else "others",
            showlegend=k <= 1,
            hovertemplate=f"{one.serial}: %{{y:.3g}} {unit}<extra></extra>",
        )
    if view.limit_rmse is not None:
        named = words("chart.limit.named", limit=number(view.limit_rmse, unit, view.limit_rmse))
        level_line(figure, view.limit_rmse, colours.limit, named, dash="dash")
    figure.update_yaxes(rangemode="tozero")
    return styled(figure, colours, f"{view.lot.reference_quantity} [{unit}]", f"RMSE [{unit}]")
