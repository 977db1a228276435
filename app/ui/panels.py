"""Pieces of screen that several pages draw: titles, numbers, figures, tables, ways to a page."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import nan
from typing import Any
from urllib.parse import quote, urlencode

import pandas as pd
import streamlit as st

from softcal.app.charts.palette import VERDICT, VERDICT_INK, VERDICT_MARK
from softcal.app.ui.browser_memory import HAS_DRAWN, IS_AWAITED, REST_KEY
from softcal.app.ui.pages import page_of
from softcal.app.ui.presentation import choose, empty, translate
from softcal.app.ui.server_cache import registry
from softcal.core.lot import UnitKey

NARROWEST_NUMBER_PX = 170
VERDICT_STYLE = {
    f"{mark} ": f"background-color: {VERDICT[name]}; color: {VERDICT_INK}" for name, mark in VERDICT_MARK.items()
}
EMPTY_CELL = "–"
LONG: Any = {"width": "stretch", "hide_index": True, "placeholder": EMPTY_CELL}
"""How a table is drawn that is scrolled in."""

MAX_ROWS_IN_FULL = 40
MARKDOWN_CHARACTERS = re.compile(r"([\\`*_{}\[\]<>#$:~|!])")
QUANTITY = re.compile(r"([-+−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?) ([^\s\d]\S*)")
LINK_TEXT = "#(.*)$"
NO_BREAK = "\u00a0"
CLOSER = """[data-testid=stMainBlockContainer] { padding-top: 1.2rem; padding-bottom: 1rem }
[data-testid=stMetric] { margin-block: -0.5rem }"""
"""The bar of pages needs less room above the title than Streamlit leaves, nothing stands below a page, and numbers are
as tall as they are, so that a lot with its alerts stands on one screen."""


def heading(page: str, title: str = "") -> Any:
    """Draw the title of a page, its name unless another is given; return the place beside it for a choice."""
    st.html(f"<style>{CLOSER}</style>")
    left, right = st.columns([2, 3], vertical_alignment="bottom")
    left.title(title or translate(f"page.{page}"))
    return right


def headline(text: str) -> None:
    """Draw what a person came for in one sentence, above what needs scripts to be drawn."""
    with st.container(key="headline"):
        st.markdown(text)


def chosen_lot(page: str) -> str | None:
    """Draw title and choice of a lot, or how to get a first one; return the lot."""
    header_slot, lots = heading(page), registry().lots.ids()
    if not lots:
        empty("empty.lots")
        return None
    with header_slot:
        return choose(translate("choose.lot"), lots, "lot", label_visibility="collapsed")


def step(page: str, number: int) -> st.delta_generator.DeltaGenerator:
    """Draw the frame of one step of a page that leads through several."""
    box = st.container(border=True)
    box.markdown(f"## {number} · {translate(f'{page}.step.{number}')}")
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
    with st.container(key=REST_KEY):
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
    st.header(translate(title))
    show_figure(figure, key)


def show_figures(*figures: tuple[str, Any, str]) -> None:
    """Draw static charts side by side: (title, figure, key) of each."""
    for column, one in zip(st.columns(len(figures)), figures, strict=True):
        with column:
            figure_under(*one)


def units_of_address(address: str) -> list[UnitKey]:
    """Return the unit that an address names by LOT/SERIAL, or those of a serial alone."""
    if not address:
        return []
    if "/" not in address:
        return [unit.key for unit in registry().lots.units(serial=address)]
    unit = UnitKey.parse(address)
    return [registry().calibrations.unit_key(unit.serial, unit.lot_id)]


@dataclass(frozen=True)
class Link:
    """A text of a table that opens a page in a new tab of the browser."""

    text: str
    page: str
    query: tuple[tuple[str, str], ...]

    def __str__(self) -> str:
        return self.text

    @property
    def address(self) -> str:
        return f"{self.page}?{urlencode(self.query)}"

    @property
    def markdown(self) -> str:
        return f"[{_as_it_is(self.text)}]({self.address})"


def unit_link(key: UnitKey) -> Link:
    """Return the link to a unit, named by its serial."""
    return Link(key.serial, "unit", (("unit", str(key)),))


def lot_link(lot_id: str, tab: str = "", text: str = "") -> Link:
    """Return the link to a lot, or to one of its tabs."""
    return Link(text or lot_id, "lot", (("lot", lot_id), *((("tab", tab),) if tab else ())))


def go_to(page: str, **query: str | Sequence[str]) -> None:
    """Open another page of the application in this tab."""
    entry = page_of(page)
    st.switch_page(st.Page(entry.render, url_path=entry.name), query_params=query)


def table(listed: Iterable[Mapping[str, object]], otherwise: str = "") -> None:
    """Draw a table to read: a short one in full, a long one to scroll in; of no rows the sentence instead."""
    rows = with_units_in_heads(list(listed))
    if not rows and otherwise:
        st.caption(otherwise)
        return
    if len(rows) > MAX_ROWS_IN_FULL:
        cells, columns = with_addresses(rows)
        st.dataframe(_style_verdicts(cells, cells), column_config=columns, **LONG)
        return
    plain = [{_as_it_is(name): _as_it_is(value) for name, value in row.items()} for row in rows]
    st.table(_style_verdicts(plain, rows), border="horizontal", hide_index=True)


@dataclass(frozen=True)
class Figure:
    """A number of a column whose head has the unit, with as many decimals as the others there."""

    value: float
    decimals: int


def with_units_in_heads(rows: Sequence[Mapping[str, object]]) -> list[dict[str, object]]:
    """Return rows in which a column of quantities of one unit has numbers, and the unit in its head."""
    names = list(rows[0]) if rows else []
    columns = {name: _figures([row.get(name) for row in rows]) for name in names}
    heads = {name: f"{name} [{columns[name][0]}]" if columns[name][0] else name for name in names}
    return [{heads[name]: columns[name][1][k] for name in names} for k in range(len(rows))]


def _figures(cells: Sequence[object]) -> tuple[str, Sequence[object]]:
    """Return the one unit of a column of quantities and its numbers; else "" and the cells as they are."""
    numbers = [QUANTITY.fullmatch(cell) if isinstance(cell, str) else None for cell in cells]
    units = {one[2] for one in numbers if one}
    is_other = any(cell not in ("", EMPTY_CELL, None) and not one for cell, one in zip(cells, numbers, strict=True))
    if len(units) != 1 or is_other:
        return "", cells
    max_decimals = max(len(one[1].partition(".")[2]) for one in numbers if one)
    return units.pop(), [Figure(float(one[1]) if one else nan, max_decimals) for one in numbers]


def _style_verdicts(cells: Sequence[Mapping[Any, object]], rows: Sequence[Mapping[str, object]]) -> Any:
    """Return what is shown as a table in which every verdict has its colour beside its mark."""
    figures = {name: one.decimals for row in cells for name, one in row.items() if isinstance(one, Figure)}
    plain = [{n: one.value if isinstance(one, Figure) else one for n, one in row.items()} for row in cells]
    frame = pd.DataFrame(plain).convert_dtypes()
    styles = [[VERDICT_STYLE.get(str(value)[:2], "") for value in row.values()] for row in rows]
    if not any(map(any, styles)) and not figures:
        return frame
    formats: Any = {name: f"{{:.{decimals}f}}" for name, decimals in figures.items()}
    styled = frame.style.format(formats, na_rep=EMPTY_CELL) if formats else frame.style
    return styled.apply(lambda _: pd.DataFrame(styles, frame.index, frame.columns), axis=None)


def with_addresses(rows: Sequence[Mapping[str, object]]) -> tuple[list[dict[str, object]], dict[str, Any]]:
    """Return rows with the addresses of their links, and how those columns are drawn."""
    names = {name for row in rows for name, value in row.items() if isinstance(value, Link)}
    columns = {name: st.column_config.LinkColumn(name, display_text=LINK_TEXT) for name in names}
    return [{name: _address(value) for name, value in row.items()} for row in rows], columns


def _address(value: object) -> object:
    # The text of a link stands behind its address: a column has one pattern for all its links.
    return f"{value.address}#{quote(value.text)}" if isinstance(value, Link) else value


def drop_empty_columns(rows: Sequence[Mapping[str, object]]) -> list[dict[str, object]]:
    """Return the rows without the columns in which none says anything."""
    names = [name for name in rows[0] if any(row[name] not in ("", None) for row in rows)] if rows else []
    return [{name: row[name] for name in names} for row in rows]


def _as_it_is(value: object) -> object:
    """Return a text for a cell, which is read as Markdown; a number keeps its unit, a verdict its mark, on its line."""
    if isinstance(value, Link):
        return value.markdown
    if isinstance(value, str) and (value[:2] in VERDICT_STYLE or QUANTITY.fullmatch(value)):
        value = value.replace(" ", NO_BREAK)
    return MARKDOWN_CHARACTERS.sub(r"\\\1", value) if isinstance(value, str) else EMPTY_CELL if value is None else value


def table_to_choose(
    rows: Sequence[Mapping[str, object]], key: str, columns: dict[str, Any] | None = None
) -> int | None:
    """Draw a table to select a row of; return its number, None while none is selected."""
    addressed, links = with_addresses(rows)
    options = {"column_config": {**links, **(columns or {})}, **LONG}
    event = st.dataframe(
        _style_verdicts(addressed, rows), key=key, on_select="rerun", selection_mode="single-row", **options
    )
    chosen = event.selection.rows
    # A selection outlives a filter that leaves fewer rows.
    return int(chosen[0]) if chosen and chosen[0] < len(rows) else None
