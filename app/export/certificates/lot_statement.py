"""The statement on a lot as one page for people: what is promised, on what evidence, at what risk, and what is not."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from functools import partial

from reportlab.lib.units import mm
from reportlab.platypus import Flowable, Paragraph, Spacer, Table

from softcal.app.export.certificates.archival import archival
from softcal.app.export.certificates.fonts import BOLD, PLAIN, has_all, marked_up
from softcal.app.export.certificates.parts import (
    WIDTH,
    Document,
    document_pdf,
    facts_table,
    grid,
    marked,
    paragraph,
    section,
    style,
)
from softcal.app.texts.catalogue import text
from softcal.app.texts.reasons import Words, said
from softcal.core.words.reason import Reason

GIVEN, NOT_GIVEN = "#1b7f3b", "#b3261e"
MOST_AUDITS, MOST_SERIALS = 14, 30
"""Rows and serials that fit one page; the rest stand in the registry, and the page says how many."""

ENGLISH: Words = partial(text, "en")


@dataclass(frozen=True)
class StatementRow:
    """One audited unit: forecast and measured RMSE in the reference unit, and whether it is within the limit."""

    serial: str
    lot: str
    forecast_rmse: float
    measured_rmse: float
    is_within: bool


@dataclass(frozen=True)
class LotStatementFacts:
    """What the page says.

    Args:
        lot, sensor_model, source, quantity, reference_unit: of the lot.
        limit_rmse, limit_origin: largest acceptable RMSE, and where it comes from.
        network_id, method_id: content hashes of the shared network and of the method.
        made_on, software: when and by what the statement was made.
        statement: the promise, or why there is none.
        risk, confidence: of the promise.
        factor: measured / forecast error reckoned with; None where nothing is promised.
        any_form: the same promise without assuming a form of the ratios; None where there is none.
        audits: audited units, worst ratio first.
        drawn: how many units were drawn at random of how many; None where no draw was written down.
        released: serials released on the audits of others.
        counts: units of the lot by verdict.
        identifier: of the statement.
        is_simulated: whether the lot's recordings come from a simulation.
    """

    lot: str
    sensor_model: str
    source: str
    quantity: str
    reference_unit: str
    limit_rmse: float
    limit_origin: Reason
    network_id: str
    method_id: str
    made_on: date
    software: str
    statement: Reason
    risk: float
    confidence: float
    factor: float | None
    any_form: Reason | None
    audits: tuple[StatementRow, ...]
    drawn: tuple[int, int] | None
    released: tuple[str, ...]
    counts: Mapping[str, int]
    identifier: str
    is_simulated: bool = False

    @property
    def is_given(self) -> bool:
        """Whether units are released on the audits of others."""
        return bool(self.released)


def lot_statement_pdf(facts: LotStatementFacts, words: Words = ENGLISH) -> bytes:
    """Return the page in the language of `words`: the same bytes for the same facts."""
    page = Document(
        title=words("paper.title", lot=facts.lot),
        author="",
        software=facts.software,
        footer=f"{facts.identifier}   {facts.software}",
        made_on=facts.made_on,
        across=words("paper.simulated") if facts.is_simulated else "",
    )
    return archival(document_pdf(_story(facts, words), page), page)


def _story(facts: LotStatementFacts, words: Words) -> list[Flowable]:
    return [
        Paragraph(marked_up(words("paper.title", lot=facts.lot)), style(18, BOLD)),
        Spacer(1, 4 * mm),
        _promise(facts, words),
        *section(words("paper.lot"), facts_table(_lot_rows(facts, words))),
        *section(words("paper.evidence"), facts_table(_evidence_rows(facts, words))),
        *section(words("paper.audited"), _audit_table(facts, words)),
        *section(words("paper.released"), paragraph(_serials(facts.released, words), 7)),
        *section(words("paper.means"), paragraph(words("paper.means.is"), 7)),
        *section(words("paper.assumes"), paragraph(words("paper.assumes.is"), 7)),
    ]


def _promise(facts: LotStatementFacts, words: Words) -> Flowable:
    colour, word = (GIVEN, "paper.given") if facts.is_given else (NOT_GIVEN, "paper.not_given")
    lines = [
        Paragraph(f'<font color="{colour}">{marked_up(words(word))}</font>', style(13, BOLD)),
        paragraph(said(facts.statement, words), 10),
    ]
    return Table([[lines]], colWidths=[WIDTH], style=marked(colour))


def _lot_rows(facts: LotStatementFacts, words: Words) -> list[tuple[str, str]]:
    counts = [f"{words(f'verdict.{word}')} {count}" for word, count in facts.counts.items() if count]
    model = facts.sensor_model or words("paper.no_model")
    origin, unit = said(facts.limit_origin, words), facts.reference_unit
    made = {"network": facts.network_id[:12], "method": facts.method_id[:12], "day": facts.made_on.isoformat()}
    return [
        (words("paper.lot"), words("paper.lot.is", lot=facts.lot, model=model, source=facts.source)),
        (words("paper.quantity"), words("paper.quantity.is", quantity=facts.quantity, unit=unit)),
        (words("paper.limit"), words("paper.limit.is", limit=facts.limit_rmse, unit=unit, origin=origin)),
        (words("paper.counts"), ", ".join(counts) or words("paper.none")),
        (words("paper.made"), words("paper.made.is", **made)),
    ]


def _evidence_rows(facts: LotStatementFacts, words: Words) -> list[tuple[str, str]]:
    rows = [
        (words("paper.audits"), _audited(facts, words)),
        (words("paper.drawn"), _drawn(facts.drawn, words)),
        (words("paper.promise"), words("paper.promise.is", risk=facts.risk, confidence=facts.confidence)),
    ]
    if facts.factor is not None:
        rows.append((words("paper.factor"), words("paper.factor.is", factor=facts.factor)))
    return rows if facts.any_form is None else [*rows, (words("paper.any_form"), said(facts.any_form, words))]


def _audited(facts: LotStatementFacts, words: Words) -> str:
    lots = sorted({audit.lot for audit in facts.audits})
    counts = {"audits": len(facts.audits), "beyond": sum(not audit.is_within for audit in facts.audits)}
    if lots in ([], [facts.lot]):
        return words("paper.audits.here", **counts)
    return words("paper.audits.lots", lots=", ".join(lots), **counts)


def _drawn(drawn: tuple[int, int] | None, words: Words) -> str:
    if drawn is None:
        return words("paper.drawn.not")
    return words("paper.drawn.is", drawn=drawn[0], population=drawn[1])


def _audit_table(facts: LotStatementFacts, words: Words) -> Flowable:
    if not facts.audits:
        return paragraph(words("paper.none"))
    unit, shown = facts.reference_unit, facts.audits[:MOST_AUDITS]
    names = ("unit", "lot", "forecast", "measured", "ratio", "verdict")
    rows = [[words(f"paper.column.{name}", unit=unit) for name in names]]
    for a in shown:
        numbers = f"{a.forecast_rmse:.3g}", f"{a.measured_rmse:.3g}", f"{a.measured_rmse / a.forecast_rmse:.2f}"
        rows.append([a.serial, a.lot, *numbers, words("paper.within" if a.is_within else "paper.beyond")])
    if len(facts.audits) > len(shown):
        rows.append([words("paper.more", count=len(facts.audits) - len(shown)), *[""] * 5])
    return Table([[_cell(text) for text in row] for row in rows], colWidths=[WIDTH / 6] * 6, style=grid(7))


def _cell(text: str) -> str | Flowable:
    """Return a text as it stands, which is lower than a paragraph, where the page's own font has its letters."""
    return text if has_all(PLAIN, text) else paragraph(text, 7)


def _serials(serials: tuple[str, ...], words: Words) -> str:
    if not serials:
        return words("paper.none")
    values = {"count": len(serials), "serials": ", ".join(serials[:MOST_SERIALS])}
    if len(serials) > MOST_SERIALS:
        return words("paper.released.more", more=len(serials) - MOST_SERIALS, **values)
    return words("paper.released.are", **values)
