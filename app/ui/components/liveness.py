"""Every page says within two seconds that its server is gone, in its own language, and when it is back."""

from functools import cache
from pathlib import Path

import streamlit as st

from softcal.app.ui.desk import say

HEALTH = "/_stcore/health"


def liveness() -> None:
    """Draw nothing, and watch; once per page."""
    # Registered here because a component needs a running server; the same again changes nothing.
    draw = st.components.v2.component("softcal_liveness", html="<span hidden></span>", js=_script())
    draw(data={"server": say("gone.server"), "late": say("gone.late"), "health": HEALTH}, key="liveness")


@cache
def _script() -> str:
    return Path(__file__).with_suffix(".js").read_text(encoding="utf-8")
