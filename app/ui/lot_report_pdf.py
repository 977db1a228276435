"""The report of a lot as a PDF for people."""

from datetime import datetime
from functools import partial
from importlib.metadata import version

from reportlab.lib.units import mm
from reportlab.platypus import Flowable, Paragraph, Spacer, Table

from softcal.app.charts.lot import PICTURES
from softcal.app.charts.palette import LIGHT
from softcal.app.export.certificates import parts
from softcal.app.paper.drawing import fit_drawing
from softcal.app.paper.fonts import BOLD, marked_up
from softcal.app.texts.catalogue import text
from softcal.app.views.lot import NEEDS_A_LOOK, LotView
from softcal.app.views.lot_report import MAX_ROWS, report_parts, report_values
from softcal.db.registry import Registry
from softcal.db.repositories.lot_pages import UnitFilter


def lot_report_pdf(registry: Registry, view: LotView, language: str, made_at: datetime) -> bytes:
    """Return the report of a lot, or of what a filter leaves; units that did not pass are listed.

    Raises:
        InputError: no font at hand can write the language.
    """
    translate = partial(text, language)
    unit_filter = UnitFilter(NEEDS_A_LOOK, sort="severity", serials=view.chosen)
    bad = registry.pages.unit_page(view.lot.id, unit_filter, size=MAX_ROWS)
    title = translate("report.title", lot=view.lot.id)
    page = parts.Document(
        title=title,
        author="",
        software=f"softcal {version('softcal')}",
        footer=f"{title}   {translate('report.made', at=made_at, version=version('softcal'))}",
        created_on=made_at.date(),
        numbering=translate("report.page", number="{number}", count="{count}"),
    )
    story = [
        Paragraph(marked_up(title), parts.style(18, BOLD)),
        Spacer(1, 3 * mm),
        parts.property_table(list(report_values(view, translate).items())),
    ]
    listed = translate("report.bad", shown=len(bad.units), of=bad.total)
    for part in report_parts(view, bad.units, listed, translate):
        flowable: Flowable
        if part.picture and not part.rows:
            flowable = fit_drawing(PICTURES[part.picture](view, LIGHT, translate), parts.WIDTH)
        else:
            cells = [[parts.paragraph(cell, 7) for cell in row] for row in (part.header, *part.rows)]
            widths = [parts.WIDTH * share for share in part.shares]
            flowable = Table(cells, colWidths=widths, style=parts.grid(7), repeatRows=1)
        story += parts.section(part.title, flowable)
    return parts.document_pdf(story, page)
