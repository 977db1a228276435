"""What is told of a lot: its report, as a page and as a PDF, and lots side by side."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

from softcal.app.texts.reasons import Words, all_said, plainly
from softcal.app.views.common import limit_said, number, percent
from softcal.app.views.lot import LotView
from softcal.app.views.lot_runs import DESK
from softcal.core.quality.yields import Share
from softcal.db.entries import UnitEntry

MOST_ROWS = 40
"""Rows of a table about some of the units; the registry has all."""


MOST_LOTS = 6
"""So many stand side by side."""


@dataclass(frozen=True)
class ReportPart:
    """A section of the report: a table, and the picture that says the same or alone.

    Args:
        picture: errors, process or reasons; "" for none.
        shares: of the page's width, by column.
    """

    title: str
    picture: str = ""
    header: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()
    shares: Sequence[float] = ()


def report_facts(view: LotView, words: Words) -> dict[str, str]:
    """Return the numbers of a lot by name."""
    unit, process, chosen = view.lot.reference_unit, view.process, view.chosen
    measured = [row.after_rmse for row in view.audited if row.after_rmse is not None]
    return {
        words("source.model"): view.lot.sensor_model or "–",
        words("compare.days"): f"{view.days[0].name} – {view.days[-1].name}" if view.days else "–",
        words("lot.units"): f"{view.judged} / {view.total}",
        **{words(f"verdict.{word}"): str(view.counts[word]) for word in view.counts if word != "none"},
        words("lot.first_pass"): _said(view.yields.first_pass),
        words("lot.yield"): _said(view.yields.last_pass),
        words("lot.limit"): limit_said(view.limit, words),
        words("lot.predicted"): number(view.median_predicted, unit, view.limit_rmse),
        words("lot.audited"): str(len(measured)),
        words("compare.measured"): number(sorted(measured)[len(measured) // 2], unit, view.limit_rmse)
        if measured
        else "–",
        words("lot.ratio"): number(view.after_to_own),
        "Cpk": number(process.capability.cpk) if process.capability else "–",
        words("compare.first_reason"): plainly(view.reasons[0][0], words) if view.reasons else "–",
        **({} if chosen is None else {words("lot.filter"): words("report.filtered", count=len(chosen))}),
    }


def lot_rows(views: Sequence[LotView], words: Words) -> list[dict[str, str]]:
    """Return several lots side by side: one row a fact under their names."""
    columns = {view.lot.id: report_facts(view, words) for view in views}
    names = list(next(iter(columns.values()))) if columns else []
    return [{words("compare.fact.lot"): name, **{lot: facts[name] for lot, facts in columns.items()}} for name in names]


def report_parts(view: LotView, units: Sequence[UnitEntry], title: str, words: Words) -> Iterator[ReportPart]:
    """Give the sections from top to bottom; `units` are listed one by one under `title`."""
    count, unit, error = words("chart.count"), view.lot.reference_unit, partial(number, limit=view.limit_rmse)
    named = [words("column.serial"), words("column.verdict")]
    errors = [f"{words(f'column.{name}')}, {unit}" for name in ("predicted", "before", "after", "own")]
    yield ReportPart(words("lot.distribution"), "errors")
    if len(view.days) + len(view.stations) > 0:
        rows = [
            (
                words(f"lot.yield.{kind}"),
                one.name if one.name != DESK else words("lot.yield.desk"),
                _said(one.share),
                f"{one.share.count} / {one.share.of}",
            )
            for kind, groups in (("days", view.days), ("stations", view.stations), ("operators", view.operators))
            for one in groups[-MOST_ROWS:]
        ]
        header = ("", "", words("lot.first_pass"), count)
        yield ReportPart(words("report.yields"), "", header, rows, (0.34, *[0.22] * 3))
    if view.process.chart is not None:
        yield ReportPart(words("lot.process"), "process")
    if view.reasons:
        why = [(plainly(reason, words), str(number)) for reason, number in view.reasons]
        yield ReportPart(words("lot.reasons"), "reasons", (words("column.reasons"), count), why, (0.86, 0.14))
    if view.audited:
        worst = sorted(view.audited, key=lambda row: -(row.after_rmse or 0.0))[:MOST_ROWS]
        scored = [(row.serial, words(f"verdict.{row.verdict}"), *map(error, row[2:])) for row in worst]
        yield ReportPart(words("lot.scores"), "", [*named, *errors], scored, (0.2, *[0.16] * 5))
    if units:
        titles = [*named, *errors, words("column.family"), words("column.reasons")]
        shares = (0.12, 0.12, *[0.08] * 4, 0.1, 0.34)
        listed = []
        for one in units:
            measured = map(error, (one.predicted_rmse, one.before_rmse, one.after_rmse, one.own_rmse))
            verdict = words(f"verdict.{one.verdict or 'none'}")
            listed.append([one.serial, verdict, *measured, one.family or "–", all_said(one.reasons, words)])
        yield ReportPart(title, "", titles, listed, shares)


def _said(share: Share) -> str:
    low, high = share.interval
    if share.value is None:
        return "–"
    return f"{percent(share.value)} ({percent(low)} – {percent(high)})"
