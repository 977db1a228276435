"""The units of a lot as a table: filtered, sorted and paged in SQL, and exported as a whole."""

from collections.abc import Sequence

import streamlit as st

from softcal.app.registry.limit import limit_or_none
from softcal.app.texts.reasons import render_reasons
from softcal.app.ui.actions import csv_of, download
from softcal.app.ui.panels import go_to, table_to_choose, unit_link
from softcal.app.ui.presentation import in_one_language, label_formatter, show_errors, translate, verdict_word
from softcal.app.ui.server_cache import registry
from softcal.core.lot import Lot
from softcal.core.messages.figures import decimals_of_limit
from softcal.core.unit.verdict import VERDICTS
from softcal.db.entries import UnitEntry
from softcal.db.repositories.lot_pages import UnitFilter

SIZE = 50
VERDICT_CHOICES = (*reversed(VERDICTS), "none")
"""What a unit can be filtered by, worst first."""

NUMBERS = ("predicted", "before", "after", "own")
Serials = tuple[str, ...] | None


@st.fragment
@show_errors()
def unit_table(lot: Lot, serials: Serials) -> None:
    """Draw the table of a lot, or of some serials, so that filters draw nothing else."""
    verdicts = st.pills(
        translate("column.verdict"),
        VERDICT_CHOICES,
        selection_mode="multi",
        format_func=label_formatter("verdict"),
        key=f"units-verdicts-{lot.id}",
    )
    text = st.text_input(translate("unit.find"), key=f"units-find-{lot.id}", icon=":material/search:")
    unit_filter = UnitFilter(tuple(verdicts), str(text or "").strip(), "severity", serials=serials)
    page_key = f"units-page-{lot.id}"
    page = registry().pages.unit_page(
        lot.id, unit_filter, size=SIZE, before=SIZE * (int(st.session_state.get(page_key, 1)) - 1)
    )
    if page.total and not page.units:
        # The filter leaves fewer pages than the one that was looked at.
        st.session_state[page_key] = 1
        page = registry().pages.unit_page(lot.id, unit_filter, size=SIZE)
    units = page.units
    if not units:
        st.caption(translate("lot.table.none"))
        return
    limit = limit_or_none(registry(), lot.id)
    number_format = ".4g" if limit is None else f".{decimals_of_limit(limit.maximum_rmse)}f"
    heads = [f"{translate(f'column.{name}')} [{lot.reference_unit}]" for name in NUMBERS]
    columns = {head: st.column_config.NumberColumn(format=f"%{number_format}") for head in heads}
    serial, verdict = translate("column.serial"), translate("column.verdict")
    linked = [_row(u, heads) | {serial: unit_link(u.key), verdict: verdict_word(u.verdict)} for u in units]
    chosen = table_to_choose(linked, f"units-{lot.id}", columns)
    left, right = st.columns([3, 2], vertical_alignment="center")
    with left:
        st.pagination(max(1, -(-page.total // SIZE)), key=page_key)
        st.caption(translate("lot.table.count", shown=len(units), count=page.total))

    def table() -> bytes:
        every = UnitFilter(sort="severity", serials=serials)
        with in_one_language():
            rows = [_row(one, heads) for one in registry().pages.unit_page(lot.id, every, size=10**9).units]
        return csv_of(rows)

    with right, st.container(horizontal=True, horizontal_alignment="right"):
        download(translate("lot.export.csv"), f"{lot.id}.csv", table, "export.csv")
    if chosen is not None:
        go_to("unit", unit=str(units[chosen].key))


def _row(unit: UnitEntry, heads: Sequence[str]) -> dict[str, object]:
    """Return one row in the chosen language, its errors at full precision under `heads`."""
    errors = [getattr(unit, f"{name}_rmse") for name in NUMBERS]
    return {
        translate("column.serial"): unit.serial,
        translate("column.verdict"): translate(f"verdict.{unit.verdict or 'none'}"),
        **dict(zip(heads, errors, strict=True)),
        translate("column.family"): unit.family,
        translate("column.revision"): unit.revision,
        translate("column.reasons"): render_reasons(unit.reasons, translate),
    }
