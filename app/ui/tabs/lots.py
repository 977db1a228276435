"""The ways to a new lot: out of files, or pressed on a rig step by step."""

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import pandas as pd
import streamlit as st

from softcal.app.batch.lot_intake import expect, store_lot
from softcal.app.charts import station as charts_station
from softcal.app.charts import unit as charts_unit
from softcal.app.charts.new_lot import columns_over_time, reference_over_output
from softcal.app.files.import_plan import Columns, ImportPlan
from softcal.app.files.importing import shown_rate_Hz
from softcal.app.jobs.jobs import newest_source
from softcal.app.texts.reasons import all_said
from softcal.app.ui.account import actor, permit
from softcal.app.ui.actions import refusals_in_words
from softcal.app.ui.components.job_panel import begin_job, is_running, job_panel, newest_job
from softcal.app.ui.components.lot_upload import (
    choose_columns,
    choose_layout,
    dropped_files,
    first_readable,
    forget_files,
)
from softcal.app.ui.components.station_run import choose_station, newest_run, place, run_panel
from softcal.app.ui.desk import choose, colours, in_words, instant, say, zone
from softcal.app.ui.panels import go_to, numbers, rest_may_follow, show_figure, step, table
from softcal.app.ui.server_memory import registry
from softcal.app.views.lots import proposed_lot_id
from softcal.app.views.network import network_rows
from softcal.app.views.station import source_facts
from softcal.core.errors import InputError
from softcal.core.limit_text import LimitText, proposed_limit
from softcal.core.lot import Lot
from softcal.core.maps.catalogue import FAMILIES
from softcal.core.maps.config import DEFAULT
from softcal.core.orders import OrderKind

ROWS = 5
ASKED = "new-lot-asked"


def draw_files() -> None:
    """Draw the way out of files: columns, source, refusals, calibration."""
    if asked := st.session_state.get(ASKED):
        st.markdown(say("new_lot.calibrating", lot=asked))
        job = newest_job("calibrate", lot=asked)
        is_over = job is None or job_panel(job)
        if is_over or (not is_running(job) and st.button(say("new_lot.to_lot"), icon=":material/arrow_forward:")):
            del st.session_state[ASKED]
            go_to("lot", lot=asked)
        return
    with step("new_lot", 1):
        st.caption(say("new_lot.files.how"))
        files = dropped_files()
        layout = choose_layout()
        readable = first_readable(files, layout) if files else None
    if readable is None:
        return
    path, content = readable
    with step("new_lot", 2):
        st.caption(say("new_lot.preview", file=path.name, rows=len(content), columns=len(content.columns)))
        st.dataframe(content.head(ROWS), width="stretch", hide_index=True)
        shapes = {"files": say("new_lot.shape.files"), "wide": say("new_lot.shape.wide")}
        shape = st.radio(say("new_lot.shape"), list(shapes), format_func=shapes.__getitem__, horizontal=True)
        columns = choose_columns(content, shape == "wide")
        if columns.time is None:
            rate_Hz = float(st.number_input(f"{say('column.rate')} [Hz]", 0.1, 100_000.0, 50.0, key="new-lot-rate"))
        else:
            try:
                rate_Hz = shown_rate_Hz(path, columns, layout)
                st.caption(say("new_lot.rate", rate=f"{rate_Hz:g}"))
            except InputError as error:
                rate_Hz = 0.0
                why = str(error).replace(f"{path}: ", "").split(";")[0]
                st.error(say("new_lot.time.refused", why=why), icon=":material/error:")
        left, right = st.columns(2)
        with left:
            show_figure(columns_over_time(content, columns, colours(), say), "new-lot-figure")
        with right:
            if columns.reference is not None and (figure := reference_over_output(content, columns, colours(), say)):
                show_figure(figure, "new-lot-figure-reference")
    with step("new_lot", 3):
        facts, has_audits = _facts(files, content, columns)
    if not rate_Hz or not facts["id"]:
        st.info(say("new_lot.missing"), icon=":material/edit:")
        return
    try:
        plan = ImportPlan(files, columns, Lot(sample_rate_Hz=rate_Hz, **facts), has_audits, table=layout)
    except InputError as error:
        st.error(in_words(error), icon=":material/error:")
        return
    with step("new_lot", 4):
        usable = _expected(plan)
    family = st.selectbox(say("new_lot.map"), [DEFAULT, *FAMILIES], help=say("new_lot.map.help"), key="new-lot-map")
    if usable is not None and st.button(say("new_lot.do"), type="primary", icon=":material/play_arrow:"):
        permit("set_up")
        store_lot(registry(), usable, actor())
        begin_job("calibrate", lot=usable.lot.id, map=family)
        forget_files()
        st.session_state[ASKED] = usable.lot.id
        st.rerun()


