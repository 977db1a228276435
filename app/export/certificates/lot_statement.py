"""The statement on a lot as one page: what is promised, on what evidence, at what risk."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial

import numpy as np
from reportlab.lib.units import mm
from reportlab.platypus import Flowable, Paragraph, Spacer

from softcal.app.batch.audit import Sample, audited_sample
from softcal.app.batch.release import statement_provenance
from softcal.app.export.certificates import parts
from softcal.app.export.certificates.fonts import BOLD, marked_up, printable_serial
from softcal.app.texts.catalogue import text
from softcal.app.texts.reasons import Words, said
from softcal.core.lot import Lot
from softcal.core.quality.lot_release import LotRelease, any_form
from softcal.core.quality.lot_standing import LotStanding, Way
from softcal.db.provenance import Provenance
from softcal.db.registry import Registry

MOST_AUDITS, MOST_SERIALS, MOST_KEPT_BACK = 10, 20, 6
"""Rows and serials that fit one page; of the rest the page says how many."""

ENGLISH: Words = partial(text, "en")


@dataclass(frozen=True)
class LotStatementFacts:
    """What the page says.

    Args:
        decided: on those that nobody measured.
        provenance: what it was made by and from, networks and audits.
        sample: what of the audits was drawn before it was measured.
        is_simulated: whether the lot's recordings come from a simulation.
    """

    lot: Lot
    standing: LotStanding
    decided: LotRelease
    provenance: Provenance
    sample: Sample
    identifier: str
    is_simulated: bool = False


def lot_statement_facts(registry: Registry, standing: LotStanding, decided: LotRelease) -> LotStatementFacts:
    """Gather what the page on a lot says (`decided`: on its units that nobody measured)."""
    lot_id = standing.lot_id
    calibrated = next(u.serial for u in registry.lots.units(lot_id) if u.role == "target" and u.revision is not None)
    fit = registry.calibrations.get(calibrated, lot_id=lot_id).state.fit
    provenance = statement_provenance(registry, lot_id)
    return LotStatementFacts(
        lot=registry.lots.get(lot_id),
        standing=standing,
        decided=decided,
        provenance=provenance,
        sample=audited_sample(registry, lot_id),
        identifier=f"{lot_id} {datetime.fromisoformat(provenance.made_at):%Y-%m-%d %H:%M} UTC",
        is_simulated=fit.reference is not None and fit.reference.is_simulated,
    )


def lot_statement_pdf(facts: LotStatementFacts, words: Words = ENGLISH) -> bytes:
    """Return the page in the language of `words`: the same bytes for the same facts."""
    page = parts.Document(
        title=words("paper.title", lot=facts.lot.id),
        author="",
        software=facts.provenance.software,
        footer=f"{facts.identifier}   {facts.provenance.software}",
        made_on=datetime.fromisoformat(facts.provenance.made_at).date(),
        across=words("paper.simulated") if facts.is_simulated else "",
    )
    lot, limit, standing = facts.lot, facts.decided.limit, facts.standing
    counts = [f"{words(f'verdict.{word}')} {count}" for word, count in standing.counts.items() if count]
    model = lot.sensor_model or words("paper.no_model")
    origin, unit = said(limit.origin, words), lot.reference_unit
    record = facts.provenance
    made = {"made_at": record.made_at[:16], "actor": record.actor, "build": record.build[:8]}
    made |= {"method": record.method[:8], "id": record.id[:8]}
    lot_rows = [
        (words("paper.lot"), words("paper.lot.is", lot=lot.id, model=model, source=printable_serial(lot.source))),
        (words("paper.quantity"), words("paper.quantity.is", quantity=lot.reference_quantity, unit=unit)),
        (words("paper.limit"), words("paper.limit.is", limit=limit.maximum_rmse, unit=unit, origin=origin)),
        (words("paper.counts"), ", ".join(counts) or words("paper.none")),
        (words("paper.made"), words("paper.made.is", **made)),
    ]
    for name, units in (("waiting", standing.on(Way.WAITING)), ("withdrawn", standing.withdrawn)):
        if units:
            serials = [unit.serial for unit in units]
            lot_rows.append((words(f"paper.{name}"), _serials(serials, words, MOST_KEPT_BACK)))
    verdict, word = ("pass", "paper.given") if facts.decided.released else ("fail", "paper.not_given")
    colour = parts.VERDICT_COLOURS[verdict]
    story: list[Flowable] = [
        Paragraph(marked_up(page.title), parts.style(18, BOLD)),
        Spacer(1, 2 * mm),
        parts.marked(words(word), colour, [said(facts.decided.statement, words)], 10),
        *parts.section(words("paper.lot"), parts.facts_table(lot_rows)),
        *parts.section(words("paper.evidence"), parts.facts_table(_evidence_rows(facts, words))),
        *parts.section(words("paper.audited"), _audit_table(facts, words)),
        *parts.section(words("paper.released"), parts.paragraph(_serials(facts.decided.released, words), 7)),
        *parts.section(words("paper.means"), parts.paragraph(words("paper.means.is"), 7)),
        *parts.section(words("paper.assumes"), parts.paragraph(words("paper.assumes.is"), 7)),
    ]
    return parts.archival(parts.document_pdf(story, page), page)


def _evidence_rows(facts: LotStatementFacts, words: Words) -> list[tuple[str, str]]:
    promise, release = facts.decided.config, facts.decided.found
    audits, limit = facts.decided.audits, facts.decided.limit.maximum_rmse
    lots = sorted({audit.lot_id or facts.lot.id for audit in audits})
    counts = {"audits": len(audits), "beyond": sum(audit.measured_rmse > limit for audit in audits)}
    audited = words("paper.audits.here", **counts)
    if lots not in ([], [facts.lot.id]):
        audited = words("paper.audits.lots", lots=", ".join(lots), **counts)
    rows = [
        (words("paper.audits"), audited),
        (words("paper.drawn"), facts.sample.render(words)),
        (words("paper.promise"), words("paper.promise.is", risk=promise.risk, confidence=promise.confidence)),
    ]
    if release is not None and np.isfinite(release.factor):
        rows.append((words("paper.factor"), words("paper.factor.is", factor=release.factor)))
    form = any_form(release) if release is not None and facts.decided.released else None
    return rows if form is None else [*rows, (words("paper.any_form"), said(form, words))]


def _audit_table(facts: LotStatementFacts, words: Words) -> Flowable:
    audits, limit = sorted(facts.decided.audits, key=lambda audit: -audit.ratio), facts.decided.limit
    if not audits:
        return parts.paragraph(words("paper.none"))
    names = ("unit", "lot", "forecast", "measured", "ratio", "verdict")
    rows = [[words(f"paper.column.{name}", unit=limit.unit) for name in names]]
    for a in audits[:MOST_AUDITS]:
        word = words("paper.within" if a.measured_rmse <= limit.maximum_rmse else "paper.beyond")
        numbers = f"{a.forecast_rmse:.3g}", f"{a.measured_rmse:.3g}", f"{a.ratio:.2f}"
        rows.append([printable_serial(a.serial), a.lot_id or facts.lot.id, *numbers, word])
    if len(audits) > MOST_AUDITS:
        rows.append([words("paper.more", count=len(audits) - MOST_AUDITS), *[""] * 5])
    return parts.text_table(rows, [parts.WIDTH / 6] * 6, 7)


def _serials(serials: Sequence[str], words: Words, most: int = MOST_SERIALS) -> str:
    if not serials:
        return words("paper.none")
    values = {"count": len(serials), "serials": ", ".join(map(printable_serial, serials[:most]))}
    if len(serials) > most:
        return words("paper.released.more", more=len(serials) - most, **values)
    return words("paper.released.are", **values)
