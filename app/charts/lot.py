"""A lot into figures: predicted errors, audited scores, control chart, reasons, yields."""

from collections.abc import Sequence
from typing import Any
from unicodedata import east_asian_width

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from softcal.app.charts import style
from softcal.app.charts.palette import VERDICT_HATCH, VERDICT_INK, VERDICT_MARK, Palette
from softcal.app.texts.reasons import Words, plainly
from softcal.app.views.common import far_end
from softcal.app.views.lot import LotView, ProcessView
from softcal.app.views.lot_runs import DESK, YieldAt
from softcal.core.quality.control_chart import FORBIDDING

BINS = 48
SHOWN_VALUES = 300
"""So many of the newest values are shown; limits and rules come from all."""

MOST_BARS = 24
"""Up to so many audited units have bars with their serials; more are ranked."""

MOST_REASONS = 8


def predicted_errors(view: LotView, colours: Palette, words: Words) -> go.Figure:
    """Draw the predicted errors by verdict, with the limit; the last bar holds all beyond."""
    every = view.predicted()
    figure = go.Figure()
    top = far_end(every, view.limit_rmse)
    edges = np.linspace(0.0, top, BINS + 1)
    for verdict, colour in colours.verdict.items():
        counts, _ = np.histogram(np.minimum(view.predicted(verdict), top), edges)
        if counts.any():
            name, hatch = f"{VERDICT_MARK[verdict]} {words(f'verdict.{verdict}')}", VERDICT_HATCH[verdict]
            look = {
                "color": colour,
                "pattern": {"shape": hatch, "solidity": 0.2, "fillmode": "overlay", "fgcolor": VERDICT_INK},
            }
            figure.add_bar(x=edges[:-1], y=counts, width=edges[1], offset=0, name=name, marker=look)
    figure.update_layout(barmode="stack")
    style.whole_numbers(figure, float(np.histogram(np.minimum(every, top), edges)[0].max(initial=0)))
    # Without a step of their own the ticks would follow the bars, at odd numbers.
    figure.update_xaxes(range=[0.0, top + edges[1]], dtick=style.nice_step(top), tick0=0)
    if view.limit_rmse is not None:
        note: dict[str, Any] = {"text": words("chart.limit"), "font": {"color": colours.limit, "size": 12}}
        note |= {"yref": "paper", "y": 1.0, "yanchor": "bottom", "xanchor": "left"}
        figure.add_vline(view.limit_rmse, line={"color": colours.limit, "width": 2}, annotation=note)
    title, beyond = f"{words('column.predicted')} [{view.lot.reference_unit}]", int(np.sum(every > top))
    if beyond:
        # Over the bars it would meet the line of the limit where the figure is narrow.
        text = words("chart.beyond", count=beyond, value=f"{top:.3g} {view.lot.reference_unit}")
        title = f"{title} · {text}"
    return style.styled(figure, colours, title, words("chart.count"))


def audit_scores(view: LotView, colours: Palette, words: Words) -> go.Figure:
    """Draw before, after and own of every audited unit; of many in the order of their error."""
    audited = sorted(view.audited, key=lambda row: row.after_rmse or 0.0) if _is_many(view) else view.audited
    figure = go.Figure()
    series = (("before", colours.raw), ("after", colours.mapped), ("own", colours.source))
    for name, colour in series:
        values = [getattr(row, f"{name}_rmse") for row in audited]
        if not any(value is not None for value in values):
            continue
        if _is_many(view):
            style.dots(figure, None, values, colour, words(f"chart.{name}"))
        else:
            bars = [row.serial for row in audited]
            figure.add_bar(x=bars, y=values, name=words(f"chart.{name}"), marker_color=colour)
    title = words("chart.rank") if _is_many(view) else words("column.serial")
    figure.update_xaxes(type="linear" if _is_many(view) else "category").update_yaxes(rangemode="tozero")
    return style.styled(figure, colours, title, f"RMSE [{view.lot.reference_unit}]")


def _is_many(view: LotView) -> bool:
    return len(view.audited) > MOST_BARS


