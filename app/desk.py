"""What every page of the Streamlit application shares: the registry, the language, the colours, and how errors look."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import streamlit as st

from softcal.app.bootstrap import open_chosen_registry
from softcal.app.palette import Palette, palette
from softcal.app.texts import LANGUAGES, text
from softcal.core.errors import SoftcalError
from softcal.db.registry import Registry

PLOT_CONFIG = {"displayModeBar": False, "displaylogo": False}


@st.cache_resource(max_entries=1)
def registry() -> Registry:
    """Return the registry this server was started with; one connection pool for all pages."""
    return open_chosen_registry(None)


def language() -> str:
    """Return the language chosen in the address, English at first."""
    chosen = str(st.query_params.get("lang", "en"))
    return chosen if chosen in LANGUAGES else "en"


def words() -> Callable[..., str]:
    """Return the texts of the chosen language."""
    return partial(text, language())


def colours() -> Palette:
    """Return the colours of the browser's theme."""
    return palette(st.context.theme.type)


def choose_language() -> None:
    """Let a person choose the language; it stays in the address and so survives a reload."""
    codes = list(LANGUAGES)
    chosen = st.selectbox(
        words()("choose.language"),
        codes,
        index=codes.index(language()),
        format_func=LANGUAGES.__getitem__,
        key="language",
    )
    if chosen != language():
        st.query_params["lang"] = chosen
        st.rerun()


@contextmanager
def errors_in_words() -> Iterator[None]:
    """Show what a person can act on instead of a stack trace."""
    try:
        yield
    except SoftcalError as error:
        st.error(str(error), icon=":material/error:", title=words()("registry.failed"))


def empty(title: str, how: str) -> None:
    """Say that there is nothing yet, and how it comes to be."""
    st.info(how, icon=":material/inbox:", title=title)


def verdict_badge(verdict: str | None) -> None:
    """Show a verdict by colour, mark and word."""
    name = verdict or "none"
    mark = {"pass": "✓", "conditional": "!", "fail": "✕", "retest": "↻", "none": "–"}[name]
    ground = colours().verdict[name]
    st.html(
        f'<span role="status" style="background:{ground};color:#fff;border-radius:8px;padding:6px 16px;'
        f'font-size:22px;font-weight:700;white-space:nowrap">{mark} {words()(f"verdict.{name}")}</span>'
    )


def show_figure(figure: Any, key: str) -> None:
    """Show a static chart."""
    st.plotly_chart(figure, width="stretch", config=PLOT_CONFIG, key=key, theme=None)


def choose(label: str, options: list[str], parameter: str) -> str | None:
    """Let a person choose one of some names; the choice stays in the address, so that a link leads back to it."""
    if not options:
        return None
    wanted = st.query_params.get(parameter)
    index = options.index(wanted) if wanted in options else 0
    chosen = str(st.selectbox(label, options, index=index, key=f"choose-{parameter}"))
    if chosen != wanted:
        st.query_params[parameter] = chosen
    return chosen
