"""The units of a lot as a table: filtered, sorted and paged in SQL, and exported as a whole."""

from collections.abc import Sequence

import streamlit as st

from softcal.app.registry.limit import limit_or_none
from softcal.app.texts.reasons import all_said
from softcal.app.ui.actions import csv_of, download
from softcal.app.ui.desk import errors_in_words, in_one_language, named, say, verdict_word
from softcal.app.ui.panels import go_to, table_to_choose, unit_link
from softcal.app.ui.server_memory import registry
from softcal.core.lot import Lot
from softcal.core.messages.figures import decimals_of_limit
from softcal.core.unit.verdict import VERDICTS
from softcal.db.entries import UnitEntry
from softcal.db.repositories.lot_pages import UnitFilter

SIZE = 50
WORDS = (*reversed(VERDICTS), "none")
"""What a unit can be filtered by, worst first."""

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
    text = st.text_input(say("unit.find"), key=f"units-find-{lot.id}", icon=":material/search:")
    wanted = UnitFilter(tuple(verdicts), str(text or "").strip(), "severity", serials=serials)
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
    limit = limit_or_none(registry(), lot.id)
    shown = ".4g" if limit is None else f".{decimals_of_limit(limit.maximum_rmse)}f"
    heads = [f"{say(f'column.{name}')} [{lot.reference_unit}]" for name in NUMBERS]
    columns = {head: st.column_config.NumberColumn(format=f"%{shown}") for head in heads}
    serial, verdict = say("column.serial"), say("column.verdict")
    linked = [_row(u, heads) | {serial: unit_link(u.key), verdict: verdict_word(u.verdict)} for u in units]
    chosen = table_to_choose(linked, f"units-{lot.id}", columns)
    left, right = st.columns([3, 2], vertical_alignment="center")
    with left:
        st.pagination(max(1, -(-page.total // SIZE)), key=place)
        st.caption(say("lot.table.count", shown=len(units), count=page.total))

    def table() -> bytes:
        every = UnitFilter(sort="severity", serials=serials)
        with in_one_language():
            rows = [_row(one, heads, shown) for one in registry().pages.unit_page(lot.id, every, size=10**9).units]
        return csv_of(rows)

    with right, st.container(horizontal=True, horizontal_alignment="right"):
        download(say("lot.export.csv"), f"{lot.id}.csv", table, "export.csv")
    if chosen is not None:
        go_to("unit", unit=str(units[chosen].key))


def _row(unit: UnitEntry, heads: Sequence[str], shown: str = "") -> dict[str, object]:
    """Return one row in the chosen language, its errors under `heads`, as text where `shown` says how."""
    errors = [getattr(unit, f"{name}_rmse") for name in NUMBERS]
    return {
        say("column.serial"): unit.serial,
        say("column.verdict"): say(f"verdict.{unit.verdict or 'none'}"),
        **{head: format(x, shown) if shown and x is not None else x for head, x in zip(heads, errors, strict=True)},
        say("column.family"): unit.family,
        say("column.revision"): unit.revision,
        say("column.reasons"): all_said(unit.reasons, say),
    }
