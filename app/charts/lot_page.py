"""The report of a lot as a page to take along."""

from collections.abc import Sequence
from html import escape

from softcal.app.charts.lot import PICTURES
from softcal.app.charts.page import document, section, table
from softcal.app.charts.palette import LIGHT
from softcal.app.paper.drawing import svg
from softcal.app.texts.reasons import Translator
from softcal.app.views.lot import LotView
from softcal.app.views.lot_report import report_parts, report_values
from softcal.db.entries import UnitEntry

STYLE = """p { margin: 4px 0; color: #55606c; }
dl { display: flex; flex-wrap: wrap; gap: 8px 32px; margin: 12px 0; }
dt { color: #55606c; font-size: 13px; } dd { margin: 0; font-size: 20px; }
"""


def lot_page(view: LotView, units: Sequence[UnitEntry], translate: Translator, created_text: str) -> str:
    """Return the page of a lot as HTML; `units` are all targets, `created_text` says when and with what."""
    values = report_values(view, translate)
    listed = "".join(f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>" for name, value in values.items())
    head = f"<header><h1>{escape(view.lot.id)}</h1><dl>{listed}</dl><p>{escape(created_text)}</p></header>"
    sections = [head]
    for part in report_parts(view, units, translate("lot.table"), translate):
        if part.picture:
            content = svg(PICTURES[part.picture](view, LIGHT, translate))
        else:
            content = table(part.header, ([escape(cell) for cell in row] for row in part.rows))
        sections.append(section(part.title, content))
    return document(f"softcal: {view.lot.id}", sections, STYLE)
