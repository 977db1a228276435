"""Two units in one picture: their maps, and how wide their intervals are over the load."""

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from softcal.app.charts.palette import Palette
from softcal.app.charts.style import Words, styled
from softcal.app.views.unit import UnitView

BINS = 30


def maps_together(views: Sequence[UnitView], colours: Palette, words: Words) -> go.Figure:
    """Draw what each map makes of a steady output, in units of the source's output."""
    figure = go.Figure()
    for view, colour in zip(views, (colours.mapped, colours.raw), strict=False):
        level, mapped = view.map_curve()
        figure.add_scatter(x=level, y=mapped, name=view.stored.serial, line={"color": colour, "width": 2.5})
    unit = views[0].lot.output_unit
    return styled(figure, colours, f"{words('chart.raw')} [{unit}]", f"{words('chart.source')} [{unit}]")


def predicted_over_load(views: Sequence[UnitView], colours: Palette, words: Words) -> go.Figure:
    """Draw the half width of the 90 % interval of each unit over its estimate, as medians of equal bins."""
    figure = go.Figure()
    for view, colour in zip(views, (colours.mapped, colours.raw), strict=False):
        found = view.estimate
        known = np.isfinite(found.estimate) & np.isfinite(found.upper) & np.isfinite(found.lower)
        value, half = found.estimate[known], (found.upper - found.lower)[known] / 2
        if not len(value):
            continue
        edges = np.linspace(value.min(), value.max(), BINS + 1)
        at = np.clip(np.digitize(value, edges) - 1, 0, BINS - 1)
        bins = [k for k in range(BINS) if np.any(at == k)]
        x = [(edges[k] + edges[k + 1]) / 2 for k in bins]
        y = [float(np.median(half[at == k])) for k in bins]
        figure.add_scatter(x=x, y=y, name=view.stored.serial, line={"color": colour, "width": 2.5})
    unit = views[0].lot.reference_unit
    return styled(figure, colours, f"{words('chart.estimate')} [{unit}]", f"{words('chart.half_width')} [{unit}]")
