"""Pieces of screen that several pages draw: titles, numbers, figures, tables, ways to a page."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import wraps
from typing import Any

import pandas as pd
import streamlit as st

from softcal.app.ui.browser_memory import HAS_DRAWN, IS_AWAITED, PLACE
from softcal.app.ui.desk import choose, choose_language, empty, say
from softcal.app.ui.pages import PAGES
from softcal.app.ui.server_memory import registry
from softcal.core.lot import UnitKey

NARROWEST_NUMBER_PX = 150
NOTHING = "–"
LONG: Any = {"width": "stretch", "hide_index": True, "placeholder": NOTHING}
"""How a table is drawn that is scrolled in."""

MOST_IN_FULL = 40
MARKDOWN = re.compile(r"([\\`*_{}\[\]<>#$:~|!])")
QUANTITY = re.compile(r"([-+−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?) ([^\s\d]\S*)")
NO_BREAK = "\u00a0"
CLOSER = "[data-testid=stMainBlockContainer] { padding-top: 4.5rem }"
"""The bar of pages needs less room above the title than Streamlit leaves."""


def heading(page: str) -> Any:
    """Draw title and language; return the place between them for a choice."""
    st.html(f"<style>{CLOSER}</style>")
    left, middle, right = st.columns([2, 4, 1.3], vertical_alignment="bottom")
    left.title(say(f"page.{page}"))
    with right:
        choose_language()
    return middle


def headline(said: str) -> None:
    """Draw what a person came for in one sentence, above what needs scripts to be drawn."""
    with st.container(key="headline"):
        st.markdown(said)


def for_lot(page: str) -> Callable[[Callable[[str], None]], Callable[[], None]]:
    """Make the drawing of a lot a page: title and choice of the lot, or how to get a first one."""

    def page_of(draw: Callable[[str], None]) -> Callable[[], None]:
        @wraps(draw)
        def render() -> None:
            beside, lots = heading(page), registry().lots.ids()
            if not lots:
                empty("empty.lots")
                return
            with beside:
                lot_id = choose(say("choose.lot"), lots, "lot")
            if lot_id is not None:
                draw(lot_id)

        return render

    return page_of


def step(page: str, number: int) -> st.delta_generator.DeltaGenerator:
    """Draw the frame of one step of a page that leads through several."""
    box = st.container(border=True)
    box.markdown(f"## {number} · {say(f'{page}.step.{number}')}")
    return box


def rest_may_follow() -> bool:
    """Whether to draw the rest of a page now; else its place is kept, and the page is drawn again in a moment.

    Called by a page once what a person came for is drawn; on False the page returns. The parts of the browser that draw
    figures and tables are megabytes of script: sent at once they would be read before the numbers above them are on the
    screen, so that a page was empty for seconds. A tab that has read them gets everything at once.
    """
    if st.session_state.get(HAS_DRAWN):
        return True
    st.session_state[IS_AWAITED] = True
    with st.container(key=PLACE):
        st.skeleton(height=320)
    return False


def has_units(lot_id: str) -> bool:
    """Whether a unit of the lot has a verdict; else say how units come to be."""
    counts = registry().pages.verdict_counts(lot_id)
    if sum(counts.values()) == counts["none"]:
        empty("empty.units")
        return False
    return True


def numbers(cells: Sequence[tuple[str, str, str | None]], narrowest_px: int = NARROWEST_NUMBER_PX) -> None:
    """Draw (label, value, explanation) side by side, in as many rows as they need."""
    grid = st.grid(min_column_width=narrowest_px)
    for label, value, explanation in cells:
        grid.metric(label, value, help=explanation, border=True, height="stretch")


def show_figure(figure: Any, key: str) -> None:
    """Show a static chart."""
    config = {"displayModeBar": False, "displaylogo": False}
    st.plotly_chart(figure, width="stretch", config=config, key=key, theme=None)


def figure_under(title: str, figure: Any, key: str) -> None:
    """Draw a static chart under its heading."""
    st.header(say(title))
    show_figure(figure, key)


def figures_beside(*shown: tuple[str, Any, str]) -> None:
    """Draw static charts side by side: (title, figure, key) of each."""
    for column, one in zip(st.columns(len(shown)), shown, strict=True):
        with column:
            figure_under(*one)


def find_unit(
    parameter: str, key: str, columns: Sequence[Any], known: Callable[[str], list[UnitKey]], usual: int = 0
) -> UnitKey | None:
    """Draw a field to search serials in and the choice of a unit, which stays in the address as LOT/SERIAL.

    `known` gives the units whose serials hold a text; the one numbered `usual` is chosen at first. None, with the
    reason drawn: there is no unit, or the address has a serial of several lots and none was chosen yet.
    """
    asked = str(st.query_params.get(parameter, ""))
    find, choice = columns
    text = str(find.text_input(say("unit.find"), key=f"{key}-find", icon=":material/search:") or "").strip()
    named, found = _units_named(asked), known(text)
    if len(named) > 1 and not text:
        found = named
        st.info(say("unit.lots", serial=asked, count=len(named)), icon=":material/help:")
    elif not text:
        found = list(dict.fromkeys([*(unit for unit in named if unit not in found), *found]))
    if not found:
        empty("empty.units")
        return None
    index = found.index(named[0]) if len(named) == 1 and named[0] in found else usual % len(found)
    chosen: UnitKey | None = choice.selectbox(
        say("choose.unit"),
        found,
        index=None if found is named else index,
        format_func=lambda unit: f"{unit.serial} · {unit.lot_id}",
        key=f"{key}-choice-{text}-{asked}",
        placeholder=say("choose.some"),
    )
    if chosen is not None and str(chosen) != asked:
        st.query_params[parameter] = str(chosen)
    return chosen


def _units_named(asked: str) -> list[UnitKey]:
    """Return the unit that an address names by LOT/SERIAL, or those of a serial alone."""
    if not asked:
        return []
    if "/" not in asked:
        return [unit.key for unit in registry().lots.units(serial=asked)]
    unit = UnitKey.parse(asked)
    return [registry().calibrations.unit_key(unit.serial, unit.lot_id)]


def go_to(page: str, **query: str) -> None:
    """Open another page of the application in this tab."""
    entry = next(entry for entry in PAGES if entry.name == page)
    st.switch_page(st.Page(entry.render, url_path=entry.name), query_params=query)


def table(listed: Iterable[Mapping[str, object]], otherwise: str = "") -> None:
    """Draw a table to read: a short one in full, a long one to scroll in; of no rows the sentence instead."""
    rows = list(listed)
    if not rows and otherwise:
        st.caption(otherwise)
        return
    if len(rows) > MOST_IN_FULL:
        st.dataframe(pd.DataFrame(rows), **LONG)
        return
    plain = [{_as_it_is(name): _as_it_is(value) for name, value in row.items()} for row in rows]
    st.table(pd.DataFrame(plain), border="horizontal", hide_index=True)


def told(rows: Sequence[Mapping[str, object]]) -> list[dict[str, object]]:
    """Return the rows without the columns in which none says anything."""
    names = [name for name in rows[0] if any(row[name] not in ("", None) for row in rows)] if rows else []
    return [{name: row[name] for name in names} for row in rows]


def _as_it_is(value: object) -> object:
    """Return a text for a cell, which is read as Markdown; a number keeps its unit on its line."""
    if isinstance(value, str) and (quantity := QUANTITY.fullmatch(value)):
        value = NO_BREAK.join(quantity.groups())
    return MARKDOWN.sub(r"\\\1", value) if isinstance(value, str) else NOTHING if value is None else value


def table_to_choose(
    rows: Sequence[Mapping[str, object]], key: str, columns: dict[str, Any] | None = None
) -> int | None:
    """Draw a table to select a row of; return its number, None while none is selected."""
    frame, shown = pd.DataFrame(rows), {"column_config": columns, **LONG}
    event = st.dataframe(frame, key=key, on_select="rerun", selection_mode="single-row", **shown)
    chosen = event.selection.rows
    # A selection outlives a filter that leaves fewer rows.
    return int(chosen[0]) if chosen and chosen[0] < len(rows) else None
