"""Why a unit's verdict is what it is: one figure, on a screen or a page."""

import textwrap
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from plotly.offline import get_plotlyjs
from plotly.subplots import make_subplots

from softcal.app.charts.palette import VERDICT_MARK, Palette, palette
from softcal.app.charts.style import apply_theme, dots
from softcal.app.files.atomic import write_text
from softcal.app.texts.catalogue import text
from softcal.app.texts.reasons import Translator, render_reason, translate_phrase
from softcal.app.views.audited import AuditTrace
from softcal.app.views.common import limit_number, number, thinning_slice
from softcal.app.views.unit import UnitView, unit_view
from softcal.core.errors import InputError
from softcal.core.lot import UnitKey
from softcal.core.unit.explanation import contributions
from softcal.core.unit.state_json import adjustments_to_json, fit_to_json
from softcal.core.unit.verdict import Assessment
from softcal.db.registry import Registry

SCRIPT = "plotly.min.js"
"""Pages of one folder share this file beside them."""

HEIGHT = 860
WIDTH = 150
"""Characters of a line of reasons."""

MAX_REASONS = 5
POINTS = 1500
"""Dots of one panel."""

MIN_SHARE = 0.002
"""The smallest parts are left out, by which together the forecast falls by less than this share of the limit."""

PANELS = FIRST, SECOND, THIRD, FOURTH = tuple({"row": row, "col": column} for row in (1, 2) for column in (1, 2))


def explanation_figure(view: UnitView, colours: Palette, translate: Translator) -> go.Figure:
    """Draw verdict and reasons above the measurement where one decided, else above the parts of the forecast."""
    audit = view.audit
    names = (("parts",),) if audit is None else (("estimate", "error"), ("course", "loop"))
    titles = [translate(f"why.{name}") for row in names for name in row]
    shape, gaps = {"rows": len(names), "cols": len(names[0])}, {"horizontal_spacing": 0.1, "vertical_spacing": 0.14}
    figure = make_subplots(**shape, subplot_titles=titles, **gaps)
    if audit is None:
        _draw_forecast(figure, view, colours, translate)
    else:
        _draw_measurement(figure, view, audit, colours, translate)
    height = HEIGHT if audit is not None else HEIGHT // 2
    apply_theme(figure, colours, height)
    # A legend of its own inside each panel: one for all would be cut off in a narrow window.
    for k, panel in enumerate(PANELS[: len(titles)], 1):
        figure.for_each_trace(lambda trace, k=k: trace.update(legend=_numbered("legend", k)), **panel)
        x, y = (figure.layout[_numbered(axis, k)].domain for axis in ("xaxis", "yaxis"))
        position = {"x": x[0] + 0.01, "xanchor": "left", "y": y[1] - 0.01, "yanchor": "top"}
        if audit is None:
            # The bars are at the left, the limit at the right end.
            position["x"] = x[0] + 0.6 * (x[1] - x[0])
        look = {"bgcolor": colours.veil, "font": {"size": 11}, "xref": "paper", "yref": "paper", "orientation": "v"}
        figure.update_layout({_numbered("legend", k): {**position, **look}})
    decision = view.stored.state.decision
    badge = f"<b>{VERDICT_MARK[decision.verdict]} {translate(f'verdict.{decision.verdict}')}</b>"
    head = [f"<b>{view.state.serial}</b>  {badge}  {view.state.unit_map.family}"]
    for reason in decision.reasons[:MAX_REASONS]:
        head += textwrap.wrap(f"• {render_reason(reason, translate)}", WIDTH)
    return figure.update_annotations(font_size=14).update_layout(
        title={"text": "<br>".join(head), "x": 0.01, "y": 1, "yanchor": "top", "pad": {"t": 16}, "font": {"size": 14}},
        margin={"t": 60 + 21 * len(head), "l": 110, "r": 24, "b": 60},
        height=height + 21 * len(head),
    )


def _numbered(name: str, number: int) -> str:
    return name if number == 1 else f"{name}{number}"


