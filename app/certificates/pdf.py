"""The certificate as a PDF for people: vector plots, embedded fonts, the same bytes for the same facts."""

import io
from collections.abc import Sequence

from reportlab.graphics.barcode.qr import QrCodeWidget
from reportlab.graphics.shapes import Drawing
from reportlab.lib import colors
from reportlab.lib.pagesizes import A4
from reportlab.lib.styles import ParagraphStyle
from reportlab.lib.units import mm
from reportlab.pdfgen.canvas import Canvas
from reportlab.platypus import Flowable, KeepTogether, Paragraph, SimpleDocTemplate, Spacer, Table, TableStyle

from softcal.app.certificates.content import DECISION_RULE, METHOD, Certificate
from softcal.app.certificates.fonts import BOLD, PLAIN, marked_up, register
from softcal.app.certificates.laboratory import NO_COUNTRY, NOT_STATED, Party
from softcal.app.certificates.plots import SHOWN_S, estimate_plot, map_plot

MARGIN = 18 * mm
WIDTH = A4[0] - 2 * MARGIN
FRAME_PADDING = 6  # ReportLab's own, inside the margins
INK, QUIET, RULE = colors.HexColor("#1a1f26"), colors.HexColor("#5a6472"), colors.HexColor("#c9d0d8")
VERDICT_COLOURS = {"pass": "#1b7f3b", "conditional": "#8a6100", "fail": "#b3261e", "retest": "#5a6472"}


def certificate_pdf(facts: Certificate) -> bytes:
    """Return the document."""
    register()
    buffer = io.BytesIO()
    document = SimpleDocTemplate(
        buffer,
        pagesize=A4,
        leftMargin=MARGIN - FRAME_PADDING,
        rightMargin=MARGIN - FRAME_PADDING,
        topMargin=14 * mm,
        bottomMargin=18 * mm,
        title=f"Calibration certificate {facts.identifier}",
        author=facts.laboratory.laboratory.name,
        creator=facts.software,
        invariant=1,
    )

    def canvas(*arguments: object, **options: object) -> Canvas:
        return _NumberedCanvas(*arguments, footer=f"{facts.identifier}   {facts.software}", **options)

    document.build(_story(facts), canvasmaker=canvas)
    return buffer.getvalue()


class _NumberedCanvas(Canvas):  # type: ignore[misc]
    """Knows the number of pages when it writes `Page 1 of 2`: pages are held back until all are laid out."""

    def __init__(self, *arguments: object, footer: str, **options: object) -> None:
        super().__init__(*arguments, **options)
        self._footer, self._pages = footer, list[dict[str, object]]()

    def showPage(self) -> None:  # noqa: N802  (a name of ReportLab's)
        self._pages.append(dict(self.__dict__))
        self._startPage()

    def save(self) -> None:
        pages = self._pages
        for number, page in enumerate(pages, 1):
            self.__dict__.update(page)
            self.setFont(PLAIN, 7)
            self.setFillColor(QUIET)
            self.drawString(MARGIN, 12 * mm, self._footer)
            self.drawRightString(A4[0] - MARGIN, 12 * mm, f"Page {number} of {len(pages)}")
            super().showPage()
        super().save()


def _story(facts: Certificate) -> list[Flowable]:
    return [
        _head(facts),
        Spacer(1, 4 * mm),
        _verdict(facts),
        *_section("Unit and parties", _facts_table(_unit_rows(facts))),
        *_section("Result", _facts_table(_result_rows(facts))),
        *_section("Uncertainty of an estimate (90 % interval)", _band_table(facts)),
        *_section(f"Estimates of the unit's own recording, first {SHOWN_S:g} s", estimate_plot(facts, WIDTH)),
        *_section("Map from the unit's output to the source's", map_plot(facts, WIDTH)),
        *_section("Traceability", _facts_table(_trace_rows(facts))),
        *_section("Method", _paragraph(METHOD)),
        *_section("Decision rule", _paragraph(DECISION_RULE)),
        *_section("Provenance (SHA-256)", _facts_table(list(facts.hashes), size=7)),
    ]


