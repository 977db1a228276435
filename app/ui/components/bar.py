"""The right end of the bar: the search and who is here."""

from typing import Any

import streamlit as st

from softcal.app.ui.account import person
from softcal.app.ui.callbacks import run_uninterrupted
from softcal.app.ui.panels import Link, go_to, table
from softcal.app.ui.presentation import translate
from softcal.app.ui.server_cache import registry
from softcal.app.views.search import search

KEY, WIDTH_PX = "bar-search", 320
STYLE = f"""<style>
.st-key-bar {{ position: fixed; top: 0.35rem; right: 3.2rem; z-index: 999991; width: {WIDTH_PX}px }}
[data-testid=stHeader] {{ padding-right: {WIDTH_PX + 40}px }}
@media (max-width: 900px) {{ .st-key-bar {{ width: 250px }} [data-testid=stHeader] {{ padding-right: 300px }} }}
</style>"""
BELOW = {"lot": "lots", "unit": "lots"}
"""Pages without a place in the bar → the one of the bar that they belong to."""

OPEN_PAGE_STYLE = (
    '<style>[data-testid=stTopNavLink][href$="/{page}"] {{ background: rgba(127, 140, 153, 0.22) }}</style>'
)
WITHOUT_SEARCH = ("line",)
"""Pages whose own field takes what is typed."""


def draw_bar(page: str) -> None:
    """Draw the search and the person in the bar, and what the search found above the page."""
    text, is_submitted = "", st.session_state.pop(f"{KEY}-asked", "")
    with st.container(key="bar", horizontal=True, horizontal_alignment="right", vertical_alignment="center"):
        st.html(STYLE + (OPEN_PAGE_STYLE.format(page=BELOW[page]) if page in BELOW else ""))
        if page not in WITHOUT_SEARCH:
            options: Any = {"placeholder": translate("bar.search"), "label_visibility": "collapsed", "type": "search"}
            label, icon = translate("bar.search.what"), ":material/search:"
            text = str(
                st.text_input(label, key=KEY, icon=icon, on_change=run_uninterrupted(_mark_submitted), **options) or ""
            )
        name = person().name or translate("sign_in")
        if st.button(name, key="bar-person", type="tertiary", icon=":material/person:"):
            go_to("settings", tab="account")
    if not text:
        return
    hits = search(registry(), text)
    if len(hits) == 1 and is_submitted:
        go_to(hits[0].page, **hits[0].query)
    if not hits:
        st.info(translate("bar.search.none", text=text), icon=":material/search_off:")
        return
    kind, name = translate("bar.search.kind"), translate("sign_in.name")
    with st.container(border=True):
        table(
            {kind: translate(f"bar.kind.{hit.kind}"), name: Link(hit.name, hit.page, tuple(hit.query.items()))}
            for hit in hits
        )


def _mark_submitted() -> None:
    st.session_state[f"{KEY}-asked"] = True
