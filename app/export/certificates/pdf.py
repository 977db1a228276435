"""The certificate as a PDF for people: the same bytes for the same facts."""

from dataclasses import replace

from reportlab.graphics.barcode.qr import QrCodeWidget
from reportlab.graphics.shapes import Drawing
from reportlab.lib.units import mm
from reportlab.platypus import Flowable, Paragraph, Spacer, Table

from softcal.app.export.certificates import parts
from softcal.app.export.certificates.content import DECISION_RULE, ONLY_THIS, Certificate, band_range
from softcal.app.export.certificates.dcc import certificate_xml
from softcal.app.export.certificates.fonts import BOLD, printable_serial, writable
from softcal.app.export.certificates.laboratory import NO_COUNTRY, NOT_STATED, Party
from softcal.app.export.certificates.plots import SHOWN_S, estimate_plot, map_plot
from softcal.core.lot import escape_serial
from softcal.core.unit.uncertainty import ErrorForecast
from softcal.core.words.figures import with_decimals, written_uncertainty, written_value


def certificate_pdf(facts: Certificate) -> bytes:
    """Return the document: PDF/A-3 with the DCC of the same facts inside."""
    attached = parts.Attachment(
        f"certificate-{escape_serial(facts.serial)}.xml", certificate_xml(facts), "The same facts as a DCC"
    )
    facts = replace(facts, serial=printable_serial(facts.serial), source=printable_serial(facts.source))
    simulated = "SIMULATED" if facts.is_simulated else ""
    page = parts.Document(
        title=f"Calibration certificate {facts.identifier}",
        author=facts.laboratory.laboratory.name,
        software=facts.provenance.software,
        footer=f"{simulated}   {facts.identifier}   {facts.provenance.software}".strip(),
        made_on=facts.issued_on,
        across=simulated,
    )
    # The line's own word stands in the results: nobody may read a statement where none is made.
    is_made = bool(facts.conformity)
    colour = parts.VERDICT_COLOURS[facts.verdict if is_made else "retest"]
    word = facts.verdict.upper() if is_made else "NO STATEMENT OF CONFORMITY"
    picture = Drawing(24 * mm, 24 * mm)
    code = f"{writable(facts.identifier)} {facts.map_sha256}"
    picture.add(QrCodeWidget(code, barWidth=24 * mm, barHeight=24 * mm))
    laboratory, issued_on = facts.laboratory.laboratory, facts.issued_on.isoformat()
    head = [
        Paragraph("Calibration certificate", parts.style(18, BOLD)),
        Spacer(1, 5 * mm),
        parts.paragraph(f"Laboratory: {_stated(laboratory.name, laboratory.city)}"),
        parts.paragraph(f"Certificate {facts.identifier}, issued on {issued_on}"),
    ]
    bands: Flowable = parts.paragraph("No estimate of the unit's recording lies in the calibrated range.")
    if facts.bands:
        unit, first = facts.reference_unit, 38 * mm
        rows = [
            [f"Estimate, {unit}", *(band_range(band) for band in facts.bands)],
            [f"U_est (k = 2), {unit}", *(written_uncertainty(band.expanded) for band in facts.bands)],
        ]
        widths = [first, *[(parts.WIDTH - first) / len(facts.bands)] * len(facts.bands)]
        bands = parts.text_table(rows, widths, 8)
    recorded = f"Estimates of the unit's own recording with U_est (k = 2), first {SHOWN_S:g} s"
    story = [
        Table([[head, picture]], colWidths=[parts.WIDTH - 26 * mm, 26 * mm], style=parts.flush()),
        Spacer(1, 4 * mm),
        parts.marked(word, colour, facts.reasons if is_made else (facts.no_statement, facts.traceability)),
        *parts.section("Unit and parties", parts.facts_table(_unit_rows(facts))),
        *parts.section("Result", parts.facts_table(_result_rows(facts))),
        *parts.section("Expanded uncertainty of an estimate, U_est (k = 2)", bands),
        *_budget(facts),
        *parts.section(recorded, estimate_plot(facts, parts.WIDTH)),
        *parts.section("Map from the unit's output to the source's", map_plot(facts, parts.WIDTH)),
        *parts.section("Traceability", parts.facts_table(_trace_rows(facts))),
        *parts.section("Method", parts.paragraph(facts.method)),
        *parts.section("Decision rule", parts.paragraph(DECISION_RULE)),
        *parts.section("Provenance", parts.facts_table(facts.provenance_rows, size=7)),
        *parts.section("Scope", parts.paragraph(ONLY_THIS)),
        *parts.section("End of the certificate", parts.paragraph(f"Issued on {issued_on}.")),
    ]
    return parts.archival(parts.document_pdf(story, page), page, attached)


def _unit_rows(facts: Certificate) -> list[tuple[str, str]]:
    model = f" ({facts.sensor_model})" if facts.sensor_model else ""
    performance = facts.laboratory.performance
    received, given = performance.received_on, facts.laboratory.conditions
    conditions = [] if given.temperature_C is None else [f"{given.temperature_C:g} °C"]
    conditions += [] if given.humidity_pct is None else [f"{given.humidity_pct:g} % relative humidity"]
    return [
        ("Unit", f"{facts.serial}{model}, lot {facts.lot}"),
        ("Calibration", f"revision {facts.revision}{f': {facts.made_because}' if facts.made_because else ''}"),
        ("Quantity", f"{facts.quantity} in {facts.reference_unit} from output in {facts.output_unit}"),
        ("Recording", facts.recorded),
        ("Performed", facts.performed),
        ("Place", facts.place),
        ("Received", f"{received.isoformat() if received else NOT_STATED}; condition: {performance.condition}"),
        ("Conditions", ", ".join(conditions) or NOT_STATED),
        ("Laboratory", _party(facts.laboratory.laboratory)),
        ("Customer", _party(facts.laboratory.customer)),
        ("Responsible", _stated(facts.laboratory.person.name, facts.laboratory.person.role)),
    ]


