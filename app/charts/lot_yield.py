"""The first-pass yield of a lot over days, stations and operators as Plotly figures."""

from collections.abc import Sequence

import plotly.graph_objects as go

from softcal.app.charts.palette import Palette
from softcal.app.charts.style import Words, styled
from softcal.app.views.lot_runs import DESK, YieldAt

WITH_COUNTS = 8
"""Up to so many bars say how many units they are of; more would be written over one another."""


def yield_figure(found: Sequence[YieldAt], title: str, colours: Palette, words: Words) -> go.Figure:
    """Draw the yield at each place with its 95 % interval and the number of units.

    Args:
        title: of the axis: what the places are.
    """
    names = [one.name if one.name != DESK else words("lot.yield.desk") for one in found]
    counts = [words("lot.yield.count", good=one.share.count, of=one.share.of) for one in found]
    value = [100 * (one.share.value or 0.0) for one in found]
    up = [100 * one.share.interval[1] - at for one, at in zip(found, value, strict=True)]
    down = [at - 100 * one.share.interval[0] for one, at in zip(found, value, strict=True)]
    figure = go.Figure(
        go.Bar(
            x=names,
            y=value,
            customdata=counts,
            hovertemplate="%{x}: %{y:.1f} % (%{customdata})<extra></extra>",
            width=0.6 if len(found) > 2 else 0.25,
            marker_color=colours.verdict["none"],
            error_y={"array": up, "arrayminus": down, "color": colours.text, "thickness": 1.5, "width": 5},
        )
    )
    if len(found) <= WITH_COUNTS:
        said = [f"{name}<br>{count}" for name, count in zip(names, counts, strict=True)]
        figure.update_xaxes(tickmode="array", tickvals=names, ticktext=said)
    figure.update_xaxes(type="category").update_yaxes(range=[0, 104], dtick=20)
    return styled(figure, colours, title, f"{words('lot.first_pass')} [%]").update_layout(showlegend=False, margin_t=20)
