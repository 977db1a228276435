"""A lot into figures: predicted errors, control chart, reasons, yields."""

import math
from collections.abc import Sequence
from typing import Any
from unicodedata import east_asian_width

import numpy as np
import plotly.graph_objects as go

from softcal.app.charts import style
from softcal.app.charts.palette import VERDICT_HATCH, VERDICT_INK, VERDICT_MARK, Palette
from softcal.app.texts.reasons import Translator, render_plain_reason
from softcal.app.views.common import axis_end, number
from softcal.app.views.lot import LotView
from softcal.app.views.lot_runs import FROM_FILE, YieldAt
from softcal.core.quality.control_chart import MAX_FAR_SHARE

BINS = 48
MAX_VALUES = 300
"""So many of the newest values are shown; limits and rules come from all."""

MAX_REASONS = 8
MAX_SIGMA = 8.0
"""So far from the centre a control chart is drawn."""

LEVEL_COLOURS = ("limit", "text", "limit")


def predicted_errors(view: LotView, colours: Palette, translate: Translator) -> go.Figure:
    """Draw the predicted errors by verdict, with the limit; the last bar holds all beyond."""
    every = view.predicted()
    figure = go.Figure()
    top = axis_end(every, view.limit_rmse)
    edges = np.linspace(0.0, top, BINS + 1)
    for verdict, colour in colours.verdict.items():
        counts, _ = np.histogram(np.minimum(view.predicted(verdict), top), edges)
        if counts.any():
            name, hatch = f"{VERDICT_MARK[verdict]} {translate(f'verdict.{verdict}')}", VERDICT_HATCH[verdict]
            look = {
                "color": colour,
                "pattern": {"shape": hatch, "solidity": 0.2, "fillmode": "overlay", "fgcolor": VERDICT_INK},
            }
            figure.add_bar(x=edges[:-1], y=counts, width=edges[1], offset=0, name=name, marker=look)
    figure.update_layout(barmode="stack", showlegend=True)
    style.integer_ticks(figure, float(np.histogram(np.minimum(every, top), edges)[0].max(initial=0)))
    # Without a step of their own the ticks would follow the bars, at odd numbers.
    figure.update_xaxes(range=[0.0, top + edges[1]], dtick=style.nice_step(top), tick0=0)
    if view.limit_rmse is not None:
        note: dict[str, Any] = {"text": translate("chart.limit"), "font": {"color": colours.limit, "size": 12}}
        note |= {"yref": "paper", "y": 1.0, "yanchor": "bottom", "xanchor": "left"}
        figure.add_vline(view.limit_rmse, line={"color": colours.limit, "width": 2}, annotation=note)
    title, beyond = f"{translate('column.predicted')} [{view.lot.reference_unit}]", int(np.sum(every > top))
    if beyond:
        # Over the bars it would meet the line of the limit where the figure is narrow.
        value = number(top, view.lot.reference_unit, view.limit_rmse)
        text = translate("chart.beyond", count=beyond, value=value)
        title = f"{title} · {text}"
    return style.apply_style(figure, colours, title, translate("chart.count"))


def control_chart_figure(view: LotView, colours: Palette, translate: Translator) -> go.Figure:
    """Draw the errors of the newest accepted units on a log scale; where a rule is broken first stands out."""
    process, unit, limit = view.process, view.lot.reference_unit, view.limit_rmse
    first = max(0, len(process.errors) - MAX_VALUES)
    at, values, names = np.arange(len(process.errors)) + 1, process.errors, process.serials
    figure = go.Figure()
    # One value far out would squeeze all others: it stands at the edge, with its number.
    lower, centre, upper = process.levels
    wide = (upper / centre) ** (MAX_SIGMA / 3)
    clipped = np.clip(values, centre / wide, centre * wide)
    if np.mean(clipped != values) > MAX_FAR_SHARE:
        clipped = values
    line, marker = {"color": colours.source, "width": 1}, {"color": colours.source, "size": 5}
    texts = [number(value, unit, limit) for value in values]
    hover = "%{text}: %{customdata}<extra></extra>"
    trace_style = {
        "text": names[first:],
        "mode": "lines+markers",
        "line": line,
        "marker": marker,
        "hovertemplate": hover,
    }
    figure.add_scatter(x=at[first:], y=clipped[first:], customdata=texts[first:], **trace_style)
    for k in np.flatnonzero(clipped != values).tolist():
        if k >= first:
            mark = "↑" if values[k] > clipped[k] else "↓"
            note_position = {
                "x": at[k],
                "y": math.log10(clipped[k]),
                "xanchor": "right",
                "xshift": -8,
                "showarrow": False,
            }
            figure.add_annotation(
                text=f"{number(values[k], limit=limit)} {mark}",
                font={"color": colours.limit, "size": 12},
                **note_position,
            )
    rules: dict[int, list[str]] = {}
    for broken in process.broken:
        for k in broken.starts:
            if broken.forbids and k >= first:
                rules.setdefault(k, []).append(translate(f"rule.{broken.rule}"))
    text = [f"{names[k]}: {', '.join(rule_names)}" for k, rule_names in rules.items()]
    look: dict[str, Any] = {"symbol": "diamond", "text": text, "hovertemplate": "%{text}<extra></extra>"}
    style.dots(figure, [k + 1 for k in rules], [clipped[k] for k in rules], colours.limit, None, 10, **look)
    for level, colour, dash in zip((lower, centre, upper), LEVEL_COLOURS, ("dash", "solid", "dash"), strict=True):
        ink = getattr(colours, colour)
        figure.add_hline(level, line={"color": ink, "width": 1.5, "dash": dash})
        # Plotly takes a note's height on such an axis as its logarithm.
        note_position = {"x": 1.0, "xref": "paper", "xanchor": "right", "y": math.log10(level), "yanchor": "bottom"}
        figure.add_annotation(
            text=number(level, limit=limit), font={"color": ink, "size": 12}, showarrow=False, **note_position
        )
    style.apply_style(figure, colours, translate("chart.order"), f"{translate('column.predicted')} [{unit}]")
    ticks = style.log_ticks(clipped.min(), clipped.max())
    figure.update_yaxes(type="log", tickvals=ticks, ticktext=[f"{tick:.3g}" for tick in ticks])
    return figure.update_layout(showlegend=False, margin_t=20)


