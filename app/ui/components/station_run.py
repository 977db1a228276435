"""A run of a station live on an engineer's page: ordered through the queue, watched, stopped."""

import uuid

import streamlit as st

from softcal.app.charts.live import live_signal
from softcal.app.jobs.launch import SIMULATED, end_simulated_station, start_simulated_station
from softcal.app.ui.account import actor, allows, permit
from softcal.app.ui.actions import show_refusals
from softcal.app.ui.presentation import colours, localize, show_errors, translate
from softcal.app.ui.server_cache import registry
from softcal.app.views.common import render_phase
from softcal.core.errors import InputError
from softcal.core.orders import Order, OrderKind, Progress, RunState

POLL_S = 0.7
AWAITED = "station-awaited"


def choose_station() -> str | None:
    """Let a person choose a station; None, with how to start one, where there is none."""
    names = [heartbeat.station for heartbeat in registry().order_queue.stations()]
    if not names:
        st.info(translate("station.none.how"), icon=":material/inbox:", title=translate("station.none"))
        switch_simulated_station()
        return None
    return str(st.selectbox(translate("station.station"), names, key="station-choice"))


def switch_simulated_station() -> None:
    """Draw the button that starts the simulated station of this machine, or ends it."""
    is_on = registry().order_queue.is_answering(SIMULATED)
    action = "stop" if is_on else "start"
    label = translate("station.simulate.off" if is_on else "station.simulate")
    if allows("set_up") and st.button(label, icon=":material/science:", key="station-simulated"):
        permit("set_up")
        if is_on:
            end_simulated_station(registry(), SIMULATED)
        else:
            start_simulated_station(SIMULATED)
        registry().trail.add(action, "station", (SIMULATED,), {"rig": "simulated"}, actor=actor())
        st.session_state[AWAITED] = not is_on
    if AWAITED in st.session_state:
        _await_station()


@st.fragment(run_every=POLL_S)
def _await_station() -> None:
    """Wait for the service that was started or ended here to say so."""
    if registry().order_queue.is_answering(SIMULATED) == st.session_state.get(AWAITED):
        del st.session_state[AWAITED]
        st.rerun()
    st.caption(translate("station.starting" if st.session_state.get(AWAITED) else "station.ending"))


def place_order(station: str, kind: OrderKind, serial: str = "", lot_id: str = "", reason: str = "") -> bool:
    """Order something from a station; a refusal is shown as one line."""
    permit("override" if kind is OrderKind.OVERRIDE else "set_up")
    with show_refusals():
        if not registry().order_queue.is_answering(station):
            raise InputError(translate("station.silent", station=station))
        registry().order_queue.place(Order(uuid.uuid4().hex, station, kind, serial, lot_id, actor(), reason))
        return True
    return False


def newest_run(station: str, kinds: tuple[OrderKind, ...], lot_id: str = "") -> tuple[Order, Progress] | None:
    """Return the newest run of these kinds at a station, of one lot where it is given."""
    runs = registry().order_queue.runs(station, 30)
    return next((run for run in runs if run[0].kind in kinds and lot_id in ("", run[0].lot_id)), None)


def run_panel(run: tuple[Order, Progress]) -> bool:
    """Draw a run; return whether it is done."""
    order, progress = run
    if progress.state.is_active:
        _running(order.order_id, order.station)
    elif progress.state is RunState.ERROR:
        st.error(localize(progress.message), icon=":material/report:", title=progress.code)
    elif progress.state is RunState.CANCELLED:
        st.info(localize(progress.message) or translate("job.cancelled"), icon=":material/cancel:")
    return progress.state is RunState.DONE


@st.fragment(run_every=POLL_S)
@show_errors()
def _running(order_id: str, station: str) -> None:
    queue = registry().order_queue
    progress = queue.progress(order_id)
    if not progress.state.is_active:
        st.rerun()
    left, right = st.columns([5, 1], vertical_alignment="bottom")
    phase = render_phase(progress.phase, translate)
    left.progress(progress.fraction, text=translate("station.left", phase=phase, seconds=round(progress.remaining_s)))
    if right.button(translate("line.action.STOP"), type="primary", key=f"stop-{order_id}", width="stretch"):
        place_order(station, OrderKind.STOP)
    if not queue.is_answering(station):
        st.warning(translate("station.silent", station=station), icon=":material/heart_broken:")
    if progress.signal.t_s:
        chart_options = live_signal(progress.signal, colours(), translate, has_force=True)
        st.echarts_chart(chart_options, height=320, key=f"signal-{order_id}")
