"""What the operator's screen remembers by itself: its station, its tab, a lot for a moment."""

import os
import secrets

import streamlit as st

from softcal.app.line.facts import LotAtLine, Screen, read_lot
from softcal.app.line.rig import spool_folder
from softcal.app.ui.browser_memory import recall
from softcal.app.ui.server_memory import registry
from softcal.db.registry import Registry

STATION_VARIABLE = "SOFTCAL_STATION"
"""Environment variable: name of the station at this screen."""

TAB, REFUSED = "line-tab", "line-refused"


def screen(seen: int | None = None, until_s: float | None = None) -> Screen:
    """Return which screen this is, what its person has seen, and until when a key waits."""
    tab = str(st.session_state.setdefault(TAB, secrets.token_hex(8)))
    return Screen(recall("station") or os.environ.get(STATION_VARIABLE, ""), tab, seen, until_s)


def remember_refusal(why: str) -> None:
    """Keep why a scan was not taken where the registry cannot; "" forgets it."""
    st.session_state[REFUSED] = why


def refusal() -> str:
    """Return why the last scan was not taken, "" where it was."""
    return str(st.session_state.get(REFUSED, ""))


def lot_at_line(of: Registry, lot_id: str) -> LotAtLine:
    """Read a lot, or remember it while nothing of it changes; asked once a second."""
    name = str(of.database.name)
    return _remembered_lot(name, lot_id, _marker(name, lot_id))


@st.cache_resource(ttl="1s", max_entries=16, show_spinner=False)
def _marker(registry_name: str, lot_id: str) -> str:
    return registry().pages.change_marker(lot_id)


@st.cache_resource(max_entries=16, show_spinner=False)
def _remembered_lot(registry_name: str, lot_id: str, marker: str) -> LotAtLine:
    return read_lot(registry(), lot_id)


def kept_runs() -> int:
    """Return how many runs lie on this machine's disk and not in the registry."""
    folder = spool_folder(None)
    return sum(1 for _ in folder.glob("*.spool")) if folder.is_dir() else 0
