"""Tabs of a page: the open one is drawn, or a sign-in in its place."""

import streamlit as st

from softcal.app.ui.account import person
from softcal.app.ui.callbacks import run_uninterrupted
from softcal.app.ui.components.sign_in import ask_sign_in
from softcal.app.ui.pages import page_of
from softcal.app.ui.presentation import translate


def draw_tabs(page: str, *subject: object) -> None:
    """Draw the tabs of a page for what it is about, and the open one: the first, or `tab` of the address.

    A tab that the role may not see is listed where the address asks for it, and asks for a sign-in in its place.
    """
    entry, requested_tab, user = page_of(page), str(st.query_params.get("tab", "")), person()
    tabs = [tab for tab in entry.tabs if tab.name == requested_tab or tab.is_open_to(user)]
    names, key = {translate(f"tab.{tab.name}"): tab for tab in tabs}, f"tab-{page}"
    title = next((title for title, tab in names.items() if tab.name == requested_tab), next(iter(names), ""))
    if not title:
        ask_sign_in(entry.tabs[0].actions)
        return
    st.session_state[key] = title

    def choose_tab() -> None:
        st.query_params["tab"] = names[st.session_state[key]].name

    containers = st.tabs(list(names), key=key, on_change=run_uninterrupted(choose_tab))
    with containers[list(names).index(title)]:
        tab = names[title]
        if tab.is_open_to(user):
            entry.draw(tab.name, *subject)
        else:
            ask_sign_in(tab.actions)
