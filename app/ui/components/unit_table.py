"""The units of a lot as a table: filtered, sorted and paged in SQL, and exported as a whole."""

from dataclasses import replace
from functools import partial

import streamlit as st

from softcal.app.files.spreadsheet import csv_text, excel_bytes
from softcal.app.texts.reasons import all_said
from softcal.app.ui.desk import errors_in_words, registry, words
from softcal.app.ui.panels import go_to, table_to_choose
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
EXCEL = "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet"


@st.fragment
@errors_in_words()
def unit_table(lot: Lot, serials: Serials = None) -> None:
    """Draw the table of a lot; a fragment of its own, so that filtering draws nothing else again.

    Args:
        serials: of these units only; None takes all.
    """
    say = words()
    wanted = replace(_filter(lot.id), serials=serials)
    place = f"units-page-{lot.id}"
    found = registry().pages.unit_page(lot.id, wanted, int(st.session_state.get(place, 1)), SIZE)
    if found.total and not found.units:
        # The filter leaves fewer pages than the one that was looked at.
        st.session_state[place] = 1
        found = registry().pages.unit_page(lot.id, wanted, 1, SIZE)
    units = found.units
    if not units:
        st.caption(say("lot.table.none"))
        return
    columns = {
        say(f"column.{name}"): st.column_config.NumberColumn(
            f"{words()(f'column.{name}')} [{lot.reference_unit}]", format="%.4g"
        )
        for name in NUMBERS
    }
    chosen = table_to_choose([row(unit) for unit in units], f"units-{lot.id}", columns)
    left, right = st.columns([3, 2], vertical_alignment="center")
    with left:
        st.pagination(max(1, -(-found.total // SIZE)), key=place)
        st.caption(say("lot.table.count", shown=len(units), count=found.total))
    with right, st.container(horizontal=True, horizontal_alignment="right"):
        _export(lot, serials)
    if chosen is not None:
        go_to("unit", unit=units[chosen].serial)


def row(unit: UnitEntry) -> dict[str, object]:
    """Return one row of the table under the words of the chosen language."""
    say = words()
    return {
        say("column.serial"): unit.serial,
        say("column.verdict"): say(f"verdict.{unit.verdict or 'none'}"),
        **{say(f"column.{name}"): getattr(unit, f"{name}_rmse") for name in NUMBERS},
        say("column.family"): unit.family,
        say("column.revision"): unit.revision,
        say("column.reasons"): all_said(unit.reasons, say),
    }


def _filter(lot_id: str) -> UnitFilter:
    say = words()
    verdicts = st.pills(
        say("column.verdict"),
        WORDS,
        selection_mode="multi",
        format_func=lambda word: say(f"verdict.{word}"),
        key=f"units-verdicts-{lot_id}",
    )
    middle, right = st.columns([3, 2], vertical_alignment="bottom")
    text = middle.text_input(say("lot.table.find"), key=f"units-find-{lot_id}", icon=":material/search:")
    sort = right.selectbox(
        say("lot.table.sort"), SORTS, format_func=lambda name: say(f"sort.{name}"), key=f"units-sort-{lot_id}"
    )
    return UnitFilter(
        tuple(verdicts), str(text or "").strip(), sort, sort in ("predicted_rmse", "after_rmse", "made_at")
    )


def _export(lot: Lot, serials: Serials) -> None:
    """Offer the whole table; its bytes are made when somebody takes them."""
    say = words()
    forms = ((".csv", "text/csv", _csv), (".xlsx", EXCEL, _excel))
    for suffix, mime, make in forms:
        st.download_button(
            say(f"lot.export{suffix}"),
            data=partial(make, lot, serials),
            file_name=f"{lot.id}{suffix}",
            mime=mime,
            key=f"export{suffix}",
            icon=":material/download:",
            on_click="ignore",
        )


def _table(lot: Lot, serials: Serials) -> tuple[list[str], list[tuple[object, ...]]]:
    kept = None if serials is None else frozenset(serials)
    units = [
        unit
        for unit in registry().lots.units(lot.id)
        if unit.role == "target" and (kept is None or unit.serial in kept)
    ]
    rows = [row(unit) for unit in units]
    header = list(rows[0]) if rows else []
    return header, [tuple(values.values()) for values in rows]


def _csv(lot: Lot, serials: Serials) -> bytes:
    # The mark tells Excel that these bytes are UTF-8; without it Korean headings are garbled.
    return csv_text(*_table(lot, serials)).encode("utf-8-sig")


def _excel(lot: Lot, serials: Serials) -> bytes:
    return excel_bytes(*_table(lot, serials))
