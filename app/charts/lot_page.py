"""One page per lot: verdicts, errors, the process, why units did not pass, every unit."""

from collections.abc import Sequence
from html import escape

from softcal.app.charts.lot import audit_scores, control_chart_figure, predicted_errors, reasons_pareto
from softcal.app.charts.page import document, figures, section, table
from softcal.app.charts.palette import palette
from softcal.app.charts.style import Words
from softcal.app.texts.reasons import all_said
from softcal.app.views.common import limit_said, number, percent
from softcal.app.views.lot import LotView
from softcal.db.entries import UnitEntry

STYLE = """p { margin: 4px 0; color: #55606c; }
dl { display: flex; flex-wrap: wrap; gap: 8px 32px; margin: 12px 0; }
dt { color: #55606c; font-size: 13px; } dd { margin: 0; font-size: 20px; }
"""


def lot_page(view: LotView, units: Sequence[UnitEntry], words: Words, made: str) -> str:
    """Return the page of a lot as HTML.

    Args:
        view: the lot at a glance.
        units: every target unit.
        words: the texts of one language.
        made: when and with what it was made, in words.
    """
    colours, unit = palette(None), view.lot.reference_unit
    drawn = [(words("lot.distribution"), predicted_errors(view, colours, words))]
    if view.audited:
        drawn.append((words("lot.scores"), audit_scores(view, colours, words)))
    if view.process.chart is not None:
        drawn.append((words("lot.process"), control_chart_figure(view.process, unit, colours, words)))
    if view.reasons:
        drawn.append((words("lot.reasons"), reasons_pareto(view, colours, words)))
    facts = "".join(
        f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>" for name, value in _facts(view, words)
    )
    head = (
        f"<header><h1>{escape(view.lot.id)}</h1><p>{escape(view.lot.sensor_model)}</p><dl>{facts}</dl>"
        f"<p>{escape(made)}</p></header>"
    )
    errors = [f"{words(f'column.{name}')} [{unit}]" for name in ("predicted", "before", "after", "own")]
    header = [words("column.serial"), words("column.verdict"), *errors, words("column.family"), words("column.reasons")]
    rows = table(header, ([escape(cell) for cell in _row(entry, words)] for entry in units))
    sections = [section(title, figures(figure)) for title, figure in drawn]
    return document(f"softcal: {view.lot.id}", [head, *sections, section(words("lot.table"), rows)], STYLE)


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
