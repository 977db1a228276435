"""The certificate as a PDF for people: the same bytes for the same facts."""

import math
from dataclasses import replace

import numpy as np
import plotly.graph_objects as go
from reportlab.graphics.barcode.qr import QrCodeWidget
from reportlab.graphics.shapes import Drawing
from reportlab.lib.units import mm
from reportlab.platypus import Flowable, Paragraph, Spacer, Table

from softcal.app.export.certificates import parts
from softcal.app.export.certificates.content import Certificate, band_range
from softcal.app.export.certificates.dcc import certificate_xml
from softcal.app.export.certificates.statements import DECISION_RULE, ONLY_THIS
from softcal.app.export.laboratory import NO_COUNTRY, NOT_STATED, Party
from softcal.app.paper.drawing import fit_drawing
from softcal.app.paper.fonts import BOLD, printable_serial, writable
from softcal.core.lot import escape_serial
from softcal.core.messages.figures import format_limit, format_uncertainty, format_value, with_decimals
from softcal.core.unit.uncertainty import ErrorForecast

CURVE, BAND = "#0b5cad", "#bcd6f2"
MAX_PLOT_S = 20.0
"""So much of a recording is shown: several presses, and the interval can be seen."""

MAX_POINTS = 1200
"""A curve is thinned to this many points: more cannot be told apart on paper."""


def certificate_pdf(certificate: Certificate) -> bytes:
    """Return the document: PDF/A-3 with the DCC of the same facts inside."""
    attachment = parts.Attachment(
        f"certificate-{escape_serial(certificate.serial)}.xml", certificate_xml(certificate), "The same facts as a DCC"
    )
    certificate = replace(
        certificate, serial=printable_serial(certificate.serial), source=printable_serial(certificate.source)
    )
    simulated = "SIMULATED" if certificate.is_simulated else ""
    page = parts.Document(
        title=f"Calibration certificate {certificate.identifier}",
        author=certificate.laboratory.laboratory.name,
        software=certificate.provenance.software,
        footer=f"{simulated}   {certificate.identifier}   {certificate.provenance.software}".strip(),
        created_on=certificate.issued_on,
        across=simulated,
    )
    # The line's own word stands in the results: nobody may read a statement where none is made.
    has_statement = bool(certificate.conformity)
    colour = parts.VERDICT_COLOURS[certificate.verdict if has_statement else "retest"]
    word = certificate.verdict.upper() if has_statement else "NO STATEMENT OF CONFORMITY"
    picture = Drawing(24 * mm, 24 * mm)
    code = f"{writable(certificate.identifier)} {certificate.map_sha256}"
    picture.add(QrCodeWidget(code, barWidth=24 * mm, barHeight=24 * mm))
    laboratory, issued_on = certificate.laboratory.laboratory, certificate.issued_on.isoformat()
    head = [
        Paragraph("Calibration certificate", parts.style(18, BOLD)),
        Spacer(1, 5 * mm),
        parts.paragraph(f"Laboratory: {_stated_parts(laboratory.name, laboratory.city)}"),
        parts.paragraph(f"Certificate {certificate.identifier}, issued on {issued_on}"),
    ]
    bands: Flowable = parts.paragraph("No estimate of the unit's recording lies in the calibrated range.")
    if certificate.bands:
        unit, first = certificate.lot.reference_unit, 38 * mm
        rows = [
            [f"Estimate, {unit}", *(band_range(band) for band in certificate.bands)],
            [f"U_est (k = 2), {unit}", *(format_uncertainty(band.expanded) for band in certificate.bands)],
        ]
        widths = [first, *[(parts.WIDTH - first) / len(certificate.bands)] * len(certificate.bands)]
        bands = parts.text_table(rows, widths, 8)
    estimates_title = f"Estimates of the unit's own recording with U_est (k = 2), first {MAX_PLOT_S:g} s"
    story = [
        Table([[head, picture]], colWidths=[parts.WIDTH - 26 * mm, 26 * mm], style=parts.flush()),
        Spacer(1, 4 * mm),
        parts.verdict_block(
            word, colour, certificate.reasons if has_statement else (certificate.no_statement, certificate.traceability)
        ),
        *parts.section("Unit and parties", parts.property_table(_unit_rows(certificate))),
        *parts.section("Result", parts.property_table(_result_rows(certificate))),
        *parts.section("Expanded uncertainty of an estimate, U_est (k = 2)", bands),
        *_budget(certificate),
        *parts.section(estimates_title, fit_drawing(_estimates(certificate), parts.WIDTH)),
        *parts.section("Map from the unit's output to the source's", fit_drawing(_map(certificate), parts.WIDTH / 2)),
        *parts.section("Traceability", parts.property_table(_trace_rows(certificate))),
        *parts.section("Method", parts.paragraph(certificate.method)),
        *parts.section("Decision rule", parts.paragraph(DECISION_RULE)),
        *parts.section("Provenance", parts.property_table(certificate.provenance_rows, size=7)),
        *parts.section("Scope", parts.paragraph(ONLY_THIS)),
        *parts.section("End of the certificate", parts.paragraph(f"Issued on {issued_on}.")),
    ]
    return parts.archival(parts.document_pdf(story, page), page, attachment)


