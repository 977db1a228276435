"""Entry of the Streamlit application: which pages there are for whom, nothing else."""

from pathlib import Path

import streamlit as st
from streamlit.navigation.page import Page as StreamlitPage

from softcal.app.jobs.process import DEMO
from softcal.app.ui.account import is_signed_in, person
from softcal.app.ui.browser_memory import keep, screen
from softcal.app.ui.desk import errors_in_words, in_one_language, readable, say
from softcal.app.ui.pages import pages_for
from softcal.app.ui.server_memory import registry

# A file of our own: a named icon would be fetched from outside.
ICON = Path(__file__).with_name("icon.png")


# The script by which a page says within two seconds that its server is gone.
LIVENESS = Path(__file__).with_name("liveness.js").read_text(encoding="utf-8")
HEALTH = "/_stcore/health"


@in_one_language()
def run() -> None:
    """Draw the navigation and the chosen page."""
    st.set_page_config(page_title=say("app.title"), page_icon=str(ICON), layout="wide")
    readable()
    # Registered here because a component needs a running server; the same again changes nothing.
    watch = st.components.v2.component("softcal_liveness", html="<span hidden></span>", js=LIVENESS)
    watch(data={"server": say("gone.server"), "late": say("gone.late"), "health": HEALTH}, key="liveness")
    with errors_in_words():
        sections: dict[str, list[StreamlitPage]] = {"": []}
        is_new = set(registry().lots.ids()) <= {DEMO}
        for entry in pages_for(person(), is_new):
            title = say(f"section.{entry.section}") if entry.section else ""
            sections.setdefault(title, []).append(
                st.Page(
                    entry.render,
                    title=(person().name if entry.name == "sign_in" and is_signed_in() else say(f"page.{entry.name}")),
                    url_path=entry.name,
                    icon=f":material/{entry.icon}:",
                )
            )
        # The default page has no address of its own: a hidden one leads to the start while there is nothing yet, later
        # to what the person works with.
        bar = sections[""]

        def first() -> None:
            # A line without a station has nothing to do; a screen that was given one waits for it.
            has_line = screen().station or registry().order_queue.stations()
            wanted = "start" if is_new else "line" if has_line else "lot"
            st.switch_page(next((page for page in bar if page.url_path == wanted), bar[0]))

        home = st.Page(first, title=say("app.title"), url_path="home", default=True, visibility="hidden")
        st.navigation({**sections, "": [home, *sections[""]]}, position="top").run()
    keep()


run()
