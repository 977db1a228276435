"""All lots, and the ways to a new one."""

import streamlit as st

from softcal.app.jobs.launch import DEMO
from softcal.app.ui.account import person
from softcal.app.ui.callbacks import run_uninterrupted
from softcal.app.ui.components.sign_in import ask_sign_in
from softcal.app.ui.components.welcome import welcome
from softcal.app.ui.pages import page_of
from softcal.app.ui.panels import heading, lot_link, table
from softcal.app.ui.presentation import format_instant, translate
from softcal.app.ui.server_cache import registry
from softcal.app.views.common import percent
from softcal.app.views.lots import lot_list


def render() -> None:
    requested_tab = str(st.query_params.get("tab", ""))
    tabs = {tab.name: tab for tab in page_of("lots").tabs}
    if requested_tab in tabs:
        heading("lots", translate("lots.new"))
        _new_lot(requested_tab)
        return
    header_slot = heading("lots")
    rows = lot_list(registry())
    if not {row.lot_id for row in rows} - {DEMO}:
        welcome()
    else:
        with header_slot, st.container(horizontal=True, horizontal_alignment="right"):
            if st.button(translate("lots.new"), type="primary", icon=":material/add:", key="new-lot"):
                st.query_params["tab"] = next(iter(tabs))
                st.rerun()
    if not rows:
        return
    table(
        {
            translate("choose.lot"): lot_link(row.lot_id),
            translate("source.model"): row.sensor_model,
            translate("column.state"): translate(f"lots.state.{row.state}"),
            translate("lots.decided"): f"{row.decided} / {row.units}",
            translate("lot.yield"): percent(None if row.good is None else row.good.value),
            translate("lot.audited"): row.audited,
            translate("lots.released"): row.released,
            translate("lots.changed"): format_instant(row.changed_at),
        }
        for row in rows
    )


def _new_lot(requested_tab: str) -> None:
    """Draw one of the ways to a new lot, and the choice between them."""
    page = page_of("lots")
    names = {tab.name: translate(f"lots.new.{tab.name}") for tab in page.tabs}

    def choose() -> None:
        st.query_params["tab"] = st.session_state["lots-way"]

    label = translate("lots.new")
    st.session_state["lots-way"] = requested_tab
    st.segmented_control(
        label,
        list(names),
        format_func=names.__getitem__,
        required=True,
        key="lots-way",
        on_change=run_uninterrupted(choose),
        label_visibility="collapsed",
    )
    tab = next(tab for tab in page.tabs if tab.name == requested_tab)
    if tab.is_open_to(person()):
        page.draw(requested_tab)
    else:
        ask_sign_in(tab.actions)