def _draw_measurement(
    figure: go.Figure, view: UnitView, audit: AuditTrace, colours: Palette, translate: Translator
) -> None:
    """Draw estimate over reference, error over load and over time, each with the limit, and the loop."""
    unit, limit = view.lot.reference_unit, view.stored.state.limit.stated_rmse
    load = f"{view.lot.reference_quantity} [{unit}]"
    at, error = thinning_slice(audit.reference, POINTS), audit.estimate - audit.reference
    diagonal = np.array([audit.reference.min(), audit.reference.max()])
    x = np.concatenate([diagonal, diagonal[::-1]])
    band = {"fill": "toself", "fillcolor": colours.band, "line": {"width": 0}, "mode": "lines", "hoverinfo": "skip"}
    name = "" if limit is None else translate("chart.limit.both", limit=limit_number(limit, unit))
    if limit is not None:
        y = np.concatenate([diagonal + limit, (diagonal - limit)[::-1]])
        figure.add_scatter(x=x, y=y, name=name, **band, **FIRST)
    dots(figure, audit.reference[at], audit.estimate[at], colours.mapped, translate("chart.estimate"), 3, **FIRST)
    _titled(figure, FIRST, f"{translate('chart.reference')}: {load}", f"{translate('chart.estimate')} [{unit}]")
    for panel, abscissa, title in (
        (SECOND, audit.reference, load),
        (THIRD, audit.t_s, translate("chart.time")),
    ):
        dots(figure, abscissa[at], error[at], colours.mapped, translate("why.difference"), 3, **panel)
        if limit is not None:
            _key(figure, panel, name, colours.limit, "dash")
            for level in (-limit, limit):
                figure.add_hline(level, line={"color": colours.limit, "width": 1.5, "dash": "dash"}, **panel)
        _titled(figure, panel, title, f"{translate('chart.error')} [{unit}]")
    source = view.source
    for reference, output, colour, key in (
        (source.reference, source.unlabelled.output, colours.source, "chart.source"),
        (audit.reference, audit.output, colours.raw, "chart.raw"),
    ):
        rows = thinning_slice(reference, POINTS)
        dots(figure, reference[rows], output[rows], colour, translate(key), 3, **FOURTH)
    _titled(figure, FOURTH, load, f"{translate('chart.output')} [{view.lot.output_unit}]")


def _draw_forecast(figure: go.Figure, view: UnitView, colours: Palette, translate: Translator) -> None:
    """Draw the parts of the predicted error: they add in quadrature, so that each begins where those before it end."""
    state, unit = view.stored.state, view.lot.reference_unit
    forecast, unscaled, limit = state.forecast, state.fit.forecast, state.limit.stated_rmse
    every = contributions(state.fit)
    rising = np.sort([0.0, *every.values()])
    whole = float(np.hypot.reduce(rising))
    without = whole - np.sqrt(np.maximum(whole**2 - np.cumsum(rising**2), 0.0))
    largest = rising[without < MIN_SHARE * state.limit.maximum_rmse].max(initial=0.0)
    parts = [(name, value) for name, value in every.items() if value > largest]
    levels = np.sqrt(np.cumsum([value**2 for _, value in parts])) if parts else np.zeros(0)
    starts, ends = np.concatenate([[0.0], levels[:-1]]), levels
    if forecast.rmse != unscaled.rmse:
        parts.append(("audits", forecast.rmse - unscaled.rmse))
        starts, ends = np.append(starts, unscaled.rmse), np.append(ends, forecast.rmse)
    figure.add_bar(
        x=ends - starts,
        base=starts,
        y=[translate_phrase("part", name, translate) for name, _ in parts],
        orientation="h",
        marker_color=colours.source,
        customdata=[
            (number(value, unit, limit), translate_phrase("why.part", name, translate)) for name, value in parts
        ],
        hovertemplate="%{y}: %{customdata[0]}<br>%{customdata[1]}<extra></extra>",
        showlegend=False,
        **FIRST,
    )
    above, below = forecast.upper - forecast.rmse, forecast.rmse - forecast.lower
    spread = {"type": "data", "symmetric": False, "array": [above], "arrayminus": [below]}
    name = translate("column.predicted")
    dots(figure, [forecast.rmse], [name], colours.mapped, name, 12, symbol="diamond", error_x=spread, **FIRST)
    if limit is not None:
        figure.add_vline(limit, line={"color": colours.limit, "width": 2}, **FIRST)
        _key(figure, FIRST, translate("chart.limit.named", limit=limit_number(limit, unit)), colours.limit, "solid")
    _titled(figure, FIRST, f"{translate('chart.error')} [{unit}]", "")
    # Room behind the last of them, so that the line of the limit stands inside.
    figure.update_xaxes(range=[0.0, 1.05 * max(forecast.upper, limit or 0.0)], **FIRST)
    figure.update_yaxes(autorange="reversed", **FIRST)


