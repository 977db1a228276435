"""The stations: what each does, why its gate is closed, its runs, and the set-up of a rig."""

from datetime import UTC, datetime

import streamlit as st

from softcal.app.bootstrap import is_alive
from softcal.app.line.facts import state_of
from softcal.app.line.gate_facts import quarantine
from softcal.app.ui.account import allows
from softcal.app.ui.actions import ask_reason
from softcal.app.ui.components.job_panel import begin_job, is_running, job_panel, newest_job
from softcal.app.ui.components.station_run import choose_station, newest_run, place, run_panel
from softcal.app.ui.desk import errors_in_words, in_words, instant, named, say
from softcal.app.ui.panels import rest_may_follow, table
from softcal.app.ui.server_memory import registry
from softcal.core.orders import OrderKind
from softcal.core.words.reason import Reason
from softcal.station.wire.link import available_ports

RUNS = 25
POLL_S = 2.0
RIGS = ("ports", "file", "simulated")
MARKS = {True: "✓", False: "✕"}


def draw() -> None:
    station = choose_station()
    if station is not None:
        _state(station)
        _actions(station)
        if not rest_may_follow():
            return
        st.header(say("station.runs"))
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
        table(rows, say("station.runs.none"))
    st.header(say("station.setup"))
    st.caption(say("setup.how"))
    job = newest_job("station_check")
    if allows("set_up"):
        rig = st.segmented_control(say("setup.rig"), RIGS, default="ports", format_func=named("setup"), key="rig")
        request: dict[str, object] = {"ports": [], "file": None, "simulated": None}
        if rig == "ports":
            request["ports"] = st.multiselect(say("setup.at"), available_ports(), placeholder=say("setup.every"))
        elif rig == "file":
            request["file"] = str(st.text_input(say("setup.path"), placeholder="/etc/softcal/station.toml")).strip()
        else:
            request["simulated"] = 0
        may_move = st.checkbox(say("setup.move"), value=False)
        st.caption(say("setup.move.warning"))
        is_off = is_running(job) or request["file"] == ""
        if st.button(say("setup.do"), disabled=is_off, icon=":material/search:"):
            begin_job("station_check", "set_up", **request, may_move=may_move)
            st.rerun()
    if job is None or not job_panel(job):
        return
    result = job.result
    if result["is_good"]:
        st.success(say("setup.good", station=result["station"]), icon=":material/check:")
    if result.get("ports"):
        table(
            {
                say("setup.port"): port,
                say("setup.is"): say(f"setup.role.{role or 'none'}") + (f" ({kind})" if kind else ""),
                say("setup.says"): in_words(Reason.of(answer)),
            }
            for port, role, kind, answer in result["ports"]
        )
    table(
        {
            say("station.good"): MARKS[not cure],
            say("setup.device"): in_words(Reason.of(device)),
            say("setup.what"): in_words(Reason.of(what)),
            say("setup.value"): in_words(Reason.of(value)),
            say("setup.cure"): in_words(Reason.of(cure or "")),
        }
        for device, what, value, cure in result["found"]
    )
    with st.expander(say("setup.file"), icon=":material/description:"):
        st.code(result["toml"], language="toml")
        st.download_button(say("setup.save"), result["toml"], "station.toml", "application/toml", on_click="ignore")


@st.fragment(run_every=POLL_S)
@errors_in_words()
def _state(station: str) -> None:
    """Draw what the station says of itself, as it says it."""
    beat = registry().order_queue.heartbeat(station)
    if beat is None:
        return
    state = say(f"station.state.{state_of(beat, datetime.now(UTC), is_alive(beat.process))}")
    cells = (("column.state", state), ("station.seen", instant(beat.at)), ("station.by", beat.process))
    st.markdown(" · ".join(f"{say(label)}: **{value}**" for label, value in cells))
    for reason in beat.reasons:
        st.warning(in_words(reason), icon=":material/lock:")
    if beat.gate:
        table(
            {
                say("station.good"): MARKS[condition.is_good],
                say("station.condition"): in_words(condition.name),
                say("station.fact"): in_words(condition.says),
            }
            for condition in beat.gate
        )


def _actions(station: str) -> None:
    if held := quarantine(registry(), station, datetime.now(UTC)):
        st.error(say("station.quarantine", count=len(held), first=held[0]), icon=":material/front_hand:")
    if allows("set_up"):
        with st.container(horizontal=True):
            if st.button(say("station.check"), icon=":material/fact_check:"):
                place(station, OrderKind.CHECK)
            if st.button(say("station.acknowledge"), icon=":material/done_all:"):
                place(station, OrderKind.ACKNOWLEDGE)
        if run := newest_run(station, (OrderKind.CHECK,)):
            if run_panel(run):
                st.success(in_words(run[1].message) or say("station.check.done"), icon=":material/check:")
    with st.expander(say("station.override"), icon=":material/lock_open:"):
        why = ask_reason(f"override-{station}", say("station.override"), "override")
    if why is not None:
        place(station, OrderKind.OVERRIDE, reason=why)
