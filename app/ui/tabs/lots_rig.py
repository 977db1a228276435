"""Calibrate a source step by step: the lot, the press, a look at the recording, the network."""

import streamlit as st

from softcal.app.charts import station as charts_station
from softcal.app.charts import unit as charts_unit
from softcal.app.jobs.jobs import newest_source
from softcal.app.ui.account import actor, permit
from softcal.app.ui.actions import refusals_in_words
from softcal.app.ui.components.station_run import choose_station, newest_run, place, run_panel
from softcal.app.ui.desk import choose, colours, in_words, instant, say
from softcal.app.ui.panels import go_to, numbers, rest_may_follow, show_figure, step
from softcal.app.ui.server_memory import registry
from softcal.app.views.network import network_rows
from softcal.app.views.station import source_facts
from softcal.core.lot import Lot
from softcal.core.orders import OrderKind


def draw() -> None:
    st.caption(say("source.how"))
    with step("source", 1):
        known = registry().lots.ids()
        lot_id = choose(say("choose.lot"), known, "lot")
        lot = None if lot_id is None else registry().lots.get(lot_id)
        with st.expander(say("lots.new"), icon=":material/add:", expanded=not known):
            with st.form("lot", border=False):
                left, middle, right = st.columns(3)
                name = str(left.text_input(say("choose.lot"), placeholder="2026-48")).strip()
                source_serial = str(middle.text_input(say("source.serial"), placeholder="S1")).strip()
                model = str(right.text_input(say("source.model"), placeholder="eGaIn pad, 3 mm")).strip()
                left, middle, right = st.columns(3)
                quantity = str(left.text_input(say("source.quantity"), "force")).strip()
                reference_unit = str(middle.text_input(say("source.reference_unit"), "N")).strip()
                output_unit = str(right.text_input(say("source.output_unit"), "V")).strip()
                rate_Hz = st.number_input(f"{say('column.rate')} [Hz]", 0.1, 100_000.0, 50.0)
                is_sent = st.form_submit_button(say("source.add_lot"))
            if is_sent:
                permit("set_up")
                with refusals_in_words():
                    made = Lot(name, source_serial, rate_Hz, model, quantity, reference_unit, output_unit)
                    registry().lots.add(made, actor=actor())
                    st.query_params["lot"] = name
                    st.rerun()
    if lot is None:
        return
    with step("source", 2):
        _press(lot)
    if not registry().recordings.of_lot(lot.id, kind="source"):
        return
    with step("source", 3):
        source = newest_source(registry(), lot.id)
        pressed = registry().recordings.of_lot(lot.id, kind="source")[-1].added_at
        numbers([(say(key), value, None) for key, value in source_facts(source).items()], narrowest_px=235)
        st.caption(say("source.look.how", made=instant(pressed)))
        if rest_may_follow():
            left, right = st.columns(2)
            with left:
                show_figure(charts_unit.recording(source, lot, colours(), say), "source-recording")
            with right:
                show_figure(charts_station.source_curve(source, lot, colours(), say), "source-curve")
    with step("source", 4):
        fresh = [row for row in network_rows(registry(), lot.id) if not row.is_stale]
        if fresh:
            st.markdown(say("source.trained", network=fresh[0].id[:12], layers=fresh[0].layers))
        else:
            st.markdown(say("source.untrained"))
        if st.button(say("source.to_networks"), icon=":material/arrow_forward:"):
            go_to("lot", lot=lot.id, tab="networks")


def _press(lot: Lot) -> None:
    station = choose_station()
    if station is None:
        return
    beat = registry().order_queue.heartbeat(station)
    for reason in beat.reasons if beat else ():
        st.warning(in_words(reason), icon=":material/lock:")
    st.caption(say("source.press.how", serial=lot.source))
    run = newest_run(station, (OrderKind.SOURCE,), lot.id)
    is_busy = registry().order_queue.active(station) is not None
    if st.button(say("source.step.2"), type="primary", icon=":material/play_arrow:", disabled=is_busy):
        if place(station, OrderKind.SOURCE, lot.source, lot.id):
            st.rerun()
    if run is not None and run_panel(run):
        st.success(in_words(run[1].message) or say("source.pressed"), icon=":material/check:")
