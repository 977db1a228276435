"""Every revision and recording of a unit, and the way back to an older revision, with a reason."""

from collections.abc import Sequence

import streamlit as st

from softcal.app.batch.judging import judge_again
from softcal.app.charts import unit as charts_unit
from softcal.app.ui.account import actor
from softcal.app.ui.desk import ask_reason, colours, in_words, instant, registry, show_figure, words
from softcal.app.ui.panels import table, table_to_choose
from softcal.app.views.common import number
from softcal.core.errors import InputError
from softcal.core.lot import Lot
from softcal.db.entries import StoredCalibration


def unit_history(history: Sequence[StoredCalibration], unit: str) -> None:
    """Draw the revisions, newest first, and the rollback."""
    table([_row(entry, unit) for entry in reversed(history)])
    older = [entry.revision for entry in reversed(history) if not entry.is_current]
    if older:
        _rollback(history[-1].serial, history[-1].lot_id, older)


def _row(entry: StoredCalibration, unit: str) -> dict[str, object]:
    say, record = words(), entry.record
    back = say("unit.rolled_back", revision=entry.rolled_back_to) if entry.rolled_back_to else ""
    return {
        say("column.revision"): entry.revision,
        say("column.in_use"): say("unit.in_use") if entry.is_current else "",
        say("column.made"): instant(entry.made_at),
        say("column.verdict"): say(f"verdict.{record.verdict}"),
        say("column.predicted"): number(record.predicted_rmse, unit),
        say("column.after"): number(record.after_rmse, unit),
        say("column.family"): record.family,
        say("column.actor"): entry.actor,
        say("column.reason"): "; ".join(filter(None, (back, entry.reason))),
    }


def _rollback(serial: str, lot_id: str, older: Sequence[int]) -> None:
    say = words()
    with st.container(border=True):
        st.markdown(f"**{say('unit.rollback')}**")
        revision = st.selectbox(say("unit.rollback.to"), older, key=f"rollback-{serial}-{len(older)}")
        reason = ask_reason(f"rollback-{serial}-{len(older)}", say("unit.rollback.do"), "rollback")
        if reason is None:
            return
        try:
            registry().calibrations.rollback(serial, revision, reason=reason, actor=actor(), lot_id=lot_id)
            judge_again(registry(), [lot_id], actor())
        except InputError as error:
            st.error(in_words(error), icon=":material/error:")
            return
        st.session_state["unit-done"] = say("unit.rollback.done", revision=revision)
        st.rerun()


def unit_recordings(serial: str, lot: Lot) -> None:
    """Draw the unit's recordings and the curve of the one that is chosen, the newest at first."""
    say = words()
    entries = registry().recordings.of_lot(lot.id, serial)[::-1]
    if not entries:
        st.caption(say("unit.recordings.none"))
        return
    rows = [
        {
            say("column.kind"): say(f"kind.{entry.kind}"),
            say("column.made"): instant(entry.added_at),
            say("column.duration"): f"{entry.samples / entry.sample_rate_Hz:.1f} s",
            say("column.rate"): f"{entry.sample_rate_Hz:g} Hz",
            "SHA-256": entry.sha256[:12],
        }
        for entry in entries
    ]
    key = f"recordings-{serial}"
    chosen = entries[table_to_choose(rows, key) or 0]
    show_figure(charts_unit.recording(registry().recordings.get(chosen.sha256), lot, colours(), say), f"{key}-plot")
