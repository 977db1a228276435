"""The stations: what each does, why its gate is closed, its runs, its self-test, and the set-up of a new rig."""

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

import streamlit as st

from softcal.app.bootstrap import is_alive
from softcal.app.jobs.process import start_job
from softcal.app.line.facts import state_of
from softcal.app.line.gate_facts import quarantine
from softcal.app.ui.account import actor, permit, person
from softcal.app.ui.components.job_panel import job_panel, newest_job
from softcal.app.ui.components.station_run import choose_station, newest_run, place, run_panel
from softcal.app.ui.desk import ask_reason, errors_in_words, in_words, instant, registry, words
from softcal.app.ui.first_paint import rest_may_follow
from softcal.app.ui.panels import heading, table
from softcal.core.orders import OrderKind
from softcal.core.words.reason import Reason
from softcal.db.access.people import may
from softcal.station.wire.link import available_ports

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


RIGS = ("ports", "file", "simulated")


def rig_setup() -> None:
    """Draw the choice of the rig, the newest check and its station file."""
    say = words()
    st.caption(say("setup.how"))
    job = newest_job("station_check")
    if may(person(), "set_up"):
        _ask(is_busy=job is not None and job.state.is_active)
    if job is not None and job_panel(job):
        _found(job.result)


def _ask(is_busy: bool) -> None:
    say = words()
    rig = st.segmented_control(
        say("setup.rig"), RIGS, default="ports", format_func=lambda name: say(f"setup.{name}"), key="rig"
    )
    request: dict[str, object] = {"ports": [], "file": None, "simulated": None}
    if rig == "ports":
        request["ports"] = st.multiselect(say("setup.at"), available_ports(), placeholder=say("setup.every"))
    elif rig == "file":
        request["file"] = str(st.text_input(say("setup.path"), placeholder="/etc/softcal/station.toml")).strip()
    else:
        request["simulated"] = 0
    may_move = st.checkbox(say("setup.move"), value=False)
    st.caption(say("setup.move.warning"))
    if st.button(say("setup.do"), disabled=is_busy or request["file"] == "", icon=":material/search:"):
        permit("set_up")
        start_job(registry(), "station_check", request | {"may_move": may_move}, actor())
        st.rerun()


def _found(result: Mapping[str, Any]) -> None:
    say = words()
    if result["is_good"]:
        st.success(say("setup.good", station=result["station"]), icon=":material/check:")
    if result.get("ports"):
        table([_port_row(*port) for port in result["ports"]])
    marks = {True: "✓", False: "✕"}
    table(
        [
            {
                say("station.good"): marks[not cure],
                say("setup.device"): in_words(Reason.of(device)),
                say("setup.what"): in_words(Reason.of(what)),
                say("setup.value"): in_words(Reason.of(value)),
                say("setup.cure"): in_words(Reason.of(cure or "")),
            }
            for device, what, value, cure in result["found"]
        ]
    )
    with st.expander(say("setup.file_of"), icon=":material/description:"):
        st.code(result["toml"], language="toml")
        st.download_button(say("setup.save"), result["toml"], "station.toml", "application/toml", on_click="ignore")


def _port_row(port: str, role: str, kind: str, says: object) -> dict[str, str]:
    say = words()
    return {
        say("setup.port"): port,
        say("setup.is"): " ".join(filter(None, (say(f"setup.role.{role or 'none'}"), kind and f"({kind})"))),
        say("setup.says"): in_words(Reason.of(says)),
    }