def reasons_pareto(view: LotView, colours: Palette, translate: Translator) -> go.Figure:
    """Draw why units did not pass, the most frequent on top, with the running share."""
    frequent = view.reasons[:MAX_REASONS]
    counts = np.array([count for _, count in frequent], dtype=float)
    every = sum(count for _, count in view.reasons)
    running = np.cumsum(counts) / every
    names = [_wrap(render_plain_reason(reason, translate)) for reason, _ in frequent]
    labels = [f"{count:.0f}  ({share:.0%})" for count, share in zip(counts, running, strict=True)]
    figure = go.Figure(go.Bar(x=counts, y=names, text=labels, marker_color=colours.source, **style.LEVEL_BARS))
    figure.update_yaxes(autorange="reversed")
    end = 2.2 * counts.max()
    figure.update_xaxes(range=[0, end], tickformat="d", dtick=max(1, style.nice_step(end)))
    height = max(style.HEIGHT, 100 + sum(18 * (2 + name.count("<br>")) for name in names))
    return style.apply_style(figure, colours, translate("chart.count_running"), "", height).update_layout(
        showlegend=False
    )


def _wrap(reason: str, width: int = 30) -> str:
    """Break a sentence into lines of so many Latin letters; a Korean one is as wide as two."""
    lines, line = [], ""
    for word in reason.split():
        if line and sum(2 if east_asian_width(letter) in "WF" else 1 for letter in f"{line} {word}") > width:
            lines.append(line)
            line = word
        else:
            line = f"{line} {word}".strip()
    return "<br>".join([*lines, line])


WITH_COUNTS = 8
"""Up to so many bars say how many units they are of; more would be written over one another."""


def yield_figure(groups: Sequence[YieldAt], title: str, colours: Palette, translate: Translator) -> go.Figure:
    """Draw the yield at each place with its 95 % interval and the number of units."""
    names = [group.name if group.name != FROM_FILE else translate("lot.yield.desk") for group in groups]
    shares = [group.share for group in groups]
    counts = [translate("lot.yield.count", good=share.count, of=share.of) for share in shares]
    value = [100 * (share.value or 0.0) for share in shares]
    up = [100 * share.interval[1] - at for share, at in zip(shares, value, strict=True)]
    down = [at - 100 * share.interval[0] for share, at in zip(shares, value, strict=True)]
    spread = {"array": up, "arrayminus": down, "color": colours.text, "thickness": 1.5, "width": 5}
    hover = "%{x}: %{y:.1f} % (%{customdata})<extra></extra>"
    look = {"width": 0.6 if len(groups) > 2 else 0.25, "marker_color": colours.verdict["none"], "error_y": spread}
    figure = go.Figure(go.Bar(x=names, y=value, customdata=counts, hovertemplate=hover, **look))
    if len(groups) <= WITH_COUNTS:
        labels = [f"{name}<br>{count}" for name, count in zip(names, counts, strict=True)]
        figure.update_xaxes(tickmode="array", tickvals=names, ticktext=labels)
    figure.update_xaxes(type="category").update_yaxes(range=[0, 104], dtick=20)
    style.apply_style(figure, colours, title, f"{translate('lot.first_pass')} [%]")
    return figure.update_layout(showlegend=False, margin_t=20)


PICTURES = {"errors": predicted_errors, "process": control_chart_figure, "reasons": reasons_pareto}
"""Of the report of a lot, by name."""
