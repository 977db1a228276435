"""Several lots in one picture: the predicted errors of each as a box, with its limit."""

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from softcal.app.charts.palette import Palette
from softcal.app.charts.style import Words, styled
from softcal.app.views.lot import LotView


def errors_of_lots(views: Sequence[LotView], colours: Palette, words: Words) -> go.Figure:
    """Draw quartiles and 5–95 % range of the predicted errors of lots, each beside its limit."""
    figure = go.Figure()
    ends = [0.0]
    for view in views:
        values = view.predicted()
        if len(values):
            low, first, middle, third, high = (float(v) for v in np.quantile(values, [0.05, 0.25, 0.5, 0.75, 0.95]))
            figure.add_box(
                x=[view.lot.id], q1=[first], median=[middle], q3=[third], lowerfence=[low], upperfence=[high],
                marker_color=colours.mapped, width=0.4, showlegend=False, name=view.lot.id,
            )  # fmt: skip
            ends.append(high)
    limited = [view for view in views if view.limit_rmse is not None]
    if limited:
        limits = [view.limit_rmse or 0.0 for view in limited]
        line = {"symbol": "line-ew-open", "size": 60, "color": colours.limit, "line": {"width": 2}}
        name = words("chart.limit")
        figure.add_scatter(x=[v.lot.id for v in limited], y=limits, mode="markers", marker=line, name=name)
        figure.update_layout(legend_itemsizing="constant")
        ends += limits
    figure.update_xaxes(type="category").update_yaxes(range=[0.0, 1.1 * max(ends) or 1.0])
    units = sorted({view.lot.reference_unit for view in views})
    return styled(figure, colours, words("choose.lot"), f"{words('column.predicted')} [{', '.join(units)}]")
