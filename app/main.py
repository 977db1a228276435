"""Entry of the Streamlit application: which pages there are, nothing else."""

from pathlib import Path

import streamlit as st

from softcal.app.app_pages import audit_trail, lot, unit
from softcal.app.desk import words

# A file of our own: a named icon would be fetched from outside.
ICON = Path(__file__).with_name("icon.png")


def run() -> None:
    """Draw the navigation and the chosen page."""
    say = words()
    st.set_page_config(page_title=say("app.title"), page_icon=str(ICON), layout="wide")
    pages = [
        st.Page(lot.render, title=say("page.lot"), url_path="lot", icon=":material/inventory_2:", default=True),
        st.Page(unit.render, title=say("page.unit"), url_path="unit", icon=":material/memory:"),
        st.Page(audit_trail.render, title=say("page.audit"), url_path="audit", icon=":material/history:"),
    ]
    st.navigation(pages, position="top").run()


run()
