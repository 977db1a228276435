"""The shared networks of a lot: train one with the loss live, and compare networks and map families on its units."""

from collections.abc import Sequence

import streamlit as st

from softcal.app.ui.account import actor
from softcal.app.ui.components.network_panels import comparison, training
from softcal.app.ui.desk import ask_reason, empty, in_words, instant, registry, words
from softcal.app.ui.first_paint import rest_may_follow
from softcal.app.ui.panels import headline, lot_heading, table, told
from softcal.app.views.common import number
from softcal.app.views.network import NetworkRow, network_rows
from softcal.core.errors import InputError
from softcal.core.lot import Lot
from softcal.db.truth.networks import RELEASED


def render() -> None:
    say = words()
    lots = {lot.id: lot for lot in registry().lots.all()}
    lot_id = lot_heading("networks", list(lots))
    if lot_id is None:
        return
    lot = lots[lot_id]
    rows = network_rows(registry(), lot.id)
    if rows:
        headline(_said(rows, lot.reference_unit))
    else:
        empty(say("networks.none"), say("networks.none.how"))
    if not rest_may_follow():
        return
    if rows:
        table(told([_row(row, lot.reference_unit) for row in rows]))
        release(lot, rows)
    training(lot)
    if rows:
        comparison(lot, rows)


def _said(rows: list[NetworkRow], unit: str) -> str:
    """Return which network is in use and how well it was trained, in one sentence."""
    used = next((row for row in rows if row.is_in_use), None)
    if used is None:
        return words()("networks.none_in_use", count=len(rows))
    error = number(used.validation_rmse, unit)
    return words()("networks.headline", network=used.id[:12], error=error, count=len(rows))


def _row(row: NetworkRow, unit: str) -> dict[str, object]:
    say = words()
    return {
        say("column.network"): row.id[:12],
        say("networks.state"): say("networks.in_use") if row.is_in_use else say(f"networks.state.{row.state}"),
        say("networks.decided"): row.decided,
        say("column.made"): instant(row.added_at),
        say("networks.hidden"): row.layers,
        say("networks.members"): row.members,
        say("networks.seed"): row.seed,
        say("networks.validation"): number(row.validation_rmse, unit),
        say("networks.epochs"): row.epochs,
        say("networks.train_s"): number(row.train_s, "s"),
        say("column.remark"): say("networks.stale") if row.is_stale else "",
    }


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
    decide = registry().networks.release if what == "release" else registry().networks.withdraw
    decide(row.id, reason=reason, actor=actor())
    st.session_state[DONE] = say(f"networks.{what}.done", network=row.id[:12])
    st.rerun()
