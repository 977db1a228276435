"""What is compared in one picture: two units, and lots."""

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from softcal.app.charts.palette import Palette
from softcal.app.charts.style import apply_style
from softcal.app.texts.reasons import Translator
from softcal.app.views.lot import LotView
from softcal.app.views.unit import UnitView

BINS = 30


def maps_together(views: Sequence[UnitView], colours: Palette, translate: Translator) -> go.Figure:
    """Draw what each map makes of a steady output, in units of the source's output."""
    figure = go.Figure()
    for view, colour in zip(views, (colours.mapped, colours.raw), strict=False):
        level, mapped = view.map_curve()
        figure.add_scatter(x=level, y=mapped, name=str(view.stored.key), line={"color": colour, "width": 2.5})
    unit = views[0].lot.output_unit
    return apply_style(figure, colours, f"{translate('chart.raw')} [{unit}]", f"{translate('chart.source')} [{unit}]")


def predicted_over_load(views: Sequence[UnitView], colours: Palette, translate: Translator) -> go.Figure:
    """Draw the half width of the 90 % interval over the estimate, as medians of equal bins."""
    figure = go.Figure()
    for view, colour in zip(views, (colours.mapped, colours.raw), strict=False):
        estimates = view.estimate
        finite = np.isfinite(estimates.estimate) & np.isfinite(estimates.upper) & np.isfinite(estimates.lower)
        value, half = estimates.estimate[finite], (estimates.upper - estimates.lower)[finite] / 2
        if not len(value):
            continue
        edges = np.linspace(value.min(), value.max(), BINS + 1)
        at = np.clip(np.digitize(value, edges) - 1, 0, BINS - 1)
        bins = [k for k in range(BINS) if np.any(at == k)]
        x = [(edges[k] + edges[k + 1]) / 2 for k in bins]
        y = [float(np.median(half[at == k])) for k in bins]
        figure.add_scatter(x=x, y=y, name=str(view.stored.key), line={"color": colour, "width": 2.5})
    unit = views[0].lot.reference_unit
    return apply_style(
        figure, colours, f"{translate('chart.estimate')} [{unit}]", f"{translate('chart.half_width')} [{unit}]"
    )


def errors_of_lots(views: Sequence[LotView], colours: Palette, translate: Translator) -> go.Figure:
    """Draw quartiles and 5–95 % range of the predicted errors of lots, each beside its limit."""
    figure = go.Figure()
    maxima = [0.0]
    for view in views:
        values = view.predicted()
        if len(values):
            low, first, middle, third, high = (float(v) for v in np.quantile(values, [0.05, 0.25, 0.5, 0.75, 0.95]))
            figure.add_box(
                x=[view.lot.id], q1=[first], median=[middle], q3=[third], lowerfence=[low], upperfence=[high],
                marker_color=colours.mapped, width=0.4, showlegend=False, name=view.lot.id,
            )  # fmt: skip
            maxima.append(high)
    limited = [view for view in views if view.limit_rmse is not None]
    if limited:
        limits = [view.limit_rmse or 0.0 for view in limited]
        line = {"symbol": "line-ew-open", "size": 60, "color": colours.limit, "line": {"width": 2}}
        name = translate("chart.limit")
        figure.add_scatter(x=[v.lot.id for v in limited], y=limits, mode="markers", marker=line, name=name)
        figure.update_layout(legend_itemsizing="constant")
        maxima += limits
    figure.update_xaxes(type="category").update_yaxes(range=[0.0, 1.1 * max(maxima) or 1.0])
    units = sorted({view.lot.reference_unit for view in views})
    return apply_style(
        figure, colours, translate("choose.lot"), f"{translate('column.predicted')} [{', '.join(units)}]"
    )
