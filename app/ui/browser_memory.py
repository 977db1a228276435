"""What a browser remembers for this server, in cookies; and whether it has drawn the page."""

import os
import secrets
from collections.abc import Mapping
from urllib.parse import unquote

import streamlit as st

from softcal.app.line.status import Screen
from softcal.app.ui.callbacks import run_uninterrupted
from softcal.app.ui.secret_cookies import HEADER, PATH, new_ticket

STATION_VARIABLE = "SOFTCAL_STATION"
"""Environment variable: name of the station at this screen."""

STATE, TAB = "browser-memory", "line-tab"
SECRETS, TICKET = "browser-secrets", "browser-ticket"
HTML = "<span hidden></span>\n"
JS = """
export default function ({ data, setTriggerValue }) {
  for (const [name, value] of Object.entries(data.told)) {
    const age = value === "" ? "; Max-Age=0" : ""
    document.cookie = `${name}=${encodeURIComponent(value)}; Path=/; SameSite=Strict${age}`
  }
  if (data.ticket) fetch(data.path, { method: "POST", headers: { [data.header]: "1" }, body: data.ticket })
  if (!data.asks) return
  // What is still being read stands as a skeleton; so does the place of the rest, which is not waited for.
  const count = (where) => document.querySelectorAll(`${where} [data-testid=stSkeleton]`).length
  const isDrawn = () => count("body") === count(`.st-key-${data.place}`)
  const last = performance.now() + data.longest_ms
  const idle = window.requestIdleCallback ?? setTimeout
  const look = () => requestAnimationFrame(() =>
    isDrawn() || performance.now() > last ? idle(() => setTriggerValue("drawn", true)) : look())
  look()
}
"""
HAS_DRAWN, IS_AWAITED = "browser-has-drawn", "browser-is-awaited"
REST_KEY = "rest-of-page"
LONGEST_MS = 3000
"""Whatever stands as a skeleton, the rest of a page comes after this time."""


def recall(name: str) -> str:
    """Return what was remembered in this tab or, after a reload, this browser; "" without."""
    tab_values = st.session_state.get(STATE, {})
    return str(tab_values[name]) if name in tab_values else unquote(_cookies().get(_cookie(name), ""))


def remember(name: str, value: str) -> None:
    """Remember a text; the browser hears of it at the end of this run, by `sync_browser`."""
    st.session_state[STATE] = st.session_state.get(STATE, {}) | {name: value}


def remember_secret(name: str, value: str) -> None:
    """Remember a text that no script of a page may read; "" forgets it."""
    remember(name, value)
    st.session_state[SECRETS] = st.session_state.get(SECRETS, {}) | {_cookie(name): value}
    st.session_state[TICKET] = new_ticket(st.session_state[SECRETS])


def screen(version: int | None = None, until_s: float | None = None) -> Screen:
    """Return which screen of a line this is, what its person has seen, and until when a key waits."""
    tab = str(st.session_state.setdefault(TAB, secrets.token_hex(8)))
    return Screen(recall("station") or os.environ.get(STATION_VARIABLE, ""), tab, version, until_s)


def sync_browser() -> None:
    """Tell the browser what to remember, and ask what it has drawn; once at the end of a run."""
    cookies = {_cookie(name): value for name, value in st.session_state.get(STATE, {}).items()}
    plain_cookies = {name: value for name, value in cookies.items() if name not in st.session_state.get(SECRETS, {})}
    # A ticket is used once; drawn again with the same one, the browser asks in vain and keeps what it has.
    ticket = {"ticket": st.session_state.get(TICKET, ""), "path": PATH, "header": HEADER}
    # Registered here because a component needs a running server; the same again changes nothing.
    draw = st.components.v2.component("softcal_memory", html=HTML, js=JS)
    asks_drawn = bool(st.session_state.get(IS_AWAITED)) and not st.session_state.get(HAS_DRAWN)
    draw(
        data={"told": plain_cookies, "asks": asks_drawn, "place": REST_KEY, "longest_ms": LONGEST_MS, **ticket},
        key="browser-memory-component",
        on_drawn_change=run_uninterrupted(_has_drawn),
    )


def _cookies() -> Mapping[str, str]:
    return st.context.cookies


def _has_drawn() -> None:
    st.session_state[HAS_DRAWN] = True


def _cookie(name: str) -> str:
    # Cookies do not tell ports apart, but two servers on one machine are two.
    return f"softcal_{st.get_option('server.port')}_{name}"
