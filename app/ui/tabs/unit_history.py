"""The revisions of a unit, a way back to an older one, and its course in long use."""

import streamlit as st

from softcal.app.batch.changes import reached_lots
from softcal.app.batch.release import roll_back
from softcal.app.export.export import withdraw_given
from softcal.app.ui.account import actor
from softcal.app.ui.actions import ask_reason, finish, refusals_in_words
from softcal.app.ui.components.long_use import draw_long_use
from softcal.app.ui.desk import instant, say, verdict_word
from softcal.app.ui.panels import table
from softcal.app.ui.server_memory import registry
from softcal.app.views.common import number
from softcal.core.lot import UnitKey
from softcal.db.entries import StoredCalibration


def draw(key: UnitKey, stored: StoredCalibration) -> None:
    unit, rows, older = registry().lots.get(key.lot_id).reference_unit, [], []
    for entry in reversed(registry().calibrations.history(key.serial, key.lot_id)):
        state, errors = entry.state, entry.state.errors
        back = say("unit.rolled_back", revision=entry.rolled_back_to) if entry.rolled_back_to else ""
        rows.append(
            {
                say("column.revision"): entry.revision,
                say("column.in_use"): say("unit.in_use") if entry.is_current else "",
                say("column.made"): instant(entry.made_at),
                say("column.verdict"): verdict_word(state.verdict),
                say("column.predicted"): number(errors["predicted_rmse"], unit, state.limit.maximum_rmse),
                say("column.after"): number(errors["after_rmse"], unit, state.limit.maximum_rmse),
                say("column.family"): state.fit.family,
                say("column.actor"): entry.actor,
                say("column.reason"): "; ".join(filter(None, (back, entry.reason))),
            }
        )
        if not entry.is_current:
            older.append(entry.revision)
    table(rows)
    if older:
        _roll_back(key, older)
    draw_long_use(key)


def _roll_back(key: UnitKey, older: list[int]) -> None:
    with st.container(border=True):
        st.markdown(f"**{say('unit.rollback')}**")
        revision = st.selectbox(say("column.revision"), older, key=f"rollback-{key}-{len(older)}")
        reason = ask_reason(f"rollback-{key}-{len(older)}", say("unit.rollback.do"), "rollback")
        if reason is None:
            return
        with refusals_in_words():
            roll_back(registry(), key.serial, revision, reason=reason, actor=actor(), lot_id=key.lot_id)
            withdraw_given(registry(), reached_lots(registry(), key.lot_id))
            finish("unit", say("unit.rollback.done", revision=revision))