def _estimates(certificate: Certificate) -> go.Figure:
    """Plot the estimates of the unit's own recording over time, with U_est."""
    estimated, figure = certificate.estimated, go.Figure()
    rows = np.flatnonzero(np.isfinite(estimated.estimate))
    rows = rows[estimated.t_s[rows] <= estimated.t_s[rows[0]] + MAX_PLOT_S]
    rows = rows[:: max(1, math.ceil(len(rows) / MAX_POINTS))]
    t_s, band = estimated.t_s[rows], np.concatenate([estimated.lower[rows], estimated.upper[rows][::-1]])
    figure.add_scatter(x=np.concatenate([t_s, t_s[::-1]]), y=band, fill="toself", fillcolor=BAND)
    figure.add_scatter(x=t_s, y=estimated.estimate[rows], line={"color": CURVE, "width": 1.3})
    return _set_axis_titles(figure, "t, s", f"{certificate.lot.reference_quantity}, {certificate.lot.reference_unit}")


def _map(certificate: Certificate) -> go.Figure:
    """Plot the source output γ(x) for each steady output x of the unit."""
    figure, unit = go.Figure(), certificate.lot.output_unit
    figure.add_scatter(x=certificate.output, y=certificate.mapped, line={"color": CURVE, "width": 2.2})
    return _set_axis_titles(figure, f"output of unit {certificate.serial}, {unit}", f"source output, {unit}")


def _set_axis_titles(figure: go.Figure, x_title: str, y_title: str) -> go.Figure:
    figure.update_xaxes(title=x_title).update_yaxes(title=y_title)
    return figure.update_layout(height=210, margin={"l": 72, "r": 16, "t": 28, "b": 48}, showlegend=False)


def _unit_rows(certificate: Certificate) -> list[tuple[str, str]]:
    lot, reason = certificate.lot, f": {certificate.revision_reason}" if certificate.revision_reason else ""
    model = f" ({lot.sensor_model})" if lot.sensor_model else ""
    performance = certificate.laboratory.performance
    received, ambient = performance.received_on, certificate.laboratory.conditions
    conditions = [] if ambient.temperature_C is None else [f"{ambient.temperature_C:g} °C"]
    conditions += [] if ambient.humidity_pct is None else [f"{ambient.humidity_pct:g} % relative humidity"]
    return [
        ("Unit", f"{certificate.serial}{model}, lot {lot.id}"),
        ("Calibration", f"revision {certificate.revision}{reason}"),
        ("Quantity", f"{lot.reference_quantity} in {lot.reference_unit} from output in {lot.output_unit}"),
        ("Recording", certificate.recording_summary),
        ("Performed", certificate.performance_days),
        ("Place", certificate.location),
        ("Received", f"{received.isoformat() if received else NOT_STATED}; condition: {performance.condition}"),
        ("Conditions", ", ".join(conditions) or NOT_STATED),
        ("Laboratory", _party(certificate.laboratory.laboratory)),
        ("Customer", _party(certificate.laboratory.customer)),
        ("Responsible", _stated_parts(certificate.laboratory.person.name, certificate.laboratory.person.role)),
    ]


def _party(party: Party) -> str:
    country = party.country if party.country != NO_COUNTRY else NOT_STATED
    return _stated_parts(party.name, party.street, party.post_code, party.city, country, party.email)


def _stated_parts(*parts: str) -> str:
    return ", ".join(part for part in parts if part != NOT_STATED) or NOT_STATED


