"""A table that was dropped: its columns over time, and the reference over the output."""

from typing import TYPE_CHECKING

import numpy as np
import plotly.graph_objects as go

from softcal.app.charts.palette import Palette
from softcal.app.charts.style import apply_style, dots
from softcal.app.files.import_plan import Columns
from softcal.app.texts.reasons import Translator
from softcal.app.views.common import thinning_slice
from softcal.core.recording import Array

if TYPE_CHECKING:
    import pandas as pd

MAX_LINES = 8


def columns_over_time(content: "pd.DataFrame", columns: Columns, colours: Palette, translate: Translator) -> go.Figure:
    """Draw the output columns over the time column, or over the row where there is none."""
    names = [str(name) for name in content.columns if columns.is_output(str(name))]
    if not columns.is_wide:
        names = [columns.output]
    at = thinning_slice(range(len(content)))
    rows = np.arange(len(content), dtype=float)[at]
    x = rows if columns.time is None else _numbers(content, columns.time)[at]
    figure = go.Figure()
    for number, name in enumerate(names[:MAX_LINES]):
        line = {"width": 1.5, "color": colours.mapped} if number == 0 else {"width": 1}
        figure.add_scatter(x=x, y=_numbers(content, name)[at], name=name, line=line)
    title = translate("chart.row") if columns.time is None else columns.time
    return apply_style(figure, colours, title, translate("chart.output"))


def reference_over_output(
    content: "pd.DataFrame", columns: Columns, colours: Palette, translate: Translator
) -> go.Figure | None:
    """Draw the reference over the output; None where this table has not both."""
    if columns.reference not in content.columns or columns.output not in content.columns:
        return None
    at = thinning_slice(range(len(content)))
    figure = go.Figure()
    x, y = _numbers(content, columns.output)[at], _numbers(content, str(columns.reference))[at]
    dots(figure, x, y, colours.mapped, None, showlegend=False)
    return apply_style(figure, colours, translate("chart.output"), str(columns.reference))


def _numbers(content: "pd.DataFrame", name: str) -> Array:
    """Return a column as numbers; what is none is left out of the picture."""
    import pandas as pd

    return np.asarray(pd.to_numeric(content[name], errors="coerce"), dtype=float)
