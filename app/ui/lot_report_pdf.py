"""The report of a lot as a PDF for people: yields, errors, the process, why units did not pass, audits, bad units."""

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version

import numpy as np
from reportlab.lib.units import mm
from reportlab.platypus import Flowable, Paragraph, Spacer, Table

from softcal.app.export.certificates.fonts import BOLD, marked_up
from softcal.app.export.certificates.parts import (
    WIDTH,
    Document,
    document_pdf,
    facts_table,
    grid,
    paragraph,
    section,
    style,
)
from softcal.app.export.certificates.plots import Level, bars_plot, course_plot
from softcal.app.texts.catalogue import text
from softcal.app.texts.reasons import all_said, plainly
from softcal.app.views.common import far_end, limit_said, number, percent
from softcal.app.views.lot import NEEDS_A_LOOK, LotView
from softcal.app.views.lot_runs import DESK, YieldAt
from softcal.db.entries import UnitEntry
from softcal.db.registry import Registry
from softcal.db.truth.lot_pages import UnitFilter

BINS = 32
MOST_ROWS = 40
"""Rows of a table; the page says how many there are in all, and the registry has them."""


def lot_report_pdf(registry: Registry, view: LotView, language: str = "en", made: datetime | None = None) -> bytes:
    """Return the report of a lot, or of what a filter leaves of it.

    Args:
        made: when it is made, in the reader's time zone; now without.

    Raises:
        InputError: no font at hand can write the language.
    """
    say, now = partial(text, language), made or datetime.now(UTC)
    software = f"softcal {version('softcal')}"
    wanted = UnitFilter(NEEDS_A_LOOK, sort="severity", serials=view.chosen)
    bad = registry.unit_page(view.lot.id, wanted, size=MOST_ROWS)
    title = say("report.title", lot=view.lot.id)
    page = Document(
        title=title,
        author="",
        software=software,
        footer=f"{title}   {say('report.made', at=now, version=version('softcal'))}",
        made_on=now.date(),
        numbering=say("report.page", number="{number}", count="{count}"),
    )
    return document_pdf(list(_Report(view, say, bad.units, bad.total).story()), page)


class _Report:
    """The parts of one report in one language."""

    def __init__(self, view: LotView, say: partial[str], bad: Sequence[UnitEntry], of: int) -> None:
        self._view, self._say, self._bad, self._of = view, say, bad, of
        self._unit = view.lot.reference_unit

    def story(self) -> Iterator[Flowable]:
        """Give the parts from top to bottom."""
        say, view = self._say, self._view
        yield Paragraph(marked_up(say("report.title", lot=view.lot.id)), style(18, BOLD))
        yield Spacer(1, 3 * mm)
        yield facts_table(self._facts())
        yield from section(say("lot.distribution"), self._errors())
        if len(view.days) + len(view.stations) > 0:
            yield from section(say("report.yields"), self._yields())
        if view.process.chart is not None:
            yield from section(say("lot.process"), self._process())
        if view.reasons:
            rows = [(plainly(reason, say), str(count)) for reason, count in view.reasons]
            yield from section(say("lot.reasons"), self._table((say("column.reasons"), say("chart.count")), rows, 0.86))
        if view.audited:
            yield from section(say("lot.scores"), self._audited())
        if self._bad:
            yield from section(say("report.bad", shown=len(self._bad), of=self._of), self._not_passed())

    def _facts(self) -> list[tuple[str, str]]:
        say, view = self._say, self._view
        counts = ", ".join(f"{count} {say(f'verdict.{word}')}" for word, count in view.counts.items() if count)
        first, last = view.yields.first_pass, view.yields.last_pass
        rows = [
            (say("source.model"), view.lot.sensor_model or "–"),
            (say("lot.units"), f"{view.judged} / {view.total}: {counts}"),
            (
                say("lot.first_pass"),
                f"{percent(first.value)} ({percent(first.interval[0])} – {percent(first.interval[1])})",
            ),
            (say("lot.yield"), f"{percent(last.value)} ({percent(last.interval[0])} – {percent(last.interval[1])})"),
            (say("lot.predicted"), number(view.median_predicted, self._unit)),
            (say("lot.limit"), limit_said(view.limit, say)),
            (say("lot.audited"), str(len(view.audited))),
        ]
        if view.chosen is not None:
            rows.append((say("lot.filter"), say("report.filtered", count=len(view.chosen))))
        return rows

    def _errors(self) -> Flowable:
        view, limit = self._view, self._view.limit_rmse
        values = view.predicted()
        if not len(values):
            return paragraph("–")
        top = far_end(values, limit)
        counts, edges = np.histogram(np.minimum(values, top), BINS, (0.0, top))
        level = None if limit is None else Level(limit, self._say("chart.limit.named", limit=number(limit, self._unit)))
        labels = f"{self._say('column.predicted')}, {self._unit}", self._say("chart.count")
        return bars_plot(edges, counts.astype(float), level, labels, WIDTH)

    def _yields(self) -> Flowable:
        say, view = self._say, self._view
        rows = [
            (say(f"lot.yield.{kind}"), one.name if one.name != DESK else say("lot.yield.desk"), *_share(one))
            for kind, found in (("days", view.days), ("stations", view.stations), ("operators", view.operators))
            for one in found[-MOST_ROWS:]
        ]
        return self._table(("", "", say("lot.first_pass"), say("chart.count")), rows, 0.34)

    def _process(self) -> Flowable:
        chart = self._view.process.chart
        if chart is None:
            raise ValueError("no control chart without values")
        levels = [Level(chart.upper, number(chart.upper)), Level(chart.lower, number(chart.lower))]
        labels = self._say("chart.order"), f"{self._say('column.predicted')}, {self._unit}"
        return course_plot(chart.values, levels, labels, WIDTH)

    def _audited(self) -> Flowable:
        say = self._say
        worst = sorted(self._view.audited, key=lambda row: -(row.after_rmse or 0.0))[:MOST_ROWS]
        header = [say("column.serial"), say("column.verdict")]
        header += [f"{say(f'column.{name}')}, {self._unit}" for name in ("predicted", "before", "after", "own")]
        rows = [
            (row.serial, say(f"verdict.{row.verdict}"), *(number(value) for value in row[2:]))
            for row in worst
        ]  # fmt: skip
        return self._table(header, rows, 0.2)

    def _not_passed(self) -> Flowable:
        say = self._say
        rows = [
            (unit.serial, say(f"verdict.{unit.verdict}"), number(unit.predicted_rmse), all_said(unit.reasons[:2], say))
            for unit in self._bad
        ]
        header = (
            say("column.serial"),
            say("column.verdict"),
            f"{say('column.predicted')}, {self._unit}",
            say("column.reasons"),
        )
        cells = [[paragraph(cell, 7) for cell in row] for row in (header, *rows)]
        return Table(cells, colWidths=[WIDTH * share for share in (0.14, 0.12, 0.14, 0.6)], style=grid(7), repeatRows=1)

    def _table(self, header: Sequence[str], rows: Sequence[Sequence[str]], first: float) -> Flowable:
        others = (1 - first) / (len(header) - 1)
        widths = [WIDTH * first, *([WIDTH * others] * (len(header) - 1))]
        cells = [[paragraph(cell, 7) for cell in row] for row in (header, *rows)]
        return Table(cells, colWidths=widths, style=grid(7), repeatRows=1)


def _share(one: YieldAt) -> tuple[str, str]:
    low, high = one.share.interval
    return f"{percent(one.share.value)} ({percent(low)} – {percent(high)})", f"{one.share.count} / {one.share.of}"
