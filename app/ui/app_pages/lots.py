"""All lots, and the ways to a new one."""

import streamlit as st

from softcal.app.jobs.launch import DEMO
from softcal.app.ui.account import person
from softcal.app.ui.callbacks import in_one_piece
from softcal.app.ui.components.sign_in import ask_sign_in
from softcal.app.ui.components.welcome import welcome
from softcal.app.ui.desk import instant, say
from softcal.app.ui.pages import page_of
from softcal.app.ui.panels import heading, lot_link, table
from softcal.app.ui.server_memory import registry
from softcal.app.views.common import percent
from softcal.app.views.lots import lot_list


def render() -> None:
    asked = str(st.query_params.get("tab", ""))
    tabs = {tab.name: tab for tab in page_of("lots").tabs}
    if asked in tabs:
        heading("lots", say("lots.new"))
        _new_lot(asked)
        return
    beside = heading("lots")
    rows = lot_list(registry())
    if not {row.lot_id for row in rows} - {DEMO}:
        welcome()
    else:
        with beside, st.container(horizontal=True, horizontal_alignment="right"):
            if st.button(say("lots.new"), type="primary", icon=":material/add:", key="new-lot"):
                st.query_params["tab"] = next(iter(tabs))
                st.rerun()
    if not rows:
        return
    table(
        {
            say("choose.lot"): lot_link(row.lot_id),
            say("source.model"): row.sensor_model,
            say("column.state"): say(f"lots.state.{row.state}"),
            say("lots.decided"): f"{row.decided} / {row.units}",
            say("lot.yield"): percent(None if row.good is None else row.good.value),
            say("lot.audited"): row.audited,
            say("lots.released"): row.released,
            say("lots.changed"): instant(row.changed_at),
        }
        for row in rows
    )


def _new_lot(asked: str) -> None:
    """Draw one of the ways to a new lot, and the choice between them."""
    page = page_of("lots")
    names = {tab.name: say(f"lots.new.{tab.name}") for tab in page.tabs}

    def choose() -> None:
        st.query_params["tab"] = st.session_state["lots-way"]

    label = say("lots.new")
    st.session_state["lots-way"] = asked
    st.segmented_control(
        label,
        list(names),
        format_func=names.__getitem__,
        required=True,
        key="lots-way",
        on_change=in_one_piece(choose),
        label_visibility="collapsed",
    )
    tab = next(tab for tab in page.tabs if tab.name == asked)
    if tab.is_open_to(person()):
        page.draw(asked)
    else:
        ask_sign_in(tab.actions)
