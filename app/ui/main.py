"""Entry of the Streamlit application: the bar and the pages, nothing else."""

from functools import partial
from pathlib import Path

import streamlit as st
from streamlit.navigation.page import Page as StreamlitPage

from softcal.app.ui.browser_memory import screen, sync_browser
from softcal.app.ui.components.bar import draw_bar
from softcal.app.ui.pages import PAGES, REDIRECTS, redirect
from softcal.app.ui.panels import go_to
from softcal.app.ui.presentation import in_one_language, readable, show_errors, translate
from softcal.app.ui.server_cache import registry

# A file of our own: a named icon would be fetched from outside.
ICON = Path(__file__).with_name("icon.png")


# The script by which a page says within two seconds that its server is gone.
LIVENESS = Path(__file__).with_name("liveness.js").read_text(encoding="utf-8")
HEALTH = "/_stcore/health"


def _home() -> None:
    """Open what the person works with: a line without a station has nothing to do."""
    has_line = screen().station or registry().order_queue.stations()
    go_to("line" if has_line else "lots")


def _redirect(address: str) -> None:
    """Open what an address that was is called now."""
    page, query = redirect(address, {name: st.query_params.get_all(name) for name in st.query_params})
    go_to(page, **query)


@in_one_language()
def run() -> None:
    """Draw the navigation and the chosen page."""
    st.set_page_config(page_title=translate("app.title"), page_icon=str(ICON), layout="wide")
    readable()
    # Registered here because a component needs a running server; the same again changes nothing.
    liveness = st.components.v2.component("softcal_liveness", html="<span hidden></span>", js=LIVENESS)
    texts = {"server": translate("gone.server"), "late": translate("gone.late"), "files": translate("choose.files")}
    liveness(data={**texts, "health": HEALTH}, key="liveness")
    with show_errors():
        bar: list[StreamlitPage] = []
        hidden: list[StreamlitPage] = []
        for entry in PAGES:
            title, is_hidden = translate(f"page.{entry.name}"), not entry.icon
            icon = f":material/{entry.icon}:" if entry.icon else None
            page = st.Page(
                entry.render,
                title=title,
                url_path=entry.name,
                icon=icon,
                visibility="hidden" if is_hidden else "visible",
            )
            (hidden if is_hidden else bar).append(page)
        for name in REDIRECTS:
            hidden.append(
                st.Page(partial(_redirect, name), title=translate("app.title"), url_path=name, visibility="hidden")
            )
        home = st.Page(_home, title=translate("app.title"), url_path="home", default=True, visibility="hidden")
        page = st.navigation([home, *bar, *hidden], position="top")
        draw_bar(page.url_path)
        page.run()
    sync_browser()


run()
