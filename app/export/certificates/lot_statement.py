"""The statement on a lot as one page for people: what is promised, on what evidence, at what risk, and what is not."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date

from reportlab.lib.units import mm
from reportlab.platypus import Flowable, Paragraph, Spacer, Table

from softcal.app.export.certificates.archival import archival
from softcal.app.export.certificates.fonts import BOLD, marked_up
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

GIVEN, NOT_GIVEN = "#1b7f3b", "#b3261e"
MOST_AUDITS, MOST_SERIALS = 14, 30
"""Rows and serials that fit one page; the rest stand in the registry, and the page says how many."""

MEANING = (
    "Audited units were compared with a reference; each is decided on its own measurement. A unit that was not audited "
    "is released where its forecast error times the factor above is within the limit. The factor is the larger of the "
    "largest measured / forecast error among the audited units and the upper tolerance bound of that ratio "
    "(ISO 16269-6, the method of ISO 3951 for acceptance by variables); where only a part of the units is released, "
    "the bound is taken at the smaller risk which that part allows."
)
ASSUMES = (
    "The audited units are a random draw of the units decided on. Audits were made as the units are used: what a later "
    "day or another use does to a unit shows in no audit made before. The tolerance bound takes the ratios as near "
    "log-normal; without that, the line `of any form` holds."
)


@dataclass(frozen=True)
class StatementRow:
    """One audited unit: forecast and measured RMSE in the reference unit, and its word."""

    serial: str
    lot: str
    forecast_rmse: float
    measured_rmse: float
    word: str


@dataclass(frozen=True)
class LotStatementFacts:
    """What the page says.

    Args:
        lot, sensor_model, source, quantity, reference_unit: of the lot.
        limit_rmse, limit_origin: largest acceptable RMSE, and where it comes from.
        network_id, method_id: content hashes of the shared network and of the method.
        made_on, software: when and by what the statement was made.
        statement: the promise, or why there is none, in a sentence.
        risk, confidence: of the promise.
        factor: measured / forecast error reckoned with; None where nothing is promised.
        any_form: the same promise without assuming a form of the ratios; empty where there is none.
        audits: audited units, worst ratio first.
        drawn: how the audited units were chosen.
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
    limit_origin: str
    network_id: str
    method_id: str
    made_on: date
    software: str
    statement: str
    risk: float
    confidence: float
    factor: float | None
    any_form: str
    audits: tuple[StatementRow, ...]
    drawn: str
    released: tuple[str, ...]
    counts: Mapping[str, int]
    identifier: str
    is_simulated: bool = False

    @property
    def is_given(self) -> bool:
        """Whether units are released on the audits of others."""
        return bool(self.released)


def lot_statement_pdf(facts: LotStatementFacts) -> bytes:
    """Return the page: the same bytes for the same facts."""
    page = Document(
        title=f"Statement on lot {facts.lot}",
        author="",
        software=facts.software,
        footer=f"{facts.identifier}   {facts.software}",
        made_on=facts.made_on,
        across="SIMULATED" if facts.is_simulated else "",
    )
    return archival(document_pdf(_story(facts), page), page)


def _story(facts: LotStatementFacts) -> list[Flowable]:
    return [
        Paragraph(marked_up(f"Statement on lot {facts.lot}"), style(18, BOLD)),
        Spacer(1, 4 * mm),
        _promise(facts),
        *section("Lot", facts_table(_lot_rows(facts))),
        *section("Evidence", facts_table(_evidence_rows(facts))),
        *section("Audited units", _audit_table(facts)),
        *section("Released on these audits", paragraph(_serials(facts.released), 7)),
        *section("What it means", paragraph(MEANING, 7)),
        *section("What it takes for granted", paragraph(ASSUMES, 7)),
    ]


def _promise(facts: LotStatementFacts) -> Flowable:
    colour, word = (GIVEN, "RELEASED BY SAMPLE") if facts.is_given else (NOT_GIVEN, "NO RELEASE BY SAMPLE")
    lines = [Paragraph(f'<font color="{colour}">{word}</font>', style(13, BOLD)), paragraph(facts.statement, 10)]
    return Table([[lines]], colWidths=[WIDTH], style=marked(colour))


def _lot_rows(facts: LotStatementFacts) -> list[tuple[str, str]]:
    counts = ", ".join(f"{count} {word}" for word, count in facts.counts.items() if count) or "none"
    return [
        ("Lot", f"{facts.lot}, {facts.sensor_model or 'sensor model not stated'}, source unit {facts.source}"),
        ("Quantity", f"{facts.quantity} in {facts.reference_unit}"),
        ("Limit", f"RMSE {facts.limit_rmse:.3g} {facts.reference_unit} ({facts.limit_origin})"),
        ("Units by verdict", counts),
        ("Made on", f"{facts.made_on.isoformat()}; network {facts.network_id[:12]}, method {facts.method_id[:12]}"),
    ]


def _evidence_rows(facts: LotStatementFacts) -> list[tuple[str, str]]:
    lots = sorted({audit.lot for audit in facts.audits})
    of_lots = "of this lot" if lots in ([], [facts.lot]) else f"of lots {', '.join(lots)}"
    beyond = sum(audit.measured_rmse > facts.limit_rmse for audit in facts.audits)
    rows = [
        ("Audits", f"{len(facts.audits)} units {of_lots}, {beyond} of them beyond the limit"),
        ("Drawn", facts.drawn),
        ("Promise asked for", f"risk {facts.risk:g}, confidence {facts.confidence:g}"),
    ]
    if facts.factor is not None:
        rows.append(("Factor", f"true error reckoned with: {facts.factor:.3g} x the forecast"))
    return [*rows, ("Of any form", facts.any_form)] if facts.any_form else rows


def _audit_table(facts: LotStatementFacts) -> Flowable:
    if not facts.audits:
        return paragraph("None.")
    unit, shown = facts.reference_unit, facts.audits[:MOST_AUDITS]
    head = ["unit", "lot", f"forecast, {unit}", f"measured, {unit}", "measured / forecast", "verdict"]
    rows = [
        [
            a.serial,
            a.lot,
            f"{a.forecast_rmse:.3g}",
            f"{a.measured_rmse:.3g}",
            f"{a.measured_rmse / a.forecast_rmse:.2f}",
            a.word,
        ]
        for a in shown
    ]
    if len(facts.audits) > len(shown):
        rows.append([f"and {len(facts.audits) - len(shown)} more", "", "", "", "", ""])
    return Table([head, *rows], colWidths=[WIDTH / 6] * 6, style=grid(7))


def _serials(serials: tuple[str, ...]) -> str:
    if not serials:
        return "None."
    more = f" and {len(serials) - MOST_SERIALS} more, listed in the registry" if len(serials) > MOST_SERIALS else ""
    return f"{len(serials)} units: {', '.join(serials[:MOST_SERIALS])}{more}"