def _key(figure: go.Figure, panel: Mapping[str, int], name: str, colour: str, dash: str) -> None:
    """Put a name into the legend: a line of no points."""
    line = {"color": colour, "dash": dash}
    figure.add_scatter(x=[None], y=[None], mode="lines", line=line, name=name, **panel)


def _titled(figure: go.Figure, panel: Mapping[str, int], x_title: str, y_title: str) -> None:
    figure.update_xaxes(title_text=x_title, title_standoff=6, **panel)
    figure.update_yaxes(title_text=y_title, title_standoff=6, automargin=True, **panel)


def explain_unit(registry: Registry, unit: UnitKey, out: Path, revision: int | None) -> UnitView:
    """Write the page of one unit, whole in itself; InputError unless `out` ends in .html."""
    if out.suffix.lower() != ".html":
        raise InputError(f"{out}: the figure is written as a page; name a file that ends in .html")
    view = unit_view(registry, unit, revision)
    write_text(out, explanation_page(view, script=True))
    return view


def explain_units(registry: Registry, lot_id: str, serials: list[str], folder: Path) -> None:
    """Write one page a unit into a folder, and the drawing script they share."""
    write_text(folder / SCRIPT, get_plotlyjs())
    for serial in serials:
        write_text(
            folder / f"{serial}.html", explanation_page(unit_view(registry, UnitKey(lot_id, serial)), script=SCRIPT)
        )


def explanation_page(view: UnitView, script: bool | str) -> str:
    """Return the figure as a page; `script` True holds the drawing script, a name refers to it."""
    figure = explanation_figure(view, palette("light"), partial(text, "en"))
    return str(figure.to_html(include_plotlyjs=script, config={"displaylogo": False}))


def explanation_json(view: UnitView) -> dict[str, object]:
    """Return the numbers behind the verdict as JSON values: schema `softcal.explain/1`."""
    state = view.stored.state
    decision, fit, forecast = state.decision, state.fit, state.forecast
    return {
        "schema": "softcal.explain/1",
        "serial": view.state.serial,
        "revision": view.stored.revision,
        "verdict": str(decision.verdict),
        "predicted": _verdict_json(decision.predicted),
        "measured": None if decision.measured is None else _verdict_json(decision.measured),
        "reasons": [str(reason) for reason in decision.reasons],
        "knowledge": str(state.correspondence),
        "method": {"id": fit.method.id, "numbers": dict(fit.method.to_json())},
        "predicted_rmse": forecast.rmse,
        "predicted_interval": [forecast.lower, forecast.upper],
        "limit_rmse": state.limit.stated_rmse,
        "contributions": contributions(fit),
        "fit": {name: value for name, value in fit_to_json(fit).content.items() if name != "fitted"},
        "state": adjustments_to_json(state),
    }


def _verdict_json(verdict: Assessment) -> dict[str, object]:
    return {"verdict": str(verdict.verdict), "reasons": [one.to_json() for one in verdict.reasons]}
