"""What is told of a lot: its report, as a page and as a PDF, and lots side by side."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

from softcal.app.texts.reasons import Translator, render_plain_reason, render_reasons
from softcal.app.views.common import number, percent, render_limit
from softcal.app.views.lot import LotView
from softcal.app.views.lot_runs import FROM_FILE
from softcal.core.quality.yields import Share
from softcal.db.entries import UnitEntry

MAX_ROWS = 40
"""Rows of a table about some of the units; the registry has all."""


MAX_LOTS = 6
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


def report_values(view: LotView, translate: Translator) -> dict[str, str]:
    """Return the numbers of a lot by name."""
    unit, process, chosen = view.lot.reference_unit, view.process, view.chosen
    measured = [row.after_rmse for row in view.audited if row.after_rmse is not None]
    return {
        translate("source.model"): view.lot.sensor_model or "–",
        translate("compare.days"): f"{view.days[0].name} – {view.days[-1].name}" if view.days else "–",
        translate("lot.units"): f"{view.decided} / {view.total}",
        **{translate(f"verdict.{word}"): str(view.counts[word]) for word in view.counts if word != "none"},
        translate("lot.first_pass"): _render_share(view.yields.first_pass),
        translate("lot.yield"): _render_share(view.yields.last_pass),
        translate("lot.limit"): render_limit(view.limit, translate),
        translate("lot.predicted"): number(view.median_predicted, unit, view.limit_rmse),
        translate("lot.audited"): str(len(measured)),
        translate("compare.measured"): number(sorted(measured)[len(measured) // 2], unit, view.limit_rmse)
        if measured
        else "–",
        translate("lot.ratio"): number(view.after_to_own),
        "Cpk": number(process.capability.cpk) if process.capability else "–",
        translate("compare.first_reason"): render_plain_reason(view.reasons[0][0], translate) if view.reasons else "–",
        **({} if chosen is None else {translate("lot.filter"): translate("report.filtered", count=len(chosen))}),
    }


def lot_rows(views: Sequence[LotView], translate: Translator) -> list[dict[str, str]]:
    """Return several lots side by side: one row a fact under their names."""
    columns = {view.lot.id: report_values(view, translate) for view in views}
    names = list(next(iter(columns.values()))) if columns else []
    return [
        {translate("compare.fact.lot"): name, **{lot: values[name] for lot, values in columns.items()}}
        for name in names
    ]


def report_parts(view: LotView, units: Sequence[UnitEntry], title: str, translate: Translator) -> Iterator[ReportPart]:
    """Give the sections from top to bottom; `units` are listed one by one under `title`."""
    count, unit, error = translate("chart.count"), view.lot.reference_unit, partial(number, limit=view.limit_rmse)
    identity_titles = [translate("column.serial"), translate("column.verdict")]
    errors = [f"{translate(f'column.{name}')}, {unit}" for name in ("predicted", "before", "after", "own")]
    yield ReportPart(translate("lot.distribution"), "errors")
    if len(view.days) + len(view.stations) > 0:
        rows = [
            (
                translate(f"lot.yield.{kind}"),
                one.name if one.name != FROM_FILE else translate("lot.yield.desk"),
                _render_share(one.share),
                f"{one.share.count} / {one.share.of}",
            )
            for kind, groups in (("days", view.days), ("stations", view.stations), ("operators", view.operators))
            for one in groups[-MAX_ROWS:]
        ]
        header = ("", "", translate("lot.first_pass"), count)
        yield ReportPart(translate("report.yields"), "", header, rows, (0.34, *[0.22] * 3))
    if view.process.chart is not None:
        yield ReportPart(translate("lot.process"), "process")
    if view.reasons:
        reason_rows = [(render_plain_reason(reason, translate), str(number)) for reason, number in view.reasons]
        yield ReportPart(
            translate("lot.reasons"), "reasons", (translate("column.reasons"), count), reason_rows, (0.86, 0.14)
        )
    if view.audited:
        worst = sorted(view.audited, key=lambda row: -(row.after_rmse or 0.0))[:MAX_ROWS]
        scored = [(row.serial, translate(f"verdict.{row.verdict}"), *map(error, row.errors)) for row in worst]
        yield ReportPart(translate("lot.scores"), "", [*identity_titles, *errors], scored, (0.2, *[0.16] * 5))
    if units:
        titles = [*identity_titles, *errors, translate("column.family"), translate("column.reasons")]
        shares = (0.12, 0.12, *[0.08] * 4, 0.1, 0.34)
        listed = []
        for one in units:
            verdict, reasons = translate(f"verdict.{one.verdict or 'none'}"), render_reasons(one.reasons, translate)
            listed.append([one.serial, verdict, *map(error, one.errors), one.family or "–", reasons])
        yield ReportPart(title, "", titles, listed, shares)


def _render_share(share: Share) -> str:
    low, high = share.interval
    if share.value is None:
        return "–"
    return f"{percent(share.value)} ({percent(low)} – {percent(high)})"
