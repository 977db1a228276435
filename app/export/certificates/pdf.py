"""The certificate as a PDF for people: vector plots, embedded fonts, the same bytes for the same facts."""

from reportlab.graphics.barcode.qr import QrCodeWidget
from reportlab.graphics.shapes import Drawing
from reportlab.lib import colors
from reportlab.lib.units import mm
from reportlab.platypus import Flowable, Paragraph, Spacer, Table, TableStyle

from softcal.app.export.certificates.content import DECISION_RULE, METHOD, Certificate
from softcal.app.export.certificates.fonts import BOLD, marked_up
from softcal.app.export.certificates.laboratory import NO_COUNTRY, NOT_STATED, Party
from softcal.app.export.certificates.parts import (
    WIDTH,
    document_pdf,
    facts_table,
    flush,
    grid,
    paragraph,
    section,
    style,
)
from softcal.app.export.certificates.plots import SHOWN_S, estimate_plot, map_plot

VERDICT_COLOURS = {"pass": "#1b7f3b", "conditional": "#8a6100", "fail": "#b3261e", "retest": "#5a6472"}


def certificate_pdf(facts: Certificate) -> bytes:
    """Return the document."""
    return document_pdf(
        _story(facts),
        f"Calibration certificate {facts.identifier}",
        facts.laboratory.laboratory.name,
        facts.software,
        footer=f"{facts.identifier}   {facts.software}",
    )


def _story(facts: Certificate) -> list[Flowable]:
    return [
        _head(facts),
        Spacer(1, 4 * mm),
        _verdict(facts),
        *section("Unit and parties", facts_table(_unit_rows(facts))),
        *section("Result", facts_table(_result_rows(facts))),
        *section("Uncertainty of an estimate (90 % interval)", _band_table(facts)),
        *section(f"Estimates of the unit's own recording, first {SHOWN_S:g} s", estimate_plot(facts, WIDTH)),
        *section("Map from the unit's output to the source's", map_plot(facts, WIDTH)),
        *section("Traceability", facts_table(_trace_rows(facts))),
        *section("Method", paragraph(METHOD)),
        *section("Decision rule", paragraph(DECISION_RULE)),
        *section("Provenance (SHA-256)", facts_table(list(facts.hashes), size=7)),
    ]


def _head(facts: Certificate) -> Flowable:
    code = QrCodeWidget(f"{facts.identifier} {dict(facts.hashes)['map']}", barWidth=24 * mm, barHeight=24 * mm)
    picture = Drawing(24 * mm, 24 * mm)
    picture.add(code)
    title = [
        Paragraph("Calibration certificate", style(18, BOLD)),
        Spacer(1, 5 * mm),
        paragraph(f"Laboratory: {_stated(facts.laboratory.laboratory.name, facts.laboratory.laboratory.city)}"),
        paragraph(f"Certificate {facts.identifier}, calibrated on {facts.made_on.isoformat()}"),
    ]
    return Table([[title, picture]], colWidths=[WIDTH - 26 * mm, 26 * mm], style=flush())


def _verdict(facts: Certificate) -> Flowable:
    colour = VERDICT_COLOURS[facts.verdict]
    lines = [Paragraph(f'<font color="{colour}">{marked_up(facts.verdict.upper())}</font>', style(13, BOLD))]
    lines += [paragraph(reason) for reason in facts.reasons]
    box = TableStyle(
        [("LINEBEFORE", (0, 0), (0, -1), 3, colors.HexColor(colour)), ("LEFTPADDING", (0, 0), (-1, -1), 8)]
    )
    return Table([[lines]], colWidths=[WIDTH], style=box)


def _unit_rows(facts: Certificate) -> list[tuple[str, str]]:
    model = f" ({facts.sensor_model})" if facts.sensor_model else ""
    return [
        ("Unit", f"{facts.serial}{model}, lot {facts.lot}, revision {facts.revision} of its calibration"),
        ("Quantity", f"{facts.quantity} in {facts.reference_unit} from output in {facts.output_unit}"),
        ("Recording", f"{facts.samples} samples at {facts.sample_rate_Hz:g} Hz"),
        ("Conditions", _conditions(facts)),
        ("Laboratory", _party(facts.laboratory.laboratory)),
        ("Customer", _party(facts.laboratory.customer)),
        ("Responsible", _stated(facts.laboratory.person.name, facts.laboratory.person.role)),
    ]


def _party(party: Party) -> str:
    return _stated(party.name, party.city, party.country if party.country != NO_COUNTRY else NOT_STATED, party.email)


def _stated(*parts: str) -> str:
    return ", ".join(part for part in parts if part != NOT_STATED) or NOT_STATED


def _conditions(facts: Certificate) -> str:
    given = facts.laboratory.conditions
    parts = [] if given.temperature_C is None else [f"{given.temperature_C:g} °C"]
    parts += [] if given.humidity_pct is None else [f"{given.humidity_pct:g} % relative humidity"]
    return ", ".join(parts) or "not stated"


def _result_rows(facts: Certificate) -> list[tuple[str, str]]:
    unit = facts.reference_unit
    expected = "none could be made"
    if facts.expected is not None and facts.expected_interval is not None:
        low, high = facts.expected_interval
        expected = f"{facts.expected:.3g} {unit} (95 %: {low:.3g} to {high:.3g} {unit})"
    measured = (
        "the unit was not compared with a reference" if facts.measured is None else f"{facts.measured:.3g} {unit}"
    )
    limit = "none" if facts.limit is None else f"{facts.limit:.3g} {unit} ({facts.limit_origin})"
    return [
        ("Calibrated range", f"{facts.low:.4g} to {facts.high:.4g} {unit}"),
        ("Predicted error (RMSE)", expected),
        ("Measured error (RMSE)", measured),
        ("Without calibration", "unknown" if facts.before is None else f"{facts.before:.3g} {unit}"),
        ("Limit", limit),
        ("Statement", f"{facts.conformity or 'none'} (verdict of the line: {facts.verdict})"),
    ]


def _trace_rows(facts: Certificate) -> list[tuple[str, str]]:
    cell = facts.laboratory.load_cell
    rows = [("Chain", f"{facts.traceability} {facts.basis}")]
    if not cell.is_stated:
        return rows
    uncertainty = "not stated"
    if cell.uncertainty_N is not None:
        uncertainty = f"U = {cell.uncertainty_N:g} N, k = {cell.coverage_factor:g}"
    days = [day.isoformat() if day else "not stated" for day in (cell.issued_on, cell.due_on)]
    return [
        *rows,
        ("Load cell", f"{_stated(cell.manufacturer, cell.model)}; serial: {cell.serial}"),
        ("Its certificate", f"{cell.certificate}; by: {cell.laboratory}; issued: {days[0]}; due: {days[1]}"),
        ("Its uncertainty", uncertainty),
    ]


def _band_table(facts: Certificate) -> Flowable:
    if not facts.bands:
        return paragraph("No estimate of the unit's recording lies in the calibrated range.")
    unit = facts.reference_unit
    rows = [
        [f"Estimate, {unit}", *(f"{band.low:.3g} to {band.high:.3g}" for band in facts.bands)],
        [f"Half-width, {unit}", *(f"± {band.half_width:.3g}" for band in facts.bands)],
    ]
    first = 38 * mm
    widths = [first, *[(WIDTH - first) / len(facts.bands)] * len(facts.bands)]
    return Table(rows, colWidths=widths, style=grid(8))
