"""One page per lot: verdicts, errors, the process, why units did not pass, every unit.

A standalone HTML file: the plotting library is inside, nothing is loaded from elsewhere.
"""

from collections.abc import Iterable, Sequence
from html import escape

import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

from softcal.app.charts.lot import audit_scores, control_chart_figure, predicted_errors, reasons_pareto
from softcal.app.charts.palette import FONTS, palette
from softcal.app.charts.style import Words
from softcal.app.texts.reasons import all_said
from softcal.app.views.common import limit_said, number, percent
from softcal.app.views.lot import LotView
from softcal.db.entries import UnitEntry


def lot_page(view: LotView, units: Sequence[UnitEntry], words: Words, made: str) -> str:
    """Return the page of a lot as HTML.

    Args:
        view: the lot at a glance.
        units: every target unit.
        words: the texts of one language.
        made: when and with what it was made, in words.
    """
    colours, unit = palette(None), view.lot.reference_unit
    figures = [_section(words("lot.distribution"), _figure(predicted_errors(view, colours, words)))]
    if view.audited:
        figures.append(_section(words("lot.scores"), _figure(audit_scores(view, colours, words))))
    if view.process.chart is not None:
        figures.append(
            _section(words("lot.process"), _figure(control_chart_figure(view.process, unit, colours, words)))
        )
    if view.reasons:
        figures.append(_section(words("lot.reasons"), _figure(reasons_pareto(view, colours, words))))
    head = (
        f"<header><h1>{escape(view.lot.id)}</h1><p>{escape(view.lot.sensor_model)}</p>"
        f"<dl>{''.join(_fact(name, value) for name, value in _facts(view, words))}</dl><p>{escape(made)}</p></header>"
    )
    table = _section(words("lot.table"), _table(_header(unit, words), (_row(entry, words) for entry in units)))
    return _DOCUMENT.format(
        fonts=FONTS,
        title=escape(f"softcal: {view.lot.id}"),
        script=get_plotlyjs(),
        body="\n".join([head, *figures, table]),
    )


def _facts(view: LotView, words: Words) -> list[tuple[str, str]]:
    unit = view.lot.reference_unit
    counts = [(words(f"verdict.{word}"), str(count)) for word, count in view.counts.items() if count]
    return [
        (words("lot.units"), f"{view.judged} / {view.total}"),
        *counts,
        (words("lot.first_pass"), percent(view.yields.first_pass.value)),
        (words("lot.yield"), percent(view.yields.last_pass.value)),
        (words("lot.predicted"), number(view.median_predicted, unit)),
        (words("lot.limit"), limit_said(view.limit, words)),
        (words("lot.audited"), str(len(view.audited))),
    ]


def _fact(name: str, value: str) -> str:
    return f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>"


def _header(unit: str, words: Words) -> list[str]:
    errors = [f"{words(f'column.{name}')} [{unit}]" for name in ("predicted", "before", "after", "own")]
    return [words("column.serial"), words("column.verdict"), *errors, words("column.family"), words("column.reasons")]


def _row(entry: UnitEntry, words: Words) -> list[str]:
    errors = (entry.predicted_rmse, entry.before_rmse, entry.after_rmse, entry.own_rmse)
    verdict = words(f"verdict.{entry.verdict or 'none'}")
    return [
        entry.serial,
        verdict,
        *(number(value) if value is not None else "–" for value in errors),
        entry.family or "–",
        all_said(entry.reasons, words),
    ]


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    head = "".join(f"<th>{escape(cell)}</th>" for cell in header)
    body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _section(title: str, content: str) -> str:
    return f"<section><h2>{escape(title)}</h2>{content}</section>"


def _figure(figure: go.Figure) -> str:
    return str(
        figure.to_html(full_html=False, include_plotlyjs=False, config={"displaylogo": False, "displayModeBar": False})
    )


_DOCUMENT = """<!doctype html>
<html><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
body {{ font: 15px/1.5 {fonts}; color: #1c2733;
  background: #eef1f4; margin: 0; }}
main {{ max-width: 1080px; margin: 0 auto; padding: 24px 16px 64px; }}
header, section {{ background: #fff; border: 1px solid #d8dee4; border-radius: 10px; padding: 18px 24px;
  margin: 0 0 16px; overflow-x: auto; }}
h1 {{ font-size: 26px; margin: 0; }} h2 {{ font-size: 18px; margin: 0 0 10px; }} p {{ margin: 4px 0; color: #55606c; }}
dl {{ display: flex; flex-wrap: wrap; gap: 8px 32px; margin: 12px 0; }}
dt {{ color: #55606c; font-size: 13px; }} dd {{ margin: 0; font-size: 20px; }}
table {{ border-collapse: collapse; width: 100%; font-size: 14px; }}
th, td {{ text-align: left; padding: 6px 10px; border-bottom: 1px solid #e4e8ec; vertical-align: top; }}
th {{ color: #55606c; font-weight: 600; }}
@media print {{ section {{ break-inside: avoid; }} body {{ background: #fff; }} }}
</style>
<script>{script}</script>
</head><body><main>{body}</main></body></html>
"""
