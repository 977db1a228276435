"""The field every scan goes into: always in focus, with F-keys, heard by screen readers."""

import time
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

import streamlit as st

from softcal.app.line.line import START_S
from softcal.app.ui.callbacks import run_uninterrupted
from softcal.app.ui.stop_key import PATH as STOP_PATH

KEY, LAST_SCAN = "scan-field", "scan-taken"
HTML = """
<label>
  <svg width="34" height="28" viewBox="0 0 34 28" aria-hidden="true" fill="currentColor">
    <path d="M0 0h3v28H0zM6 0h2v28H6zM11 0h4v28h-4zM18 0h2v28h-2zM23 0h3v28h-3zM29 0h1.5v28H29zM32 0h2v28h-2z"/>
  </svg>
  <span></span>
  <input type="text" inputmode="none" autocomplete="off" autocapitalize="off" spellcheck="false">
</label>
<p role="alert" hidden></p>
<div role="status" aria-live="assertive"></div>
"""


def scan_field(
    texts: Mapping[str, str],
    version: int,
    keys: Mapping[str, str],
    station: str,
    on_scan: Callable[[str, int | None, float | None], None],
) -> None:
    """Draw the field.

    Args:
        texts: `label`, `placeholder`, `late`: said of a scan (`%`) that was not taken in time, and
            `spoken`: what screen readers say when it changes.
        version: names what is shown; every scan comes back with what was seen when it was made.
        keys: function key → command; a press is the same as a scan of `CMD:COMMAND`.
        station: that a stop is for; "" for the only one.
        on_scan: takes what was scanned, what was seen and until when by `time.monotonic()` it may be
            taken, before the page is drawn again.
    """

    def forward_scans() -> None:
        for scan in st.session_state[KEY].scan or ():
            # The browser sends a scan again until it hears that it was taken.
            if scan["id"] > st.session_state.get(LAST_SCAN, 0):
                st.session_state[LAST_SCAN] = scan["id"]
                on_scan(str(scan["text"]), int(scan["seen"]), float(scan["until_s"]))

    # Registered here because a component needs a running server; the same again changes nothing.
    draw = st.components.v2.component("softcal_scan", html=HTML, css=_read_asset(".css"), js=_read_asset(".js"))
    last_scan = st.session_state.get(LAST_SCAN, 0)
    # The instant makes every drawing another one: the browser sees by it that the screen is not left behind, and what
    # this machine's clock says.
    data = {**texts, "keys": dict(keys), "taken": last_scan, "seen": version, "at": time.monotonic()}
    data |= {"stop": STOP_PATH, "station": station, "start_s": START_S}
    draw(data=data, key=KEY, on_scan_change=run_uninterrupted(forward_scans))


@cache
def _read_asset(suffix: str) -> str:
    return Path(__file__).with_suffix(suffix).read_text(encoding="utf-8")
