"""The report of a lot as a PDF for people."""

from datetime import datetime
from functools import partial
from importlib.metadata import version

from reportlab.lib.units import mm
from reportlab.platypus import Flowable, Paragraph, Spacer, Table

from softcal.app.charts.lot import lot_picture
from softcal.app.charts.palette import LIGHT
from softcal.app.export.certificates import parts
from softcal.app.paper.drawing import fitted
from softcal.app.paper.fonts import BOLD, marked_up
from softcal.app.texts.catalogue import text
from softcal.app.views.lot import NEEDS_A_LOOK, LotView
from softcal.app.views.lot_report import MOST_ROWS, report_facts, report_parts
from softcal.db.registry import Registry
from softcal.db.repositories.lot_pages import UnitFilter


def lot_report_pdf(registry: Registry, view: LotView, language: str, made: datetime) -> bytes:
    """Return the report of a lot, or of what a filter leaves; units that did not pass are listed.

    Raises:
        InputError: no font at hand can write the language.
    """
    say = partial(text, language)
    wanted = UnitFilter(NEEDS_A_LOOK, sort="severity", serials=view.chosen)
    bad = registry.pages.unit_page(view.lot.id, wanted, size=MOST_ROWS)
    title = say("report.title", lot=view.lot.id)
    page = parts.Document(
        title=title,
        author="",
        software=f"softcal {version('softcal')}",
        footer=f"{title}   {say('report.made', at=made, version=version('softcal'))}",
        created_on=made.date(),
        numbering=say("report.page", number="{number}", count="{count}"),
    )
    story = [
        Paragraph(marked_up(title), parts.style(18, BOLD)),
        Spacer(1, 3 * mm),
        parts.property_table(list(report_facts(view, say).items())),
    ]
    listed = say("report.bad", shown=len(bad.units), of=bad.total)
    for part in report_parts(view, bad.units, listed, say):
        drawn: Flowable
        if part.picture and not part.rows:
            drawn = fitted(lot_picture(part.picture, view, LIGHT, say), parts.WIDTH)
        else:
            cells = [[parts.paragraph(cell, 7) for cell in row] for row in (part.header, *part.rows)]
            widths = [parts.WIDTH * share for share in part.shares]
            drawn = Table(cells, colWidths=widths, style=parts.grid(7), repeatRows=1)
        story += parts.section(part.title, drawn)
    return parts.document_pdf(story, page)
