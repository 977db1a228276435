"""The report of a lot, to take along: one PDF of what the page shows."""

from datetime import UTC, datetime

import streamlit as st

from softcal.app.ui.account import actor
from softcal.app.ui.callbacks import in_one_piece
from softcal.app.ui.desk import language, registry, words, zone
from softcal.app.views.lot import LotView


def lot_report(view: LotView) -> None:
    """Offer the report; its bytes are made when somebody takes them."""
    st.download_button(
        words()("lot.report"),
        data=lambda: _pdf(view),
        file_name=f"{view.lot.id}-report.pdf",
        mime="application/pdf",
        icon=":material/picture_as_pdf:",
        key="lot-report",
        on_click=_tell,
        args=(view.lot.id,),
    )


def _pdf(view: LotView) -> bytes:
    from softcal.app.ui.lot_report_pdf import lot_report_pdf

    return lot_report_pdf(registry(), view, language(), datetime.now(UTC).astimezone(zone()))


@in_one_piece
def _tell(lot_id: str) -> None:
    registry().add_event("export", "lots", (lot_id,), {"file": "report.pdf"}, actor=actor())
