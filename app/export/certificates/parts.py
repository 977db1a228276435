"""Parts that every document is set from: A4 pages, headings, tables of facts, paragraphs.

PDF/A-3 (ISO 19005-3, level B): metadata, colours, attachments readable in decades.
"""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime, time

import pikepdf
from PIL import ImageCms
from reportlab.lib import colors
from reportlab.lib.pagesizes import A4
from reportlab.lib.styles import ParagraphStyle
from reportlab.lib.units import mm
from reportlab.pdfgen.canvas import Canvas
from reportlab.platypus import Flowable, KeepTogether, Paragraph, SimpleDocTemplate, Spacer, Table, TableStyle

from softcal.app.paper.fonts import BOLD, PLAIN, has_all, marked_up, register, runs_of, width_of, writable

MARGIN = 18 * mm
WIDTH = A4[0] - 2 * MARGIN
FRAME_PADDING = 6  # ReportLab's own, inside the margins
INK, QUIET, RULE = colors.HexColor("#1a1f26"), colors.HexColor("#5a6472"), colors.HexColor("#c9d0d8")
WATERMARK = colors.HexColor("#f3d9d7")
VERDICT_COLOURS = {"pass": "#1b7f3b", "conditional": "#8a6100", "fail": "#b3261e", "retest": "#5a6472"}
"""Of paper. Screens have others (`charts.palette`); an issued certificate must come out again byte for byte."""


@dataclass(frozen=True)
class Document:
    """Properties of every page of a document.

    Args:
        across: word written across every page; empty for none.
    """

    title: str
    author: str
    software: str
    footer: str
    created_on: date
    across: str = ""
    numbering: str = "Page {number} of {count}"

    def __post_init__(self) -> None:
        for name in ("title", "author", "software", "footer", "across", "numbering"):
            object.__setattr__(self, name, writable(getattr(self, name)))


def document_pdf(story: Sequence[Flowable], page: Document) -> bytes:
    """Return a story as a PDF with embedded fonts: the same bytes for the same story."""
    register()
    buffer = io.BytesIO()
    document = SimpleDocTemplate(
        buffer,
        pagesize=A4,
        leftMargin=MARGIN - FRAME_PADDING,
        rightMargin=MARGIN - FRAME_PADDING,
        topMargin=14 * mm,
        bottomMargin=18 * mm,
        title=page.title,
        author=page.author,
        creator=page.software,
        invariant=1,
        # ReportLab's own first font is one that no file embeds.
        initialFontName=PLAIN,
    )

    def canvas(*arguments: object, **options: object) -> Canvas:
        return _NumberedCanvas(*arguments, page=page, **options)

    document.build(list(story), canvasmaker=canvas)
    return buffer.getvalue()


class _NumberedCanvas(Canvas):  # type: ignore[misc]
    """Holds pages back until all are laid out, to write `Page 1 of 2`."""

    def __init__(self, *arguments: object, page: Document, **options: object) -> None:
        super().__init__(*arguments, **options)
        self._page, self._pages = page, list[dict[str, object]]()
        self._draw_watermark()

    def showPage(self) -> None:  # noqa: N802  (a name of ReportLab's)
        self._pages.append(dict(self.__dict__))
        self._startPage()
        self._draw_watermark()

    def save(self) -> None:
        pages = self._pages
        for number, page in enumerate(pages, 1):
            self.__dict__.update(page)
            numbering_text = self._page.numbering.format(number=number, count=len(pages))
            self.setFillColor(QUIET)
            self._write(MARGIN, 12 * mm, runs_of(self._page.footer), 7)
            numbering = runs_of(numbering_text)
            self._write(A4[0] - MARGIN - width_of(numbering, 7), 12 * mm, numbering, 7)
            super().showPage()
        super().save()

    def _draw_watermark(self) -> None:
        """Write the word across the page, below all that follows."""
        if not self._page.across:
            return
        self.saveState()
        self.setFillColor(WATERMARK)
        word = [(BOLD, self._page.across)] if has_all(BOLD, self._page.across) else runs_of(self._page.across)
        self.translate(A4[0] / 2, A4[1] / 2)
        self.rotate(54)
        self._write(-width_of(word, 84) / 2, -30, word, 84)
        self.restoreState()

    def _write(self, x: float, y: float, runs: list[tuple[str, str]], size: float) -> None:
        """Write runs of letters side by side."""
        for font, letters in runs:
            self.setFont(font, size)
            self.drawString(x, y, letters)
            x += width_of([(font, letters)], size)


def section(title: str, body: Flowable) -> list[Flowable]:
    """Return a heading with its body, kept on one page."""
    heading = Paragraph(marked_up(title), style(10, BOLD))
    return [Spacer(1, 4.5 * mm), KeepTogether([heading, Spacer(1, 1.5 * mm), body])]


def property_table(rows: Sequence[tuple[str, str]], size: float = 8) -> Flowable:
    """Return a table of names and values."""
    cells = [[paragraph(name, size, QUIET), paragraph(value, size)] for name, value in rows]
    return Table(cells, colWidths=[38 * mm, WIDTH - 38 * mm], style=grid(size))


