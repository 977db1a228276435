"""Audited units into figures: estimate against reference, and the error over the load."""

from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from softcal.app.charts.palette import Palette
from softcal.app.charts.style import apply_style, dots, level_line
from softcal.app.texts.reasons import Translator
from softcal.app.views.audited import AuditedView
from softcal.app.views.common import limit_number, thinning_slice

POINTS = 400
"""Dots of one unit; more cost the browser and show nothing."""


def estimate_over_reference(view: AuditedView, colours: Palette, translate: Translator) -> go.Figure:
    """Draw every unit's estimates over the reference, with the limit to both sides."""
    figure, unit = go.Figure(), view.lot.reference_unit
    diagonal = np.array([view.edges[0], view.edges[-1]])
    for k, one in enumerate(view.units):
        at = thinning_slice(one.reference, POINTS)
        hover = f"{one.serial}: %{{x:.3g}} → %{{y:.3g}} {unit}<extra></extra>"
        more: dict[str, Any] = {"opacity": 0.45, "legendgroup": "units", "showlegend": k == 0, "hovertemplate": hover}
        dots(figure, one.reference[at], one.estimate[at], colours.mapped, translate("chart.audited"), 3, **more)
    line = {"color": colours.text, "width": 1.5}
    figure.add_scatter(x=diagonal, y=diagonal, mode="lines", line=line, name=translate("chart.equal"))
    if limit := view.limit_rmse:
        limit_style = {"name": translate("chart.limit.both", limit=limit_number(limit, unit)), "legendgroup": "l"}
        dashed = {"color": colours.limit, "width": 1.5, "dash": "dash"}
        for shift in (limit, -limit):
            figure.add_scatter(
                x=diagonal, y=diagonal + shift, mode="lines", line=dashed, showlegend=shift > 0, **limit_style
            )
    figure.update_layout(legend_itemsizing="constant")
    title = f"{translate('chart.reference')}: {view.lot.reference_quantity} [{unit}]"
    return apply_style(figure, colours, title, f"{translate('chart.estimate')} [{unit}]")


def error_over_load(view: AuditedView, colours: Palette, translate: Translator) -> go.Figure:
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
            name=translate("chart.largest", serial=one.serial) if is_worst else translate("chart.others"),
            legendgroup="worst" if is_worst else "others",
            showlegend=k <= 1,
            hovertemplate=f"{one.serial}: %{{y:.3g}} {unit}<extra></extra>",
        )
    if view.limit_rmse is not None:
        label = translate("chart.limit.named", limit=limit_number(view.limit_rmse, unit))
        level_line(figure, view.limit_rmse, colours.limit, label, dash="dash")
    figure.update_yaxes(rangemode="tozero")
    return apply_style(figure, colours, f"{view.lot.reference_quantity} [{unit}]", f"RMSE [{unit}]")
