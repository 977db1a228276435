"""One unit of a lot: what it is, what was decided, why, when and by whom."""

import streamlit as st

from softcal.app.registry.limit import limit_or_none
from softcal.app.registry.unit_status import find_unit_status
from softcal.app.ui.actions import show_finished
from softcal.app.ui.panels import heading, lot_link, numbers, table, unit_link, units_of_address
from softcal.app.ui.presentation import empty, format_instant, localize, translate, verdict_badge
from softcal.app.ui.server_cache import registry
from softcal.app.ui.tab_bar import draw_tabs
from softcal.app.ui.tabs.unit import draw_recordings
from softcal.app.views.common import number, render_limit
from softcal.app.views.unit import station_of
from softcal.core.lot import UnitKey
from softcal.core.unit.verdict import Verdict
from softcal.db.entries import UnitEntry

FIRST = 20
"""So many units are offered where the address names none."""


def render() -> None:
    requested_unit = str(st.query_params.get("unit", ""))
    units = units_of_address(requested_unit)
    if len(units) != 1:
        _choose(requested_unit, units)
        return
    (key,) = units
    history = registry().calibrations.history(key.serial, key.lot_id)
    current = registry().calibrations.get(key.serial, lot_id=key.lot_id).revision if history else None
    (unit,) = registry().lots.units(key.lot_id, key.serial)
    is_released = unit.verdict == Verdict.PASS
    with heading("unit", key.serial):
        verdict_badge(unit.verdict, translate("unit.released" if is_released else "unit.not_released"))
    st.markdown(_head_line(unit, next((entry.actor for entry in history if entry.is_current), "")))
    show_finished("unit")
    if current is None:
        empty("empty.calibration", localize(unit.reasons))
        draw_recordings(key)
        return
    revisions, revision = [entry.revision for entry in reversed(history)], current
    left, right = st.columns([1, 6]) if len(revisions) > 1 else (None, st.container())
    if left is not None:
        revision = left.selectbox(translate("column.revision"), revisions, index=revisions.index(current)) or current
    stored = next(entry for entry in history if entry.revision == revision)
    status = find_unit_status(registry(), stored)
    if status.calibration is None:
        st.markdown(f"{translate('unit.refused_since')} **{localize(status.reasons)}**")
    load_unit, errors = registry().lots.get(key.lot_id).reference_unit, stored.state.errors
    # What was measured first.
    scores = [(translate(f"column.{name}"), errors[f"{name}_rmse"], None) for name in ("after", "before", "own")]
    cells = [*scores, (translate("lot.predicted"), errors["predicted_rmse"], translate("unit.predicted.help"))]
    with right:
        numbers(
            [
                (label, number(value, load_unit, stored.state.limit.maximum_rmse), tip)
                for label, value, tip in cells
                if value is not None
            ]
        )
    draw_tabs("unit", key, stored)


def _head_line(unit: UnitEntry, actor: str) -> str:
    """Return lot, limit, instant, person and station in one line."""
    cells = [
        (translate("choose.lot"), lot_link(unit.lot_id).markdown),
        (translate("lot.limit"), render_limit(limit_or_none(registry(), unit.lot_id), translate)),
        (translate("column.made"), format_instant(unit.made_at)),
        (translate("column.actor"), actor),
        (translate("station.station"), station_of(registry(), unit.key) or translate("lot.yield.desk")),
    ]
    return " · ".join(f"{label}: **{value}**" for label, value in cells if value)


def _choose(requested_unit: str, units: list[UnitKey]) -> None:
    """Offer the units of an address that names none alone."""
    heading("unit")
    offered = units or registry().pages.find_units("")[:FIRST]
    if not offered:
        empty("empty.units")
        return
    if units:
        st.info(translate("unit.lots", serial=requested_unit, count=len(units)), icon=":material/help:")
    else:
        st.caption(translate("unit.find.none", text=requested_unit) if requested_unit else translate("unit.choose"))
    table(
        {translate("column.serial"): unit_link(unit), translate("choose.lot"): lot_link(unit.lot_id)}
        for unit in offered
    )