def _result_rows(certificate: Certificate) -> list[tuple[str, str]]:
    unit, covered_range = certificate.lot.reference_unit, "the unit's recording reaches none of it"
    if certificate.bands:
        finest = min(band.expanded for band in certificate.bands)
        covered_range = f"{format_value(certificate.low, finest)} to {format_value(certificate.high, finest)} {unit}"
    before = (
        "unknown" if certificate.before is None else f"{with_decimals(certificate.before, certificate.decimals)} {unit}"
    )
    return [
        ("Calibrated range", covered_range),
        ("Predicted error (RMSE)", _error(certificate, certificate.forecast, "none could be made")),
        ("Measured error (RMSE)", _error(certificate, certificate.measured, "none with this map")),
        ("Without calibration", before),
        *(
            (name, f"{_render_number(certificate, name, value)}{f' ({note})' if note else ''}")
            for name, value, note in certificate.decision_numbers
        ),
        ("Statement of conformity", certificate.conformity or "none"),
        ("Verdict of the line", f"{certificate.verdict}; {'; '.join(certificate.reasons)}"),
    ]


def _render_number(certificate: Certificate, name: str, value: float | None) -> str:
    if value is None:
        return NOT_STATED
    symbol, unit = name.partition(":")[0], certificate.lot.reference_unit
    if symbol == "TL" and certificate.limit is not None and certificate.limit.is_stated:
        return f"{format_limit(value)} {unit}"
    text = format_uncertainty(value) if symbol == "U_ref" else with_decimals(value, certificate.decimals)
    return f"{text} {unit}"


def _error(certificate: Certificate, error: ErrorForecast | None, otherwise: str) -> str:
    if error is None:
        return otherwise
    ends, unit = certificate.interval_of(error), certificate.lot.reference_unit
    if ends is None:
        return f"{with_decimals(error.rmse, certificate.decimals)} {unit}"
    low, rmse, high = (format_value(value, error.upper - error.rmse) for value in (ends[0], error.rmse, ends[1]))
    return f"{rmse} {unit} (95 %: {low} to {high} {unit})"


def _trace_rows(certificate: Certificate) -> list[tuple[str, str]]:
    device, cell = certificate.laboratory.load_cell, certificate.reference
    rows = [("Chain", f"{certificate.traceability} {certificate.basis}")]
    if cell is None or cell.is_simulated or not cell.certificate:
        message = (
            f"{_stated_parts(device.manufacturer, device.model, device.serial)}; certificate: {device.certificate}"
        )
        has_device = device.serial != NOT_STATED or device.certificate != NOT_STATED
        return [*rows, ("Load cell named", f"{message}; no verdict was made with it")] if has_device else rows
    uncertainty, unit = NOT_STATED, certificate.lot.reference_unit
    if cell.uncertainty is not None:
        uncertainty = f"U_cell = {cell.uncertainty:g} {unit}, k = {cell.coverage_factor:g}"
    days = [day.isoformat() if day else NOT_STATED for day in (cell.issued_on, cell.due_on)]
    by = cell.laboratory or device.laboratory
    return [
        *rows,
        ("Reference", f"{_stated_parts(device.manufacturer, device.model)}; serial: {cell.cell or device.serial}"),
        ("Its certificate", f"{cell.certificate}; by: {by}; issued: {days[0]}; due: {days[1]}"),
        ("Its uncertainty", uncertainty),
    ]


def _budget(certificate: Certificate) -> list[Flowable]:
    """Return the uncertainty budget as a table; empty for calibrations without one."""
    budget, unit = certificate.budget, certificate.lot.reference_unit
    if budget is None:
        return []
    head = ["contribution", f"value, {unit} or K", "distribution", "divisor", "sensitivity", f"u, {unit}"]
    rows = [
        [
            *(c.name, format_uncertainty(c.value), c.distribution, f"{c.divisor:.4g}", f"{c.sensitivity:.3g}"),
            format_uncertainty(c.standard),
        ]
        for c in budget.contributions
    ]
    rows.append(["combined", "", "", "", "", format_uncertainty(budget.standard)])
    rows.append(["expanded, k = 2", "", "normal", "", "", f"U_est = {format_uncertainty(budget.expanded)}"])
    first = 48 * mm
    table = parts.text_table([head, *rows], [first, *[(parts.WIDTH - first) / 5] * 5], 7)
    note = (
        "" if certificate.reference is not None else " The reference's own uncertainty was not stated and is not in it."
    )
    message = parts.paragraph(f"At {budget.load:.4g} {unit}, the RMS load of the source (GUM, JCGM 100:2008).{note}", 7)
    return [*parts.section("Uncertainty budget of an estimate", table), message]
