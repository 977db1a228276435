"""What every page shares: the language, the colours, reasons, and how errors look."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import datetime, tzinfo
from html import escape
from typing import Any
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import streamlit as st

from softcal.app.charts.palette import VERDICT_INK, VERDICT_MARK, Palette, palette
from softcal.app.logs import log_crash
from softcal.app.texts import catalogue
from softcal.app.texts.catalogue import LANGUAGES, make_translator
from softcal.app.texts.reasons import Translator, render_message, render_reason, render_reasons
from softcal.app.ui.browser_memory import recall, remember
from softcal.core.errors import SoftcalError, printable
from softcal.core.messages.reason import Reason

LONGEST_IN_FIELD = 24
LANGUAGE = "lang"
FIRST = "first-of-page"
HIDDEN_STYLE = f".st-key-{FIRST} {{ display: none }}"


def language() -> str:
    """Return the language of the address, else this browser's last or own, else English."""
    chosen = str(st.query_params.get(LANGUAGE) or recall(LANGUAGE) or (st.context.locale or "").partition("-")[0])
    return chosen if chosen in LANGUAGES else "en"


def zone() -> tzinfo | None:
    """Return the time zone of the browser; None, that of this machine, where it says none."""
    try:
        return ZoneInfo(st.context.timezone or "")
    except (ValueError, ZoneInfoNotFoundError):
        return None


def format_instant(at: datetime | None) -> str:
    """Return an instant in the browser's time zone; a dash where there is none."""
    return "–" if at is None else catalogue.format_instant(at.astimezone(zone()))


_TRANSLATOR: ContextVar[Translator | None] = ContextVar("words", default=None)
"""The texts of one drawing: to look the language up for each of them takes half a millisecond."""


@contextmanager
def in_one_language() -> Iterator[None]:
    """Draw in the language that is chosen now."""
    token = _TRANSLATOR.set(make_translator(language(), zone()))
    try:
        yield
    finally:
        _TRANSLATOR.reset(token)


def current_translator() -> Translator:
    """Return the texts of the chosen language, with instants in the browser's time zone."""
    return _TRANSLATOR.get() or make_translator(language(), zone())


def translate(key: str, /, **values: object) -> str:
    """Return one of these texts."""
    return current_translator()(key, **values)


def label_formatter(kind: str) -> Callable[[str], str]:
    """Return how one of several names is said: the text KIND.NAME."""
    return lambda name: translate(f"{kind}.{name}")


def localize(message: SoftcalError | Reason | Iterable[Reason] | str) -> str:
    """Return an error, what a station says, or what a job kept as text, in the chosen language."""
    if isinstance(message, SoftcalError):
        return printable(render_reason(message.reason, translate))
    if isinstance(message, Reason):
        return render_reason(message, translate)
    return render_message(message, translate) if isinstance(message, str) else render_reasons(message, translate)


def colours() -> Palette:
    """Return the colours of the browser's theme."""
    return palette(st.context.theme.type)


def readable() -> None:
    """Give what Streamlit draws too pale on its ground a contrast of 4.5:1; once per page."""
    pale = "[data-testid=stCaptionContainer] { opacity: 0.8 !important }"
    selectors = (
        "[role=tab][aria-selected=true]",
        "button[aria-checked=true]",
        "[data-testid=stPagination] [aria-current]",
    )
    chosen = ", ".join(f"{selector}, {selector} *" for selector in selectors)
    # A section follows the title at once, so that no level is left out; it is drawn smaller than Streamlit would.
    section = ":is([data-testid=stHeading], [data-testid=stMarkdownContainer]) h2"
    small = f"{section} {{ font-size: 1.5rem !important; padding: 0.4rem 0 0.6rem !important }}"
    # Korean is broken between words, as its readers are used to: else a narrow column stands its words upright.
    cells = "[data-testid=stTable] :is(th, td)"
    word_break_rule = f"{cells}, {cells} * {{ word-break: keep-all !important }}"
    # Streamlit's own words in fields for files are English.
    texts = {
        "button [data-testid=stMarkdownContainer]": translate("choose.files"),
        "[data-testid=stFileUploaderDropzoneInstructions]": translate(
            "choose.files.size", size=st.get_option("server.maxUploadSize")
        ),
    }
    fields = {f"[data-testid=stFileUploaderDropzone] {part}": text for part, text in texts.items()}
    files = " ".join(f'{at} > * {{ display: none }} {at}::after {{ content: "{text}" }}' for at, text in fields.items())
    chosen_too = f"{chosen} {{ color: {colours().chosen} !important }}"
    style = f"<style>{word_break_rule} {files} {pale} {small} {chosen_too} {HIDDEN_STYLE}</style>"
    # With something to draw the script behind every piece of HTML is asked for before those of the page's fields.
    with st.container(key=FIRST):
        st.html(f"{style}<span></span>")


def choose_language() -> None:
    """Let a person choose the language; the browser remembers it."""
    codes = list(LANGUAGES)
    label, now = translate("choose.language"), codes.index(language())
    names = LANGUAGES.__getitem__
    chosen = st.selectbox(label, codes, now, names, key="language", label_visibility="collapsed")
    if chosen != language():
        remember(LANGUAGE, chosen)
        st.query_params.pop(LANGUAGE, None)
        st.rerun()


@contextmanager
def show_errors() -> Iterator[None]:
    """Show what a person can act on, not a stack trace; the unforeseen goes to the log."""
    with in_one_language():
        try:
            yield
        except SoftcalError as error:
            st.error(localize(error), icon=":material/error:", title=translate("error.refused"))
        except Exception as error:
            st.error(log_crash(error, "ui"), icon=":material/report:", title=translate("error.defect"))


def empty(key: str, hint: str = "") -> None:
    """Say that there is nothing yet, and how it comes to be: the texts KEY and KEY.how."""
    st.info(hint or translate(f"{key}.how"), icon=":material/inbox:", title=translate(key))


def verdict_word(verdict: str | None) -> str:
    """Return a verdict as its mark and its word."""
    name = verdict or "none"
    return f"{VERDICT_MARK[name]} {translate(f'verdict.{name}')}"


def verdict_badge(verdict: str | None, note: str = "") -> None:
    """Show a verdict by colour, mark and word, and some words beside it."""
    name = verdict or "none"
    ground = colours().verdict[name]
    st.html(
        f'<span role="status" style="background:{ground};color:{VERDICT_INK};border-radius:8px;padding:6px 16px;'
        f'font-size:22px;font-weight:700;white-space:nowrap">{verdict_word(name)}</span> &nbsp; <b>{escape(note)}</b>'
    )


def choose(label: str, options: list[str], parameter: str, **look: Any) -> str | None:
    """Let a person choose a name; the choice stays in the address, so that a link keeps it."""
    if not options:
        return None
    requested = st.query_params.get(parameter)
    index = options.index(requested) if requested in options else 0
    chosen = str(st.selectbox(label, options, index=index, key=f"choose-{parameter}", **look))
    if chosen != requested:
        st.query_params[parameter] = chosen
    in_full(chosen)
    return chosen


def in_full(name: str) -> None:
    """Say a name in full below the field that has no room for it."""
    if len(name) > LONGEST_IN_FIELD:
        st.caption(name)
