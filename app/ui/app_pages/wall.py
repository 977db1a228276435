"""The wall board: one lot at one glance, large, drawn again by itself."""

from datetime import UTC, datetime

import streamlit as st

from softcal.app.ui.components import line_card, wall_board
from softcal.app.ui.desk import colours, errors_in_words, registry, words
from softcal.app.ui.lot_memory import remembered_lot_view
from softcal.app.ui.panels import lot_heading, units_of
from softcal.app.views.alerts import alerts
from softcal.app.views.wall import wall_view

EVERY_S = 3.0
"""Between two looks; a lot that did not change costs one query."""


def render() -> None:
    """Draw the page."""
    st.html(line_card.style() + line_card.theme(colours()) + wall_board.style())
    with errors_in_words():
        lot_id = lot_heading("wall", registry().lot_ids())
        if lot_id is None:
            return
        if not units_of(lot_id):
            return
        _board(lot_id)


@st.fragment(run_every=EVERY_S)
@errors_in_words()
def _board(lot_id: str) -> None:
    say, view = words(), remembered_lot_view(lot_id)
    found = alerts(registry(), view, datetime.now(UTC))
    with st.container(key="wall"):
        board = wall_view(registry(), view, found, say)
        st.html(wall_board.board_html(board, say("line.last"), say("wall.well"), say("wall.stations.none")))
