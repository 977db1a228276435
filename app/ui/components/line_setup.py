"""What is set once at an operator's screen: language, station and lot, and which codes it understands."""

import streamlit as st

from softcal.app.line.facts import read_line
from softcal.app.line.line import take_scan
from softcal.app.ui.browser_memory import remember
from softcal.app.ui.desk import choose_language, in_words, registry, words
from softcal.app.ui.line_memory import screen
from softcal.core.errors import InputError, RegistryError


def line_setup() -> None:
    """Draw the settings."""
    say = words()
    choose_language()
    try:
        facts = read_line(registry(), screen())
        station = _choose(say("line.setup.station"), "station", list(facts.stations), facts.station)
        if station:
            remember("station", station)
            st.rerun()
        lot = _choose(say("line.setup.lot"), "lot", list(facts.lots), facts.lot.id if facts.lot else "")
        if lot:
            take_scan(registry(), screen(), f"LOT:{lot}")
            st.rerun()
    except (RegistryError, InputError) as error:
        st.caption(in_words(error))
    st.caption(say("line.setup.codes"))


def _choose(label: str, name: str, names: list[str], now: str) -> str:
    """Return what a person chose instead of what holds now, "" where nothing was."""
    # The key carries what is chosen now: a scan may have changed it since.
    index = names.index(now) if now in names else None
    chosen = st.selectbox(label, names, index, key=f"line-{name}-{now}", placeholder="–")
    return str(chosen) if chosen and chosen != now else ""
