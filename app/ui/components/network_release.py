"""Release a network to the line, or withdraw one: with a reason, by somebody who may; the line tells the change."""

from collections.abc import Sequence

import streamlit as st

from softcal.app.ui.account import actor
from softcal.app.ui.desk import ask_reason, in_words, registry, words
from softcal.app.views.common import number
from softcal.app.views.network import NetworkRow
from softcal.core.errors import InputError
from softcal.core.lot import Lot
from softcal.db.truth.network_release import RELEASED

DONE = "network-decided"


def release(lot: Lot, rows: Sequence[NetworkRow]) -> None:
    """Draw which network the line uses, and the two decisions on the others."""
    say = words()
    st.header(say("networks.release"))
    used = next((row for row in rows if row.is_in_use), None)
    st.caption(say("networks.release.how", network=used.id[:12]) if used else say("networks.release.none"))
    if done := st.session_state.pop(DONE, ""):
        st.success(done, icon=":material/check:")
    names = {
        row.id: f"{row.id[:12]} · {row.layers} · {number(row.validation_rmse, lot.reference_unit)}" for row in rows
    }
    chosen = st.selectbox(say("column.network"), list(names), format_func=names.__getitem__, key=f"release-{lot.id}")
    row = next(row for row in rows if row.id == chosen)
    try:
        if not row.is_in_use:
            _decide(row, "release")
        if row.state == RELEASED:
            _decide(row, "withdraw")
    except InputError as error:
        st.error(in_words(error), icon=":material/error:")


def _decide(row: NetworkRow, what: str) -> None:
    say = words()
    with st.container(border=True):
        reason = ask_reason(f"{what}-{row.id[:12]}-{row.state}", say(f"networks.{what}.do"), "release")
    if reason is None:
        return
    decide = registry().release_network if what == "release" else registry().withdraw_network
    decide(row.id, reason=reason, actor=actor())
    st.session_state[DONE] = say(f"networks.{what}.done", network=row.id[:12])
    st.rerun()
