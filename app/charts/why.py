"""Why a unit's verdict is what it is, in one figure of four panels that the screens and the command line share."""

import textwrap
from functools import partial
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from plotly.offline import get_plotlyjs
from plotly.subplots import make_subplots

from softcal.app.charts.palette import Palette, palette
from softcal.app.charts.style import coloured, steps
from softcal.app.files.atomic import write_text
from softcal.app.texts.catalogue import text
from softcal.app.texts.reasons import Words, phrase, said
from softcal.app.views.common import thinned
from softcal.app.views.unit import UnitView, unit_view
from softcal.core.errors import InputError
from softcal.db.registry import Registry

HEIGHT = 860
WIDTH = 150
"""Characters of a line of reasons."""

TITLE = 34
"""Characters of a line above a panel: two panels stand side by side on 800 px."""

MOST_REASONS = 5
PARTS, LOADS, INTERVAL, TIME = (1, 1), (1, 2), (2, 1), (2, 2)


def why_figure(view: UnitView, colours: Palette, words: Words) -> go.Figure:
    """Draw verdict and reasons above four panels.

    The first shows what the predicted error is made of, with its 95 % interval and the limit. The second shows how the
    unit's loads are distributed with and without its map, beside the source's. The third is the half width of the 90 %
    interval by load and direction over the source's. The last is the estimate over time, where windows unlike any of
    the source are marked.

    Args:
        colours, words: of the screen; `palette("light")` and a text function on the command line.
    """
    named = [words(f"why.{name}") for name in ("parts", "loads", "interval", "time")]
    titles = ["<br>".join(textwrap.wrap(title, TITLE)) for title in named]
    figure = make_subplots(rows=2, cols=2, subplot_titles=titles, horizontal_spacing=0.1, vertical_spacing=0.14)
    _parts(figure, view, colours, words)
    _loads(figure, view, colours, words)
    _interval(figure, view, colours, words)
    _time(figure, view, colours, words)
    coloured(figure, colours, HEIGHT)
    head = _head(view, colours, words)
    lines = 1 + head.count("<br>")
    return figure.update_layout(
        title={"text": head, "x": 0.01, "y": 1, "yanchor": "top", "pad": {"t": 16}, "font": {"size": 14}},
        margin={"t": 60 + 21 * lines, "l": 110, "r": 24, "b": 70},
        height=HEIGHT + 21 * lines,
        legend={"orientation": "h", "y": -0.08, "yanchor": "top", "x": 0},
    )


def _head(view: UnitView, colours: Palette, words: Words) -> str:
    verdict, reasons = view.calibration.decision.verdict, view.calibration.decision.reasons
    badge = f"<b style='color:{colours.verdict[verdict]}'>{words(f'verdict.{verdict}')}</b>"
    head = f"<b>{view.calibration.serial}</b>  {badge}  {view.calibration.unit_map.family}"
    lines = [line for reason in reasons[:MOST_REASONS] for line in textwrap.wrap(f"• {said(reason, words)}", WIDTH)]
    return "<br>".join([head, *lines])


def _parts(figure: go.Figure, view: UnitView, colours: Palette, words: Words) -> None:
    found, unit = view.explanation, view.lot.reference_unit
    names, values = (
        [phrase("part", name, words) for name in found.contributions][::-1],
        list(found.contributions.values())[::-1],
    )
    bars = go.Bar(x=values, y=names, orientation="h", marker_color=colours.source, showlegend=False)
    _at(figure, PARTS, bars)
    end = max(0.0, *values, *(found.forecast or ()), found.limit or 0.0)
    if found.forecast is not None:
        low, middle, high = found.forecast
        spread = {"type": "data", "symmetric": False, "array": [high - middle], "arrayminus": [middle - low]}
        marker, name = {"color": colours.mapped, "size": 12, "symbol": "diamond"}, words("column.predicted")
        _at(figure, PARTS, go.Scatter(x=[middle], y=[name], mode="markers", marker=marker, error_x=spread, name=name))
    if found.limit is not None:
        figure.add_vline(found.limit, line={"color": colours.limit, "width": 2}, row=PARTS[0], col=PARTS[1])
        _at(figure, PARTS, _key(words("chart.limit"), colours.limit, "solid"))
    _titled(figure, PARTS, f"{words('chart.error')} [{unit}]", "")
    # Room behind the last of them, so that the line of the limit stands inside.
    figure.update_xaxes(range=[0.0, 1.05 * end or 1.0], row=PARTS[0], col=PARTS[1])


def _loads(figure: go.Figure, view: UnitView, colours: Palette, words: Words) -> None:
    found = view.explanation
    for name, density, colour, dash in (
        (words("chart.source"), found.source_density, colours.source, "solid"),
        (words("chart.mapped"), found.mapped_density, colours.mapped, "solid"),
        (words("chart.raw"), found.unmapped_density, colours.raw, "dot"),
    ):
        line = {"color": colour, "width": 2, "shape": "hv", "dash": dash}
        _at(figure, LOADS, go.Scatter(x=found.density_edges, y=steps(density), name=name, line=line))
    _titled(figure, LOADS, _load(view), words("chart.density"))


