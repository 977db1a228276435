"""What is set once at an operator's screen: language, station and lot, and which codes it understands."""

import streamlit as st

from softcal.app.ui.browser_memory import remember
from softcal.app.ui.desk import choose_language, in_words, registry, words
from softcal.app.ui.line_memory import choice
from softcal.core.errors import RegistryError


def line_setup() -> None:
    """Draw the settings."""
    say = words()
    choose_language()
    try:
        stations = [beat.station for beat in registry().order_queue.stations()]
        _choose(say("line.setup.station"), "station", stations, choice().station)
        _choose(say("line.setup.lot"), "lot", registry().lot_ids(), choice().lot_id)
    except RegistryError as error:
        st.caption(in_words(error))
    st.caption(say("line.setup.codes"))


def _choose(label: str, name: str, names: list[str], now: str) -> None:
    # The key carries what is chosen now: a scan may have changed it since.
    index = names.index(now) if now in names else None
    chosen = st.selectbox(label, names, index, key=f"line-{name}-{now}", placeholder="–")
    if chosen and chosen != now:
        remember(name, str(chosen))
        st.rerun()
