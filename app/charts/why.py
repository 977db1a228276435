"""Why a unit's verdict is what it is: one figure of four panels, on a screen or a page."""

import textwrap
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from plotly.offline import get_plotlyjs
from plotly.subplots import make_subplots

from softcal.app.charts.palette import Palette, palette
from softcal.app.charts.style import coloured, dots, steps
from softcal.app.files.atomic import write_text
from softcal.app.texts.catalogue import text
from softcal.app.texts.reasons import Words, phrase, said
from softcal.app.views.common import thinned
from softcal.app.views.unit import UnitView, unit_view
from softcal.core.errors import InputError
from softcal.core.lot import UnitKey
from softcal.core.unit.state_json import adjustments_to_json, fit_to_json
from softcal.core.unit.verdict import Judgement
from softcal.db.registry import Registry

SCRIPT = "plotly.min.js"
"""Pages of one folder share this file beside them."""

HEIGHT = 860
WIDTH = 150
"""Characters of a line of reasons."""

TITLE = 34
"""Characters of a line above a panel: two panels stand side by side on 800 px."""

MOST_REASONS = 5
PARTS, LOADS, INTERVAL, TIME = ({"row": row, "col": column} for row in (1, 2) for column in (1, 2))


def why_figure(view: UnitView, colours: Palette, words: Words) -> go.Figure:
    """Draw verdict and reasons above four panels.

    The first shows what the predicted error is made of, with its 95 % interval and the limit; the
    second how the unit's loads are distributed with and without its map, beside the source's; the
    third the half width of the 90 % interval by load and direction over the source's; the last the
    estimate over time, where windows unlike any of the source are marked.
    """
    named = [words(f"why.{name}") for name in ("parts", "loads", "interval", "time")]
    titles = ["<br>".join(textwrap.wrap(title, TITLE)) for title in named]
    figure = make_subplots(rows=2, cols=2, subplot_titles=titles, horizontal_spacing=0.1, vertical_spacing=0.14)
    explanation, unit = view.explanation, view.lot.reference_unit
    load = f"{view.lot.reference_quantity} [{unit}]"

    parts = list(explanation.contributions.items())[::-1]
    names, values = [phrase("part", name, words) for name, _ in parts], [value for _, value in parts]
    figure.add_bar(x=values, y=names, orientation="h", marker_color=colours.source, showlegend=False, **PARTS)
    end = max(0.0, *values, *(explanation.forecast or ()), explanation.limit or 0.0)
    if explanation.forecast is not None:
        low, middle, high = explanation.forecast
        spread = {"type": "data", "symmetric": False, "array": [high - middle], "arrayminus": [middle - low]}
        name = words("column.predicted")
        dots(figure, [middle], [name], colours.mapped, name, 12, symbol="diamond", error_x=spread, **PARTS)
    if explanation.limit is not None:
        figure.add_vline(explanation.limit, line={"color": colours.limit, "width": 2}, **PARTS)
        _key(figure, PARTS, words("chart.limit"), colours.limit, "solid")
    _titled(figure, PARTS, f"{words('chart.error')} [{unit}]", "")
    # Room behind the last of them, so that the line of the limit stands inside.
    figure.update_xaxes(range=[0.0, 1.05 * end or 1.0], **PARTS)

    for name, density, colour, dash in (
        (words("chart.source"), explanation.source_density, colours.source, "solid"),
        (words("chart.mapped"), explanation.mapped_density, colours.mapped, "solid"),
        (words("chart.raw"), explanation.unmapped_density, colours.raw, "dot"),
    ):
        line = {"color": colour, "width": 2, "shape": "hv", "dash": dash}
        figure.add_scatter(x=explanation.density_edges, y=steps(density), name=name, line=line, **LOADS)
    _titled(figure, LOADS, load, words("chart.density"))

    for k, direction in enumerate(explanation.directions):
        dash = ("solid", "dash", "dot")[k % 3]
        for half_width, colour, width in (
            (explanation.source_half_width[k], colours.source, 1.5),
            (explanation.half_width[k], colours.mapped, 2.5),
        ):
            line = {"color": colour, "dash": dash, "width": width}
            figure.add_scatter(x=explanation.levels, y=half_width, line=line, showlegend=False, **INTERVAL)
        _key(figure, INTERVAL, words(f"chart.{direction}"), colours.text, dash)
    _titled(figure, INTERVAL, load, f"± [{unit}]")
    figure.update_yaxes(rangemode="tozero", **INTERVAL)

    t_s, estimate, at = explanation.t_s, explanation.estimate, thinned(explanation.t_s)
    line = {"color": colours.mapped, "width": 1.2}
    figure.add_scatter(x=t_s[at], y=estimate[at], line=line, name=words("chart.estimate"), **TIME)
    strange = np.flatnonzero(explanation.distance > explanation.familiar_distance)
    if len(strange):
        rows = strange[thinned(strange)]
        dots(figure, t_s[rows], estimate[rows], colours.limit, words("why.unfamiliar"), 5, **TIME)
    _titled(figure, TIME, words("chart.time"), load)

    coloured(figure, colours, HEIGHT)
    decision = view.stored.state.decision
    badge = f"<b style='color:{colours.verdict[decision.verdict]}'>{words(f'verdict.{decision.verdict}')}</b>"
    head = [f"<b>{view.calibration.serial}</b>  {badge}  {view.calibration.unit_map.family}"]
    for reason in decision.reasons[:MOST_REASONS]:
        head += textwrap.wrap(f"• {said(reason, words)}", WIDTH)
    return figure.update_layout(
        title={"text": "<br>".join(head), "x": 0.01, "y": 1, "yanchor": "top", "pad": {"t": 16}, "font": {"size": 14}},
        margin={"t": 60 + 21 * len(head), "l": 110, "r": 24, "b": 70},
        height=HEIGHT + 21 * len(head),
        legend={"orientation": "h", "y": -0.08, "yanchor": "top", "x": 0},
    )


