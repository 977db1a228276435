"""Who is here, and the language of the screens."""

import streamlit as st

from softcal.app.ui.components.sign_in import sign_in_panel
from softcal.app.ui.desk import choose_language


def draw() -> None:
    _, middle, _ = st.columns([1, 2, 1])
    with middle:
        choose_language()
    sign_in_panel()