def control_chart_figure(process: ProcessView, unit: str, colours: Palette, words: Words) -> go.Figure:
    """Draw values and moving ranges of the newest units; broken rules stand out."""
    chart = process.chart
    if chart is None:
        raise ValueError("no control chart without values")
    first = max(0, len(chart.values) - SHOWN_VALUES)
    at = np.arange(first, len(chart.values)) + 1
    figure = make_subplots(rows=2, shared_xaxes=True, vertical_spacing=0.06, row_heights=[0.66, 0.34])
    names = list(process.serials[first:])
    line, marker = {"color": colours.source, "width": 1}, {"color": colours.source, "size": 5}
    ranges = np.concatenate([[np.nan], chart.moving_ranges])
    for row, (values, digits) in enumerate(((chart.values, 4), (ranges, 3)), 1):
        hover = f"%{{text}}: %{{y:.{digits}g}} {unit}<extra></extra>"
        shown = {"text": names, "mode": "lines+markers", "line": line, "marker": marker, "hovertemplate": hover}
        figure.add_scatter(x=at, y=values[first:], **shown, row=row, col=1)
    rules: dict[int, list[int]] = {}
    for signal in chart.signals:
        if signal.index >= first and signal.rule in FORBIDDING:
            rules.setdefault(signal.index, []).append(signal.rule)
    text = [f"{names[k - first]}: {', '.join(words(f'rule.{n}') for n in broken)}" for k, broken in rules.items()]
    look: dict[str, Any] = {"symbol": "diamond", "text": text, "hovertemplate": "%{text}<extra></extra>"}
    style.dots(figure, [k + 1 for k in rules], [chart.values[k] for k in rules], colours.limit, None, 10, 1, **look)
    style.level_line(figure, chart.centre, colours.text, f"{chart.centre:.3g}")
    for limit in (chart.lower, chart.upper):
        style.level_line(figure, limit, colours.limit, f"{limit:.3g}", dash="dash")
    style.level_line(figure, chart.range_upper, colours.limit, f"{chart.range_upper:.3g}", row=2, dash="dash")
    style.axis_titles(figure, 1, f"{words('column.predicted')} [{unit}]")
    style.axis_titles(figure, 2, f"{words('chart.range')} [{unit}]", words("chart.order"))
    figure.update_yaxes(rangemode="tozero", row=2, col=1)
    return style.coloured(figure, colours, 420).update_layout(showlegend=False, margin_t=20)


def reasons_pareto(view: LotView, colours: Palette, words: Words) -> go.Figure:
    """Draw why units did not pass, the most frequent on top, with the running share."""
    shown = view.reasons[:MOST_REASONS]
    counts = np.array([count for _, count in shown], dtype=float)
    every = sum(count for _, count in view.reasons)
    running = np.cumsum(counts) / every
    names = [_wrapped(plainly(reason, words)) for reason, _ in shown]
    labels = [f"{count:.0f}  ({share:.0%})" for count, share in zip(counts, running, strict=True)]
    figure = go.Figure(go.Bar(x=counts, y=names, text=labels, marker_color=colours.source, **style.LEVEL_BARS))
    figure.update_yaxes(autorange="reversed")
    figure.update_xaxes(range=[0, 2.2 * counts.max()], tickformat="d", dtick=max(1, style.nice_step(counts.max())))
    height = max(style.HEIGHT, 100 + sum(18 * (2 + name.count("<br>")) for name in names))
    return style.styled(figure, colours, words("chart.count_running"), "", height).update_layout(showlegend=False)


def _wrapped(reason: str, width: int = 30) -> str:
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


def yield_figure(places: Sequence[YieldAt], title: str, colours: Palette, words: Words) -> go.Figure:
    """Draw the yield at each place with its 95 % interval and the number of units."""
    names = [place.name if place.name != DESK else words("lot.yield.desk") for place in places]
    shares = [place.share for place in places]
    counts = [words("lot.yield.count", good=share.count, of=share.of) for share in shares]
    value = [100 * (share.value or 0.0) for share in shares]
    up = [100 * share.interval[1] - at for share, at in zip(shares, value, strict=True)]
    down = [at - 100 * share.interval[0] for share, at in zip(shares, value, strict=True)]
    spread = {"array": up, "arrayminus": down, "color": colours.text, "thickness": 1.5, "width": 5}
    hover = "%{x}: %{y:.1f} % (%{customdata})<extra></extra>"
    look = {"width": 0.6 if len(places) > 2 else 0.25, "marker_color": colours.verdict["none"], "error_y": spread}
    figure = go.Figure(go.Bar(x=names, y=value, customdata=counts, hovertemplate=hover, **look))
    if len(places) <= WITH_COUNTS:
        labels = [f"{name}<br>{count}" for name, count in zip(names, counts, strict=True)]
        figure.update_xaxes(tickmode="array", tickvals=names, ticktext=labels)
    figure.update_xaxes(type="category").update_yaxes(range=[0, 104], dtick=20)
    style.styled(figure, colours, title, f"{words('lot.first_pass')} [%]")
    return figure.update_layout(showlegend=False, margin_t=20)
