"""The statement on a lot as one page: release, evidence, consumer's risk."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial

import numpy as np
from reportlab.lib.units import mm
from reportlab.platypus import Flowable, Paragraph, Spacer

from softcal.app.calibration.audit import Sample, audited_sample
from softcal.app.calibration.release import statement_provenance
from softcal.app.export.certificates import parts
from softcal.app.paper.fonts import BOLD, marked_up, printable_serial
from softcal.app.texts.catalogue import text
from softcal.app.texts.reasons import Translator, render_reason
from softcal.core.lot import Lot
from softcal.core.messages.figures import format_error
from softcal.core.quality.lot_release import LotRelease, any_form
from softcal.core.quality.lot_status import Disposition, LotStatus
from softcal.db.provenance import Provenance
from softcal.db.registry import Registry

MAX_AUDITS, MAX_SERIALS, MAX_WITHHELD = 10, 20, 6
"""Rows and serials that fit one page; of the rest the page says how many."""

ENGLISH: Translator = partial(text, "en")


@dataclass(frozen=True)
class LotStatement:
    """Content of the page on a lot.

    Args:
        decided: on its unmeasured units.
        provenance: its origin: software, networks and audits.
        sample: what of the audits was drawn before it was measured.
        is_simulated: whether the lot's recordings come from a simulation.
    """

    lot: Lot
    status: LotStatus
    decided: LotRelease
    provenance: Provenance
    sample: Sample
    identifier: str
    is_simulated: bool = False


def build_lot_statement(registry: Registry, status: LotStatus, release: LotRelease) -> LotStatement:
    """Return the content of the page on a lot (`release`: of its unmeasured units)."""
    lot_id = status.lot_id
    calibrated = next(u.serial for u in registry.lots.units(lot_id) if u.role == "target" and u.revision is not None)
    fit = registry.calibrations.get(calibrated, lot_id=lot_id).state.fit
    provenance = statement_provenance(registry, status)
    return LotStatement(
        lot=registry.lots.get(lot_id),
        status=status,
        decided=release,
        provenance=provenance,
        sample=audited_sample(registry, lot_id),
        identifier=f"{lot_id} {datetime.fromisoformat(provenance.made_at):%Y-%m-%d %H:%M} UTC",
        is_simulated=fit.reference is not None and fit.reference.is_simulated,
    )


def lot_statement_pdf(statement: LotStatement, render: Translator = ENGLISH) -> bytes:
    """Return the page in the language of `render`: the same bytes for the same facts."""
    page = parts.Document(
        title=render("paper.title", lot=statement.lot.id),
        author="",
        software=statement.provenance.software,
        footer=f"{statement.identifier}   {statement.provenance.software}",
        created_on=datetime.fromisoformat(statement.provenance.made_at).date(),
        across=render("paper.simulated") if statement.is_simulated else "",
    )
    lot, limit, status = statement.lot, statement.decided.limit, statement.status
    counts = [f"{render(f'verdict.{word}')} {count}" for word, count in status.counts.items() if count]
    model = lot.sensor_model or render("paper.no_model")
    origin, unit = render_reason(limit.origin, render), lot.reference_unit
    record = statement.provenance
    details = {"made_at": record.made_at[:16], "actor": record.actor, "build": record.build[:8]}
    details |= {"method": record.method[:8], "id": record.id[:8]}
    lot_rows = [
        (render("paper.lot"), render("paper.lot.is", lot=lot.id, model=model, source=printable_serial(lot.source))),
        (render("paper.quantity"), render("paper.quantity.is", quantity=lot.reference_quantity, unit=unit)),
        (render("paper.limit"), render("paper.limit.is", limit=limit.maximum_rmse, unit=unit, origin=origin)),
        (render("paper.counts"), ", ".join(counts) or render("paper.none")),
        (render("paper.made"), render("paper.made.is", **details)),
    ]
    for name, units in (("waiting", status.on(Disposition.WAITING)), ("withdrawn", status.withdrawn)):
        if units:
            serials = [unit.serial for unit in units]
            lot_rows.append((render(f"paper.{name}"), _serials(serials, render, MAX_WITHHELD)))
    sampled = [unit.serial for unit in status.on(Disposition.SAMPLED)]
    verdict, word = ("pass", "paper.given") if sampled else ("fail", "paper.not_given")
    colour = parts.VERDICT_COLOURS[verdict]
    story: list[Flowable] = [
        Paragraph(marked_up(page.title), parts.style(18, BOLD)),
        Spacer(1, 2 * mm),
        parts.verdict_block(render(word), colour, [render_reason(statement.decided.statement, render)], 10),
        *parts.section(render("paper.lot"), parts.property_table(lot_rows)),
        *parts.section(render("paper.evidence"), parts.property_table(_evidence_rows(statement, render))),
        *parts.section(render("paper.audited"), _audit_table(statement, render)),
        *parts.section(render("paper.released"), parts.paragraph(_serials(sampled, render), 7)),
        *parts.section(render("paper.means"), parts.paragraph(render("paper.means.is"), 7)),
        *parts.section(render("paper.assumes"), parts.paragraph(render("paper.assumes.is"), 7)),
    ]
    return parts.archival(parts.document_pdf(story, page), page)


def _evidence_rows(statement: LotStatement, render: Translator) -> list[tuple[str, str]]:
    criterion, release = statement.decided.config, statement.decided.decision
    audits, limit = statement.decided.audits, statement.decided.limit.stated_rmse
    lots = sorted({audit.lot_id or statement.lot.id for audit in audits})
    beyond = "–" if limit is None else sum(audit.measured_rmse > limit for audit in audits)
    counts = {"audits": len(audits), "beyond": beyond}
    audited = render("paper.audits.here", **counts)
    if lots not in ([], [statement.lot.id]):
        audited = render("paper.audits.lots", lots=", ".join(lots), **counts)
    rows = [
        (render("paper.audits"), audited),
        (render("paper.drawn"), statement.sample.render(render)),
        (render("paper.promise"), render("paper.promise.is", risk=criterion.risk, confidence=criterion.confidence)),
    ]
    if release is not None and np.isfinite(release.factor):
        rows.append((render("paper.factor"), render("paper.factor.is", factor=release.factor)))
    form = any_form(release) if release is not None and statement.decided.released else None
    return rows if form is None else [*rows, (render("paper.any_form"), render_reason(form, render))]


def _audit_table(statement: LotStatement, render: Translator) -> Flowable:
    audits, limit = sorted(statement.decided.audits, key=lambda audit: -audit.ratio), statement.decided.limit
    if not audits:
        return parts.paragraph(render("paper.none"))
    names = ("unit", "lot", "forecast", "measured", "ratio", "verdict")
    rows = [[render(f"paper.column.{name}", unit=limit.unit) for name in names]]
    for a in audits[:MAX_AUDITS]:
        word = render("paper.within" if a.measured_rmse <= limit.maximum_rmse else "paper.beyond")
        word = word if limit.is_stated else "–"
        errors = (format_error(value, limit.maximum_rmse) for value in (a.forecast_rmse, a.measured_rmse))
        rows.append([printable_serial(a.serial), a.lot_id or statement.lot.id, *errors, f"{a.ratio:.2f}", word])
    if len(audits) > MAX_AUDITS:
        rows.append([render("paper.more", count=len(audits) - MAX_AUDITS), *[""] * 5])
    return parts.text_table(rows, [parts.WIDTH / 6] * 6, 7)


def _serials(serials: Sequence[str], render: Translator, max_count: int = MAX_SERIALS) -> str:
    if not serials:
        return render("paper.none")
    values = {"count": len(serials), "serials": ", ".join(map(printable_serial, serials[:max_count]))}
    if len(serials) > max_count:
        return render("paper.released.more", more=len(serials) - max_count, **values)
    return render("paper.released.are", **values)
