"""Pieces of screen that several pages draw: a row of numbers, a figure under its heading, a way to another page."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd
import streamlit as st

from softcal.app.ui.desk import choose, choose_language, empty, registry, show_figure, words
from softcal.app.ui.pages import PAGES

NARROWEST_NUMBER_PX = 150
NOTHING = "–"
MOST_IN_FULL = 40
MARKDOWN = re.compile(r"([\\`*_{}\[\]<>#$:~|!])")
QUANTITY = re.compile(r"([-+−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?) ([^\s\d]\S*)")
NO_BREAK = "\u00a0"
CLOSER = "[data-testid=stMainBlockContainer] { padding-top: 4.5rem }"
"""The bar of pages needs less room above the title than Streamlit leaves."""


def heading(page: str) -> Any:
    """Draw the title of a page with the language at its right; return the place beside the title for a choice."""
    st.html(f"<style>{CLOSER}</style>")
    left, middle, right = st.columns([2, 4, 1.3], vertical_alignment="bottom")
    left.title(words()(f"page.{page}"))
    with right:
        choose_language()
    return middle


def headline(said: str) -> None:
    """Draw what a person came for in one sentence, above everything that needs scripts of its own to be drawn."""
    with st.container(key="headline"):
        st.markdown(said)


def lot_heading(page: str, lots: Sequence[str]) -> str | None:
    """Draw the title of a page with the choice of a lot beside it; return the lot, or say how to get one."""
    beside = heading(page)
    if not lots:
        empty(words()("empty.lots"), words()("empty.lots.how"))
        return None
    with beside:
        return choose(words()("choose.lot"), list(lots), "lot")


def units_of(lot_id: str) -> dict[str, int]:
    """Return how many units of a lot have which verdict; empty where none has one, and say how units come to be."""
    counts = registry().pages.verdict_counts(lot_id)
    if sum(counts.values()) > counts["none"]:
        return counts
    empty(words()("empty.units"), words()("empty.units.how"))
    return {}


def numbers(cells: Sequence[tuple[str, str, str | None]], narrowest_px: int = NARROWEST_NUMBER_PX) -> None:
    """Draw (label, value, explanation) side by side; what does not fit goes to a second row, nothing is cut off."""
    grid = st.grid(min_column_width=narrowest_px)
    for label, value, explanation in cells:
        grid.metric(label, value, help=explanation, border=True, height="stretch")


def figure_under(title: str, figure: Any, key: str) -> None:
    """Draw a static chart under its heading."""
    st.header(words()(title))
    show_figure(figure, key)


def go_to(page: str, **query: str) -> None:
    """Open another page of the application in this tab."""
    entry = next(entry for entry in PAGES if entry.name == page)
    st.switch_page(st.Page(entry.render, url_path=entry.name), query_params=query)


def table(rows: Sequence[Mapping[str, object]]) -> None:
    """Draw a table to read: a short one in full, so that no sentence is cut off; a long one to scroll in."""
    if len(rows) > MOST_IN_FULL:
        st.dataframe(pd.DataFrame(rows), width="stretch", hide_index=True, placeholder=NOTHING)
        return
    plain = [{_as_it_is(name): _as_it_is(value) for name, value in row.items()} for row in rows]
    st.table(pd.DataFrame(plain), border="horizontal", hide_index=True)


def told(rows: Sequence[Mapping[str, object]]) -> list[dict[str, object]]:
    """Return the rows without the columns in which none says anything: a table of many has no room for them."""
    names = [name for name in rows[0] if any(row[name] not in ("", None) for row in rows)] if rows else []
    return [{name: row[name] for name in names} for row in rows]


def _as_it_is(value: object) -> object:
    """Return a text that is no Markdown, as cells of a table would be read; a number keeps its unit on its line."""
    if isinstance(value, str) and (quantity := QUANTITY.fullmatch(value)):
        value = NO_BREAK.join(quantity.groups())
    return MARKDOWN.sub(r"\\\1", value) if isinstance(value, str) else NOTHING if value is None else value


def table_to_choose(
    rows: Sequence[Mapping[str, object]], key: str, columns: dict[str, Any] | None = None
) -> int | None:
    """Draw a table of which a person can select one row; return its number, None while none is selected."""
    event = st.dataframe(
        pd.DataFrame(rows),
        width="stretch",
        hide_index=True,
        on_select="rerun",
        selection_mode="single-row",
        key=key,
        column_config=columns,
        placeholder=NOTHING,
    )
    chosen = event.selection.rows
    # A selection outlives a filter that leaves fewer rows.
    return int(chosen[0]) if chosen and chosen[0] < len(rows) else None