def _party(party: Party) -> str:
    country = party.country if party.country != NO_COUNTRY else NOT_STATED
    return _stated(party.name, party.street, party.post_code, party.city, country, party.email)


def _stated(*parts: str) -> str:
    return ", ".join(part for part in parts if part != NOT_STATED) or NOT_STATED


def _result_rows(facts: Certificate) -> list[tuple[str, str]]:
    unit, covered = facts.reference_unit, "the unit's recording reaches none of it"
    if facts.bands:
        finest = min(band.expanded for band in facts.bands)
        covered = f"{written_value(facts.low, finest)} to {written_value(facts.high, finest)} {unit}"
    before = "unknown" if facts.before is None else f"{with_decimals(facts.before, facts.decimals)} {unit}"
    return [
        ("Calibrated range", covered),
        ("Predicted error (RMSE)", _error(facts, facts.forecast, "none could be made")),
        ("Measured error (RMSE)", _error(facts, facts.measured, "none with this map")),
        ("Without calibration", before),
        *(
            (name, f"{_deciding(facts, name, value)}{f' ({note})' if note else ''}")
            for name, value, note in facts.deciding
        ),
        ("Statement of conformity", facts.conformity or "none"),
        ("Verdict of the line", f"{facts.verdict}; {'; '.join(facts.reasons)}"),
    ]


def _deciding(facts: Certificate, name: str, value: float | None) -> str:
    if value is None:
        return NOT_STATED
    symbol, unit = name.partition(":")[0], facts.reference_unit
    # A limit is agreed, not measured: it stands as it was stated.
    is_stated = symbol == "TL" and facts.limit is not None and facts.limit.is_stated
    if is_stated:
        return f"{value:.10g} {unit}"
    shown = written_uncertainty(value) if symbol == "U_ref" else with_decimals(value, facts.decimals)
    return f"{shown} {unit}"


def _error(facts: Certificate, found: ErrorForecast | None, otherwise: str) -> str:
    if found is None:
        return otherwise
    ends, unit = facts.interval_of(found), facts.reference_unit
    if ends is None:
        return f"{with_decimals(found.rmse, facts.decimals)} {unit}"
    low, rmse, high = (written_value(value, found.upper - found.rmse) for value in (ends[0], found.rmse, ends[1]))
    return f"{rmse} {unit} (95 %: {low} to {high} {unit})"


def _trace_rows(facts: Certificate) -> list[tuple[str, str]]:
    named, cell = facts.laboratory.load_cell, facts.reference
    rows = [("Chain", f"{facts.traceability} {facts.basis}")]
    if cell is None or cell.is_simulated or not cell.certificate:
        said = f"{_stated(named.manufacturer, named.model, named.serial)}; certificate: {named.certificate}"
        is_named = named.serial != NOT_STATED or named.certificate != NOT_STATED
        return [*rows, ("Load cell named", f"{said}; no verdict was made with it")] if is_named else rows
    uncertainty, unit = NOT_STATED, facts.reference_unit
    if cell.uncertainty is not None:
        uncertainty = f"U_cell = {cell.uncertainty:g} {unit}, k = {cell.coverage_factor:g}"
    days = [day.isoformat() if day else NOT_STATED for day in (cell.issued_on, cell.due_on)]
    by = cell.laboratory or named.laboratory
    return [
        *rows,
        ("Reference", f"{_stated(named.manufacturer, named.model)}; serial: {cell.cell or named.serial}"),
        ("Its certificate", f"{cell.certificate}; by: {by}; issued: {days[0]}; due: {days[1]}"),
        ("Its uncertainty", uncertainty),
    ]


def _budget(facts: Certificate) -> list[Flowable]:
    """The uncertainty budget as a table; nothing for calibrations that kept none."""
    budget, unit = facts.budget, facts.reference_unit
    if budget is None:
        return []
    head = ["contribution", f"value, {unit} or K", "distribution", "divisor", "sensitivity", f"u, {unit}"]
    rows = [
        [
            *(c.name, written_uncertainty(c.value), c.distribution, f"{c.divisor:.4g}", f"{c.sensitivity:.3g}"),
            written_uncertainty(c.standard),
        ]
        for c in budget.contributions
    ]
    rows.append(["combined", "", "", "", "", written_uncertainty(budget.standard)])
    rows.append(["expanded, k = 2", "", "normal", "", "", f"U_est = {written_uncertainty(budget.expanded)}"])
    first = 48 * mm
    table = parts.text_table([head, *rows], [first, *[(parts.WIDTH - first) / 5] * 5], 7)
    unsaid = "" if facts.reference is not None else " The reference's own uncertainty was not stated and is not in it."
    said = parts.paragraph(f"At {budget.load:.4g} {unit}, the RMS load of the source (GUM, JCGM 100:2008).{unsaid}", 7)
    return [*parts.section("Uncertainty budget of an estimate", table), said]