def text_table(rows: Sequence[Sequence[str]], widths: Sequence[float], size: float) -> Table:
    """Return a table of texts in columns of these widths in points."""
    # A text as it stands is lower than a paragraph; it needs a font that has its letters.
    cells = [[text if has_all(PLAIN, text) else paragraph(text, size) for text in row] for row in rows]
    return Table(cells, colWidths=list(widths), style=grid(size))


def grid(size: float) -> TableStyle:
    """Return lines under every row, text at this size in points."""
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


EMBEDDED = ("FONT", (0, 0), (-1, -1), PLAIN, 8)
"""A table names a font even where it writes nothing: never ReportLab's own, not embedded."""


def flush() -> TableStyle:
    """Return a table without padding on the left."""
    return TableStyle([EMBEDDED, ("LEFTPADDING", (0, 0), (-1, -1), 0), ("VALIGN", (0, 0), (-1, -1), "TOP")])


def verdict_block(word: str, colour: str, texts: Sequence[str], size: float = 8) -> Table:
    """Return a verdict with its text, and a bar in the verdict's colour on the left."""
    heading = Paragraph(f'<font color="{colour}">{marked_up(word)}</font>', style(13, BOLD))
    bar = ("LINEBEFORE", (0, 0), (0, -1), 3, colors.HexColor(colour))
    table_style = TableStyle([EMBEDDED, bar, ("LEFTPADDING", (0, 0), (-1, -1), 8)])
    return Table([[[heading, *(paragraph(text, size) for text in texts)]]], colWidths=[WIDTH], style=table_style)


def paragraph(text: str, size: float = 8, colour: colors.Color = INK) -> Paragraph:
    """Return plain text as a paragraph at this size in points."""
    return Paragraph(marked_up(text), style(size, PLAIN, colour))


def style(size: float, font: str, colour: colors.Color = INK) -> ParagraphStyle:
    """Return the style of one font at this size in points."""
    register()
    return ParagraphStyle(f"{font}{size}", fontName=font, fontSize=size, leading=size * 1.35, textColor=colour)


@dataclass(frozen=True)
class Attachment:
    """A file inside a document that holds the same facts in another form."""

    name: str
    content: bytes
    description: str


def archival(content: bytes, page: Document, attachment: Attachment | None = None) -> bytes:
    """Return a PDF as PDF/A-3, with a file inside where one is given."""
    created_at = datetime.combine(page.created_on, time(), UTC)
    stamp = f"D:{created_at:%Y%m%d%H%M%S}+00'00'"
    information = {"/Title": page.title, "/Author": page.author, "/Creator": page.software, "/Producer": page.software}
    result = io.BytesIO()
    with pikepdf.open(io.BytesIO(content)) as pdf:
        # The metadata as XMP and in the old dictionary: a reader may look at either.
        with pdf.open_metadata(set_pikepdf_as_editor=False, update_docinfo=False) as metadata:
            metadata["dc:title"], metadata["dc:creator"] = page.title, [page.author]
            metadata["xmp:CreatorTool"] = metadata["pdf:Producer"] = page.software
            metadata["xmp:CreateDate"] = metadata["xmp:ModifyDate"] = created_at.isoformat()
            metadata["pdfaid:part"], metadata["pdfaid:conformance"] = "3", "B"
        for key in list(pdf.docinfo.keys()):
            del pdf.docinfo[key]
        for key, value in {**information, "/CreationDate": stamp, "/ModDate": stamp}.items():
            pdf.docinfo[key] = value
        # What the colours mean.
        profile = bytearray(ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes())
        profile[24:36] = bytes(12)  # the moment it was made: the same facts must give the same bytes
        profile[84:100] = bytes(16)  # its checksum, which would hold for that moment
        intent = pikepdf.Dictionary(
            Type=pikepdf.Name.OutputIntent,
            S=pikepdf.Name.GTS_PDFA1,
            OutputConditionIdentifier="sRGB",
            Info="sRGB IEC61966-2.1",
            DestOutputProfile=pdf.make_stream(bytes(profile), N=3, Alternate=pikepdf.Name.DeviceRGB),
        )
        pdf.Root.OutputIntents = pikepdf.Array([pdf.make_indirect(intent)])  # noqa: V101
        if attachment is not None:
            attributes = {"filename": attachment.name, "description": attachment.description, "mime_type": "text/xml"}
            days = {"creation_date": stamp, "mod_date": stamp}
            file = pikepdf.AttachedFileSpec(pdf, attachment.content, **attributes, **days)
            file.obj.AFRelationship = pikepdf.Name.Alternative  # noqa: V101
            pdf.attachments[attachment.name] = file
            pdf.Root.AF = pikepdf.Array([file.obj])  # noqa: V101
        pdf.save(result, deterministic_id=True, object_stream_mode=pikepdf.ObjectStreamMode.disable)
    return result.getvalue()
