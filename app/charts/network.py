"""Comparisons of networks and map families into Plotly figures."""

from collections.abc import Mapping, Sequence
from typing import Any

import plotly.graph_objects as go

from softcal.app.charts.palette import Palette
from softcal.app.charts.style import styled
from softcal.app.texts.reasons import Words


def comparison(rows: Sequence[Mapping[str, Any]], unit: str, colours: Palette, words: Words) -> go.Figure:
    """Draw the median error of every family with every network: measured where audits are, forecast beside it."""
    networks = list(dict.fromkeys(row["network"] for row in rows))
    figure = go.Figure()
    series = (("after", colours.mapped), ("predicted", colours.source))
    for name, colour in series:
        for k, network in enumerate(networks):
            mine = [row for row in rows if row["network"] == network and row[name] is not None]
            if not mine:
                continue
            figure.add_bar(
                x=[row["family"] for row in mine],
                y=[row[name] for row in mine],
                name=f"{words(f'column.{name}')}, {network[:8]}",
                marker={"color": colour, "opacity": 1.0 - 0.45 * (k / max(1, len(networks) - 1))},
            )
    figure.update_yaxes(rangemode="tozero").update_layout(barmode="group", bargroupgap=0.1)
    return styled(figure, colours, words("column.family"), f"{words('networks.median')} [{unit}]")