def _key(figure: go.Figure, place: Mapping[str, int], name: str, colour: str, dash: str) -> None:
    """Put a name into the legend: a line of no points."""
    line = {"color": colour, "dash": dash}
    figure.add_scatter(x=[None], y=[None], mode="lines", line=line, name=name, **place)


def _titled(figure: go.Figure, place: Mapping[str, int], x_title: str, y_title: str) -> None:
    figure.update_xaxes(title_text=x_title, title_standoff=6, **place)
    figure.update_yaxes(title_text=y_title, title_standoff=6, automargin=True, **place)


def explain_unit(registry: Registry, unit: UnitKey, out: Path, revision: int | None) -> UnitView:
    """Write the page of one unit, whole in itself; InputError unless `out` ends in .html."""
    if out.suffix.lower() != ".html":
        raise InputError(f"{out}: the figure is written as a page; name a file that ends in .html")
    view = unit_view(registry, unit, revision)
    write_text(out, why_page(view, script=True))
    return view


def explain_units(registry: Registry, lot_id: str, serials: list[str], folder: Path) -> None:
    """Write one page a unit into a folder, and the drawing script they share."""
    write_text(folder / SCRIPT, get_plotlyjs())
    for serial in serials:
        write_text(folder / f"{serial}.html", why_page(unit_view(registry, UnitKey(lot_id, serial)), script=SCRIPT))


def why_page(view: UnitView, script: bool | str) -> str:
    """Return the figure as a page; `script` True holds the drawing script, a name refers to it."""
    figure = why_figure(view, palette("light"), partial(text, "en"))
    return str(figure.to_html(include_plotlyjs=script, config={"displaylogo": False}))


def why_json(view: UnitView) -> dict[str, object]:
    """Return the numbers behind the verdict as JSON values: schema `softcal.explain/1`."""
    explanation, state = view.explanation, view.stored.state
    decision, fit = state.decision, state.fit
    low, middle, high = explanation.forecast
    return {
        "schema": "softcal.explain/1",
        "serial": view.calibration.serial,
        "revision": view.stored.revision,
        "verdict": str(decision.verdict),
        "predicted": _judgement_json(decision.predicted),
        "measured": None if decision.measured is None else _judgement_json(decision.measured),
        "reasons": [str(why) for why in decision.reasons],
        "knowledge": str(state.knowledge),
        "method": {"id": fit.method.id, "numbers": dict(fit.method.to_json())},
        "predicted_rmse": middle,
        "predicted_interval": [low, high],
        "limit_rmse": explanation.limit,
        "contributions": dict(explanation.contributions),
        "fit": {name: value for name, value in fit_to_json(fit).content.items() if name != "fitted"},
        "state": adjustments_to_json(state),
    }


def _judgement_json(judgement: Judgement) -> dict[str, object]:
    return {"verdict": str(judgement.verdict), "reasons": [one.to_json() for one in judgement.reasons]}
