"""The units of a lot as a table: filtered, sorted and paged in SQL, and exported as a whole."""

import streamlit as st

from softcal.app.registry.limit import limit_or_none
from softcal.app.texts.reasons import all_said
from softcal.app.ui.actions import csv_of, download, excel_of
from softcal.app.ui.desk import errors_in_words, in_one_language, named, say, verdict_word
from softcal.app.ui.panels import go_to, table_to_choose, unit_link
from softcal.app.ui.server_memory import registry
from softcal.app.views.common import decimals
from softcal.core.lot import Lot
from softcal.core.unit.verdict import VERDICTS
from softcal.db.entries import UnitEntry
from softcal.db.truth.lot_pages import UnitFilter

SIZE = 50
WORDS = (*reversed(VERDICTS), "none")
"""What a unit can be filtered by, worst first."""

SORTS = ("severity", "serial", "predicted_rmse", "after_rmse", "made_at")
NUMBERS = ("predicted", "before", "after", "own")
Serials = tuple[str, ...] | None


@st.fragment
@errors_in_words()
def unit_table(lot: Lot, serials: Serials) -> None:
    """Draw the table of a lot, or of some serials, so that filters draw nothing else."""
    verdicts = st.pills(
        say("column.verdict"),
        WORDS,
        selection_mode="multi",
        format_func=named("verdict"),
        key=f"units-verdicts-{lot.id}",
    )
    middle, right = st.columns([3, 2], vertical_alignment="bottom")
    text = middle.text_input(say("unit.find"), key=f"units-find-{lot.id}", icon=":material/search:")
    sort = right.selectbox(say("lot.table.sort"), SORTS, format_func=named("sort"), key=f"units-sort-{lot.id}")
    is_falling = sort in ("predicted_rmse", "after_rmse", "made_at")
    wanted = UnitFilter(tuple(verdicts), str(text or "").strip(), sort, is_falling, serials)
    place = f"units-page-{lot.id}"
    page = registry().pages.unit_page(
        lot.id, wanted, size=SIZE, before=SIZE * (int(st.session_state.get(place, 1)) - 1)
    )
    if page.total and not page.units:
        # The filter leaves fewer pages than the one that was looked at.
        st.session_state[place] = 1
        page = registry().pages.unit_page(lot.id, wanted, size=SIZE)
    units = page.units
    if not units:
        st.caption(say("lot.table.none"))
        return
    columns, limit = {}, limit_or_none(registry(), lot.id)
    shown = "%.4g" if limit is None else f"%.{decimals(limit.maximum_rmse)}f"
    for name in (say(f"column.{name}") for name in NUMBERS):
        columns[name] = st.column_config.NumberColumn(f"{name} [{lot.reference_unit}]", format=shown)
    chosen = table_to_choose([_linked(unit) for unit in units], f"units-{lot.id}", columns)
    left, right = st.columns([3, 2], vertical_alignment="center")
    with left:
        st.pagination(max(1, -(-page.total // SIZE)), key=place)
        st.caption(say("lot.table.count", shown=len(units), count=page.total))
    with right, st.container(horizontal=True, horizontal_alignment="right"):
        download(say("lot.export.csv"), f"{lot.id}.csv", lambda: csv_of(_table(lot, serials)), "export.csv")
        download(say("lot.export.xlsx"), f"{lot.id}.xlsx", lambda: excel_of(_table(lot, serials)), "export.xlsx")
    if chosen is not None:
        go_to("unit", unit=str(units[chosen].key))


def _linked(unit: UnitEntry) -> dict[str, object]:
    """Return one row of the table on the screen: its serial opens the unit in a new tab."""
    shown = {say("column.serial"): unit_link(unit.key), say("column.verdict"): verdict_word(unit.verdict)}
    return row(unit) | shown


def row(unit: UnitEntry) -> dict[str, object]:
    """Return one row of the table under the words of the chosen language."""
    return {
        say("column.serial"): unit.serial,
        say("column.verdict"): say(f"verdict.{unit.verdict or 'none'}"),
        **{say(f"column.{name}"): getattr(unit, f"{name}_rmse") for name in NUMBERS},
        say("column.family"): unit.family,
        say("column.revision"): unit.revision,
        say("column.reasons"): all_said(unit.reasons, say),
    }


def _table(lot: Lot, serials: Serials) -> list[dict[str, object]]:
    """Return the whole table."""
    units = [unit for unit in registry().lots.units(lot.id) if unit.role == "target"]
    if serials is not None:
        chosen = frozenset(serials)
        units = [unit for unit in units if unit.serial in chosen]
    with in_one_language():
        return [row(unit) for unit in units]