def _facts(files: Sequence[Path], content: pd.DataFrame, columns: Columns) -> tuple[dict[str, Any], bool]:
    """Draw the form; return the lot's facts by name, and whether references are audits."""
    if columns.is_wide:
        others = {columns.reference, columns.time, columns.stage}
        names = (str(name) for name in content.columns if name not in others)
        serials = list(filter(columns.is_output, names))
    else:
        serials = [file.stem for file in files]
    first, second, third, fourth = st.columns(4)
    proposed = proposed_lot_id(registry(), datetime.now(zone()).date())
    facts: dict[str, Any] = {
        "id": first.text_input(say("choose.lot"), proposed, key="new-lot-name"),
        "sensor_model": third.text_input(say("source.model"), placeholder="eGaIn pad, 3 mm", key="new-lot-model"),
    }
    source = str(second.selectbox(say("new_lot.source"), serials, key="new-lot-source") or "")
    limit = _limit(fourth, content, columns)
    first, second, third, fourth = st.columns(4, vertical_alignment="bottom")
    facts |= {
        "reference_quantity": first.text_input(say("source.quantity"), "force", key="new-lot-quantity"),
        "reference_unit": second.text_input(say("source.reference_unit"), "N", key="new-lot-unit"),
        "output_unit": third.text_input(say("source.output_unit"), "V", key="new-lot-output-unit"),
    }
    audit = fourth.toggle(say("new_lot.audit"), True, help=say("new_lot.audit.help"), key="new-lot-audit")
    facts = {name: str(fact).strip() for name, fact in facts.items()}
    return facts | {"source": source, "limit_rmse": limit}, audit


def _limit(place: Any, content: pd.DataFrame, columns: Columns) -> float | None:
    """Ask for the limit, in the unit of the reference or in per cent of its range; None until it is confirmed."""
    loads = pd.to_numeric(content.get(columns.reference, pd.Series(dtype=float)), errors="coerce")
    full_range = float(loads.max() - loads.min()) if loads.notna().any() else None
    proposed, is_percent, key = proposed_limit(full_range) if full_range else None, False, "new-lot-limit"
    number = place.number_input(
        say("lot.limit"), 0.0, value=proposed, format="%.4g", help=say("lot.limit.help"), key=key
    )
    if full_range:
        is_percent = place.toggle(say("new_lot.limit.percent"), key=f"{key}-percent")
    if not place.checkbox(say("new_lot.limit.agreed"), key=f"{key}-agreed") or not number:
        place.caption(say("new_lot.limit.none"))
        return None
    return LimitText(float(number), is_percent).rmse(full_range)


def _expected(plan: ImportPlan) -> ImportPlan | None:
    """Draw what would become of every unit; return the plan without what is refused."""
    lot = expect(plan, registry())
    expected = lot.units
    refused = [one for one in expected if one.problem]
    doubtful = [one for one in expected if one.findings]
    good = len(expected) - len(refused) - len(doubtful)
    st.markdown(say("new_lot.expected", good=good, doubtful=len(doubtful), refused=len(refused)))
    rows = []
    for one in sorted(expected, key=lambda one: (not one.problem, not one.findings)):
        will = "doubtful" if one.findings else "good"
        will = "refused" if one.problem else "source" if one.serial == plan.lot.source else will
        rows.append(
            {
                say("new_lot.column.file"): one.file,
                say("column.serial"): one.serial or None,
                say("new_lot.column.rows"): one.rows or None,
                say("column.duration"): f"{one.seconds:.0f} s" if one.rows else None,
                say("new_lot.column.will"): say(f"new_lot.will.{will}"),
                say("column.reasons"): in_words(one.problem) if one.problem else all_said(one.findings, say),
            }
        )
    table(rows)
    for remark in lot.remarks:
        st.warning(in_words(remark), icon=":material/warning:")
    if plan.audit:
        targets = sum(not one.problem and one.serial not in plan.sources for one in expected)
        st.caption(say("not_used.audits", audits=len(lot.audits), units=targets))
    if lot.not_used:
        st.markdown(f"**{say('not_used')}**")
        kind, name, why = (say(f"not_used.{column}") for column in ("kind", "name", "why"))
        table(
            {
                kind: say(f"not_used.{one.kind}"),
                name: f"{one.name} ({one.file})" if one.file else one.name,
                why: in_words(one.why),
            }
            for one in lot.not_used
        )
    source = next((one for one in expected if one.serial == plan.lot.source), None)
    if source is None or source.problem or plan.columns.reference is None:
        st.error(say("new_lot.no_source", source=plan.lot.source), icon=":material/error:")
        return None
    if len(expected) - len(refused) < 2:
        st.error(say("new_lot.no_units"), icon=":material/error:")
        return None
    unreadable = {one.file for one in refused if not one.serial}
    files = tuple(file for file in plan.files if file.name not in unreadable)
    return replace(plan, files=files, without=frozenset(one.serial for one in refused if one.serial))


def draw_rig() -> None:
    """Draw the steps on a rig: the lot, the press, a look at the recording, the network."""
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