def _head(facts: Certificate) -> Flowable:
    code = QrCodeWidget(f"{facts.identifier} {dict(facts.hashes)['map']}", barWidth=24 * mm, barHeight=24 * mm)
    picture = Drawing(24 * mm, 24 * mm)
    picture.add(code)
    title = [
        Paragraph("Calibration certificate", _style(18, BOLD)),
        Spacer(1, 5 * mm),
        _paragraph(f"Laboratory: {_stated(facts.laboratory.laboratory.name, facts.laboratory.laboratory.city)}"),
        _paragraph(f"Certificate {facts.identifier}, calibrated on {facts.made_on.isoformat()}"),
    ]
    return Table([[title, picture]], colWidths=[WIDTH - 26 * mm, 26 * mm], style=_flush())


def _verdict(facts: Certificate) -> Flowable:
    colour = VERDICT_COLOURS[facts.verdict]
    lines = [Paragraph(f'<font color="{colour}">{marked_up(facts.verdict.upper())}</font>', _style(13, BOLD))]
    lines += [_paragraph(reason) for reason in facts.reasons]
    box = TableStyle(
        [("LINEBEFORE", (0, 0), (0, -1), 3, colors.HexColor(colour)), ("LEFTPADDING", (0, 0), (-1, -1), 8)]
    )
    return Table([[lines]], colWidths=[WIDTH], style=box)


def _section(title: str, body: Flowable) -> list[Flowable]:
    heading = Paragraph(marked_up(title), _style(10, BOLD))
    return [Spacer(1, 4.5 * mm), KeepTogether([heading, Spacer(1, 1.5 * mm), body])]


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
        return _paragraph("No estimate of the unit's recording lies in the calibrated range.")
    unit = facts.reference_unit
    rows = [
        [f"Estimate, {unit}", *(f"{band.low:.3g} to {band.high:.3g}" for band in facts.bands)],
        [f"Half-width, {unit}", *(f"± {band.half_width:.3g}" for band in facts.bands)],
    ]
    first = 38 * mm
    widths = [first, *[(WIDTH - first) / len(facts.bands)] * len(facts.bands)]
    return Table(rows, colWidths=widths, style=_grid(8))


def _facts_table(rows: Sequence[tuple[str, str]], size: float = 8) -> Flowable:
    cells = [[_paragraph(name, size, QUIET), _paragraph(value, size)] for name, value in rows]
    return Table(cells, colWidths=[38 * mm, WIDTH - 38 * mm], style=_grid(size))


def _grid(size: float) -> TableStyle:
    return TableStyle(
        [
            ("FONT", (0, 0), (-1, -1), PLAIN, size),
            ("TEXTCOLOR", (0, 0), (-1, -1), INK),
            ("LINEBELOW", (0, 0), (-1, -1), 0.4, RULE),
            ("VALIGN", (0, 0), (-1, -1), "TOP"),
            ("LEFTPADDING", (0, 0), (-1, -1), 0),
            ("TOPPADDING", (0, 0), (-1, -1), 2),
            ("BOTTOMPADDING", (0, 0), (-1, -1), 2.5),
        ]
    )


def _flush() -> TableStyle:
    return TableStyle([("LEFTPADDING", (0, 0), (-1, -1), 0), ("VALIGN", (0, 0), (-1, -1), "TOP")])


def _paragraph(text: str, size: float = 8, colour: colors.Color = INK) -> Paragraph:
    return Paragraph(marked_up(text), _style(size, PLAIN, colour))


def _style(size: float, font: str, colour: colors.Color = INK) -> ParagraphStyle:
    return ParagraphStyle(f"{font}{size}", fontName=font, fontSize=size, leading=size * 1.35, textColor=colour)
