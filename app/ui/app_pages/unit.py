"""One unit of a lot: what it is, what was decided, why, when and by whom."""

import streamlit as st

from softcal.app.registry.standing import standing_of
from softcal.app.ui.actions import say_finished
from softcal.app.ui.desk import empty, in_words, instant, say, verdict_badge
from softcal.app.ui.panels import draw_tabs, heading, lot_link, named_units, numbers, table, unit_link
from softcal.app.ui.server_memory import registry
from softcal.app.ui.tabs.unit import draw_recordings
from softcal.app.views.common import limit_said, number
from softcal.app.views.unit import UnitHead, unit_head
from softcal.core.lot import UnitKey

FIRST = 20
"""So many units are offered where the address names none."""


def render() -> None:
    asked = str(st.query_params.get("unit", ""))
    units = named_units(asked)
    if len(units) != 1:
        _choose(asked, units)
        return
    (key,) = units
    history = registry().calibrations.history(key.serial, key.lot_id)
    current = registry().calibrations.get(key.serial, lot_id=key.lot_id).revision if history else None
    head = unit_head(registry(), key, history)
    with heading("unit", key.serial):
        verdict_badge(head.verdict, say("unit.released" if head.is_released else "unit.not_released"))
    st.markdown(_head_line(key, head))
    say_finished("unit")
    if current is None:
        empty("empty.calibration", in_words(head.reasons))
        draw_recordings(key)
        return
    revisions, revision = [entry.revision for entry in reversed(history)], current
    left, right = st.columns([1, 6]) if len(revisions) > 1 else (None, st.container())
    if left is not None:
        revision = left.selectbox(say("column.revision"), revisions, index=revisions.index(current)) or current
    stored = next(entry for entry in history if entry.revision == revision)
    standing = standing_of(registry(), stored)
    if standing.calibration is None:
        st.markdown(f"{say('unit.refused_since')} **{in_words(standing.reasons)}**")
    unit, errors = registry().lots.get(key.lot_id).reference_unit, stored.state.errors
    # What was measured first.
    scores = [(say(f"column.{name}"), errors[f"{name}_rmse"], None) for name in ("after", "before", "own")]
    cells = [*scores, (say("lot.predicted"), errors["predicted_rmse"], say("unit.predicted.help"))]
    with right:
        numbers(
            [
                (label, number(value, unit, stored.state.limit.maximum_rmse), tip)
                for label, value, tip in cells
                if value is not None
            ]
        )
    draw_tabs("unit", key, stored)


def _head_line(key: UnitKey, head: UnitHead) -> str:
    """Return lot, limit, instant, person and station in one line."""
    cells = [
        (say("choose.lot"), lot_link(key.lot_id).markdown),
        (say("lot.limit"), limit_said(head.limit, say)),
        (say("column.made"), instant(head.made_at)),
        (say("column.actor"), head.actor),
        (say("station.station"), head.station or say("lot.yield.desk")),
    ]
    return " · ".join(f"{label}: **{value}**" for label, value in cells if value)


def _choose(asked: str, units: list[UnitKey]) -> None:
    """Offer the units of an address that names none alone."""
    heading("unit")
    offered = units or registry().pages.find_units("")[:FIRST]
    if not offered:
        empty("empty.units")
        return
    if units:
        st.info(say("unit.lots", serial=asked, count=len(units)), icon=":material/help:")
    else:
        st.caption(say("unit.find.none", text=asked) if asked else say("unit.choose"))
    table({say("column.serial"): unit_link(unit), say("choose.lot"): lot_link(unit.lot_id)} for unit in offered)
