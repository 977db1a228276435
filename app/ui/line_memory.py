"""What the operator's screen remembers: a choice in the browser, a note in the tab, a lot for a moment."""

import os
from datetime import UTC, datetime

import streamlit as st

from softcal.app.line.line import Answer, Choice, LotAtLine, Note, read_lot
from softcal.app.line.rig import spool_folder
from softcal.app.ui.account import scan_badge
from softcal.app.ui.browser_memory import recall, remember
from softcal.app.ui.registry_of_server import registry
from softcal.db.registry import Registry

STATION_VARIABLE = "SOFTCAL_STATION"
"""Environment variable: name of the station at this screen."""

NOTE = "line-note"


def choice() -> Choice:
    """Return what the person at the screen is in the middle of."""
    since, _, serial = recall("unit").partition(" ")
    at = datetime.fromisoformat(since) if serial else datetime.min.replace(tzinfo=UTC)
    is_golden = serial.startswith("GOLDEN:")
    station = recall("station") or os.environ.get(STATION_VARIABLE, "")
    return Choice(station, recall("lot"), serial.removeprefix("GOLDEN:"), is_golden, at)


def remember_answer(answer: Answer) -> None:
    """Keep what a scan led to; the browser has it, so that a reload and a killed server change nothing."""
    chosen = answer.choice
    serial = f"GOLDEN:{chosen.serial}" if chosen.is_golden else chosen.serial
    remember("unit", f"{chosen.since.isoformat()} {serial}" if chosen.serial else "")
    remember("lot", chosen.lot_id)
    st.session_state[NOTE] = answer.note
    if answer.badge is not None:
        scan_badge(answer.badge)


def note() -> Note | None:
    """Return the sentence about the last scan."""
    found: Note | None = st.session_state.get(NOTE)
    return found


def lot_at_line(of: Registry, lot_id: str) -> LotAtLine:
    """Read a lot, or remember it as long as nothing of it changed; whether it did is asked once a second."""
    name = str(of.database.name)
    return _remembered_lot(name, lot_id, _marker(name, lot_id))


@st.cache_resource(ttl="1s", max_entries=16, show_spinner=False)
def _marker(registry_name: str, lot_id: str) -> str:
    return registry().change_marker(lot_id)


@st.cache_resource(max_entries=16, show_spinner=False)
def _remembered_lot(registry_name: str, lot_id: str, marker: str) -> LotAtLine:
    return read_lot(registry(), lot_id)


def kept_runs() -> int:
    """Return how many runs lie on this machine's disk and not in the registry."""
    folder = spool_folder(None)
    return sum(1 for _ in folder.glob("*.spool")) if folder.is_dir() else 0
