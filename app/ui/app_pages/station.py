"""The stations: what each does, why its gate is closed, its runs, its self-test, and the set-up of a new rig."""

from datetime import UTC, datetime

import streamlit as st

from softcal.app.line.facts import state_of
from softcal.app.line.gate_facts import quarantine
from softcal.app.line.place import is_alive
from softcal.app.ui.account import person
from softcal.app.ui.components.rig_setup import rig_setup
from softcal.app.ui.components.station_run import choose_station, newest_run, place, run_panel
from softcal.app.ui.desk import ask_reason, errors_in_words, in_words, instant, registry, words
from softcal.app.ui.first_paint import rest_may_follow
from softcal.app.ui.panels import heading, table
from softcal.core.orders import OrderKind
from softcal.db.access.people import may

RUNS = 25
POLL_S = 2.0


def render() -> None:
    say = words()
    with heading("station"):
        station = choose_station()
    if station is not None:
        _state(station)
        _actions(station)
        if not rest_may_follow():
            return
        _runs(station)
    st.header(say("station.setup"))
    rig_setup()


@st.fragment(run_every=POLL_S)
@errors_in_words()
def _state(station: str) -> None:
    """Draw what the station says of itself, as it says it."""
    say = words()
    beat = registry().order_queue.heartbeat(station)
    if beat is None:
        return
    state = say(f"station.state.{state_of(beat, datetime.now(UTC), is_alive(beat.process))}")
    cells = (("station.state", state), ("station.seen", instant(beat.at)), ("station.by", beat.process))
    st.markdown(" · ".join(f"{say(label)}: **{value}**" for label, value in cells))
    for reason in beat.reasons:
        st.warning(in_words(reason), icon=":material/lock:")
    if beat.gate:
        marks = {True: "✓", False: "✕"}
        rows = [
            (marks[condition.is_good], in_words(condition.name), in_words(condition.says)) for condition in beat.gate
        ]
        table(
            [
                {say("station.good"): mark, say("station.condition"): name, say("station.fact"): says}
                for mark, name, says in rows
            ]
        )


def _actions(station: str) -> None:
    say = words()
    if held := quarantine(registry(), station, datetime.now(UTC)):
        st.error(say("station.quarantine", count=len(held), first=held[0]), icon=":material/front_hand:")
    if may(person(), "set_up"):
        _orders(station)
    with st.expander(say("station.override"), icon=":material/lock_open:"):
        why = ask_reason(f"override-{station}", say("station.override"), "override")
    if why is not None:
        place(station, OrderKind.OVERRIDE, reason=why)


def _orders(station: str) -> None:
    say = words()
    with st.container(horizontal=True):
        if st.button(say("station.check"), icon=":material/fact_check:"):
            place(station, OrderKind.CHECK)
        if st.button(say("station.acknowledge"), icon=":material/done_all:"):
            place(station, OrderKind.ACKNOWLEDGE)
    if run := newest_run(station, (OrderKind.CHECK,)):
        if run_panel(run):
            st.success(in_words(run[1].message) or say("station.check.done"), icon=":material/check:")


def _runs(station: str) -> None:
    say = words()
    rows = [
        {
            say("column.made"): instant(order.created),
            say("column.kind"): say(f"order.{order.kind}"),
            say("column.serial"): order.serial,
            say("choose.lot"): order.lot_id,
            say("station.result"): say(f"run.{progress.state}"),
            say("column.remark"): in_words(progress.message),
            say("column.actor"): order.actor,
        }
        for order, progress in registry().order_queue.runs(station, RUNS)
    ]
    st.header(say("station.runs"))
    if rows:
        table(rows)
    else:
        st.caption(say("station.runs.none"))