def _interval(figure: go.Figure, view: UnitView, colours: Palette, words: Words) -> None:
    found = view.explanation
    for k, direction in enumerate(found.directions):
        dash = ("solid", "dash", "dot")[k % 3]
        for half_width, colour, width in (
            (found.source_half_width[k], colours.source, 1.5),
            (found.half_width[k], colours.mapped, 2.5),
        ):
            line = {"color": colour, "dash": dash, "width": width}
            _at(figure, INTERVAL, go.Scatter(x=found.levels, y=half_width, line=line, showlegend=False))
        _at(figure, INTERVAL, _key(words(f"chart.{direction}"), colours.text, dash))
    _titled(figure, INTERVAL, _load(view), f"± [{view.lot.reference_unit}]")
    figure.update_yaxes(rangemode="tozero", row=INTERVAL[0], col=INTERVAL[1])


def _time(figure: go.Figure, view: UnitView, colours: Palette, words: Words) -> None:
    found = view.explanation
    at = thinned(found.t_s)
    line = {"color": colours.mapped, "width": 1.2}
    _at(figure, TIME, go.Scatter(x=found.t_s[at], y=found.estimate[at], line=line, name=words("chart.estimate")))
    strange = np.flatnonzero(found.distance > found.familiar_distance)
    if len(strange):
        rows = strange[thinned(strange.astype(np.float64))]
        marker = {"color": colours.limit, "size": 5}
        name = words("why.unfamiliar")
        _at(
            figure,
            TIME,
            go.Scatter(x=found.t_s[rows], y=found.estimate[rows], mode="markers", marker=marker, name=name),
        )
    _titled(figure, TIME, words("chart.time"), _load(view))


def _key(name: str, colour: str, dash: str) -> go.Scatter:
    """Return an empty line that puts a name into the legend."""
    return go.Scatter(x=[None], y=[None], mode="lines", line={"color": colour, "dash": dash}, name=name)


def _load(view: UnitView) -> str:
    return f"{view.lot.reference_quantity} [{view.lot.reference_unit}]"


def _at(figure: go.Figure, place: tuple[int, int], trace: go.Bar | go.Scatter) -> None:
    figure.add_trace(trace, row=place[0], col=place[1])


def _titled(figure: go.Figure, place: tuple[int, int], x_title: str, y_title: str) -> None:
    figure.update_xaxes(title_text=x_title, title_standoff=6, row=place[0], col=place[1])
    figure.update_yaxes(title_text=y_title, title_standoff=6, automargin=True, row=place[0], col=place[1])


SCRIPT = "plotly.min.js"
"""Pages of one folder share this file beside them."""


def explain_unit(
    registry: Registry, serial: str, out: Path, revision: int | None = None, lot_id: str | None = None
) -> UnitView:
    """Write the page of one unit, whole in itself.

    Raises:
        InputError: the registry has no calibration of the serial, or the file is not to end in .html.
    """
    if out.suffix.lower() != ".html":
        raise InputError(f"{out}: the figure is written as a page; name a file that ends in .html")
    view = unit_view(registry, serial, revision, lot_id)
    write_text(out, why_page(view, script=True))
    return view


def explain_units(registry: Registry, serials: list[str], folder: Path, lot_id: str | None = None) -> None:
    """Write one page a unit into a folder, and the drawing script they share."""
    write_text(folder / SCRIPT, get_plotlyjs())
    for serial in serials:
        write_text(folder / f"{serial}.html", why_page(unit_view(registry, serial, None, lot_id), script=SCRIPT))


def why_page(view: UnitView, script: bool | str) -> str:
    """Return the figure as a page; `script` True puts the drawing script into it, a name refers to a file beside it."""
    figure = why_figure(view, palette("light"), partial(text, "en"))
    return str(figure.to_html(include_plotlyjs=script, config={"displaylogo": False}))


def why_json(view: UnitView) -> dict[str, object]:
    """Return the numbers behind the verdict as JSON values: schema `softcal.explain/1`."""
    found, decision, method = view.explanation, view.calibration.decision, view.calibration.method
    return {
        "schema": "softcal.explain/1",
        "serial": view.calibration.serial,
        "revision": view.stored.revision,
        "verdict": str(decision.verdict),
        "predicted": decision.predicted.to_json(),
        "measured": None if decision.measured is None else decision.measured.to_json(),
        "reasons": [str(why) for why in decision.reasons],
        "knowledge": str(view.calibration.knowledge),
        "method": None if method is None else {"id": method.id, "numbers": dict(method.to_json())},
        "predicted_rmse": None if found.forecast is None else found.forecast[1],
        "predicted_interval": None if found.forecast is None else [found.forecast[0], found.forecast[2]],
        "limit_rmse": found.limit,
        "contributions": dict(found.contributions),
        "evidence": dict(view.calibration.evidence),
    }
