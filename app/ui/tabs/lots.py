"""The ways to a new lot: out of files, or pressed on a rig step by step."""

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import pandas as pd
import streamlit as st

from softcal.app.batch.lot_intake import preview_lot, store_lot
from softcal.app.charts import station as charts_station
from softcal.app.charts import unit as charts_unit
from softcal.app.charts.new_lot import columns_over_time, reference_over_output
from softcal.app.files.import_plan import Columns, ImportPlan
from softcal.app.files.importing import detect_rate_Hz
from softcal.app.jobs.jobs import newest_source
from softcal.app.texts.reasons import render_reasons
from softcal.app.ui.account import actor, permit
from softcal.app.ui.actions import show_refusals
from softcal.app.ui.components.job_panel import begin_job, is_running, job_panel, newest_job
from softcal.app.ui.components.lot_upload import (
    choose_columns,
    choose_layout,
    dropped_files,
    first_readable,
    forget_files,
)
from softcal.app.ui.components.station_run import choose_station, newest_run, place_order, run_panel
from softcal.app.ui.panels import go_to, numbers, rest_may_follow, show_figure, step, table
from softcal.app.ui.presentation import choose, colours, format_instant, localize, translate, zone
from softcal.app.ui.server_cache import registry
from softcal.app.views.lots import proposed_lot_id
from softcal.app.views.network import network_rows
from softcal.app.views.station import source_values
from softcal.core.errors import InputError
from softcal.core.limit_text import LimitText, proposed_limit
from softcal.core.lot import Lot
from softcal.core.maps.catalogue import FAMILIES
from softcal.core.maps.config import DEFAULT
from softcal.core.orders import OrderKind

ROWS = 5
JOB_KEY = "new-lot-asked"


def draw_files() -> None:
    """Draw the way out of files: columns, source, refusals, calibration."""
    if requested_lot := st.session_state.get(JOB_KEY):
        st.markdown(translate("new_lot.calibrating", lot=requested_lot))
        job = newest_job("calibrate", lot=requested_lot)
        is_over = job is None or job_panel(job)
        if is_over or (not is_running(job) and st.button(translate("new_lot.to_lot"), icon=":material/arrow_forward:")):
            del st.session_state[JOB_KEY]
            go_to("lot", lot=requested_lot)
        return
    with step("new_lot", 1):
        st.caption(translate("new_lot.files.how"))
        files = dropped_files()
        layout = choose_layout()
        readable = first_readable(files, layout) if files else None
    if readable is None:
        return
    path, content = readable
    with step("new_lot", 2):
        st.caption(translate("new_lot.preview", file=path.name, rows=len(content), columns=len(content.columns)))
        st.dataframe(content.head(ROWS), width="stretch", hide_index=True)
        shapes = {"files": translate("new_lot.shape.files"), "wide": translate("new_lot.shape.wide")}
        shape = st.radio(translate("new_lot.shape"), list(shapes), format_func=shapes.__getitem__, horizontal=True)
        columns = choose_columns(content, shape == "wide")
        if columns.time is None:
            rate_Hz = float(
                st.number_input(f"{translate('column.rate')} [Hz]", 0.1, 100_000.0, 50.0, key="new-lot-rate")
            )
        else:
            try:
                rate_Hz = detect_rate_Hz(path, columns, layout)
                st.caption(translate("new_lot.rate", rate=f"{rate_Hz:g}"))
            except InputError as error:
                rate_Hz = 0.0
                cause = str(error).replace(f"{path}: ", "").split(";")[0]
                st.error(translate("new_lot.time.refused", why=cause), icon=":material/error:")
        left, right = st.columns(2)
        with left:
            show_figure(columns_over_time(content, columns, colours(), translate), "new-lot-figure")
        with right:
            if columns.reference is not None and (
                figure := reference_over_output(content, columns, colours(), translate)
            ):
                show_figure(figure, "new-lot-figure-reference")
    with step("new_lot", 3):
        lot_fields, has_audits = _lot_fields(files, content, columns)
    if not rate_Hz or not lot_fields["id"]:
        st.info(translate("new_lot.missing"), icon=":material/edit:")
        return
    try:
        plan = ImportPlan(files, columns, Lot(sample_rate_Hz=rate_Hz, **lot_fields), has_audits, table=layout)
    except InputError as error:
        st.error(localize(error), icon=":material/error:")
        return
    with step("new_lot", 4):
        usable = _expected(plan)
    family = st.selectbox(
        translate("new_lot.map"), [DEFAULT, *FAMILIES], help=translate("new_lot.map.help"), key="new-lot-map"
    )
    if usable is not None and st.button(translate("new_lot.do"), type="primary", icon=":material/play_arrow:"):
        permit("set_up")
        store_lot(registry(), usable, actor())
        begin_job("calibrate", lot=usable.lot.id, map=family)
        forget_files()
        st.session_state[JOB_KEY] = usable.lot.id
        st.rerun()


def _lot_fields(files: Sequence[Path], content: pd.DataFrame, columns: Columns) -> tuple[dict[str, Any], bool]:
    """Draw the form; return the lot's facts by name, and whether references are audits."""
    if columns.is_wide:
        others = {columns.reference, columns.time, columns.stage}
        names = (str(name) for name in content.columns if name not in others)
        serials = list(filter(columns.is_output, names))
    else:
        serials = [file.stem for file in files]
    first, second, third, fourth = st.columns(4)
    proposed = proposed_lot_id(registry(), datetime.now(zone()).date())
    lot_fields: dict[str, Any] = {
        "id": first.text_input(translate("choose.lot"), proposed, key="new-lot-name"),
        "sensor_model": third.text_input(translate("source.model"), placeholder="eGaIn pad, 3 mm", key="new-lot-model"),
    }
    source = str(second.selectbox(translate("new_lot.source"), serials, key="new-lot-source") or "")
    limit = _limit(fourth, content, columns)
    first, second, third, fourth = st.columns(4, vertical_alignment="bottom")
    lot_fields |= {
        "reference_quantity": first.text_input(translate("source.quantity"), "force", key="new-lot-quantity"),
        "reference_unit": second.text_input(translate("source.reference_unit"), "N", key="new-lot-unit"),
        "output_unit": third.text_input(translate("source.output_unit"), "V", key="new-lot-output-unit"),
    }
    audit = fourth.toggle(translate("new_lot.audit"), True, help=translate("new_lot.audit.help"), key="new-lot-audit")
    lot_fields = {name: str(value).strip() for name, value in lot_fields.items()}
    return lot_fields | {"source": source, "limit_rmse": limit}, audit


def _limit(slot: Any, content: pd.DataFrame, columns: Columns) -> float | None:
    """Ask for the limit, in the unit of the reference or in per cent of its range; None until it is confirmed."""
    loads = pd.to_numeric(content.get(columns.reference, pd.Series(dtype=float)), errors="coerce")
    full_range = float(loads.max() - loads.min()) if loads.notna().any() else None
    proposed, is_percent, key = proposed_limit(full_range) if full_range else None, False, "new-lot-limit"
    number = slot.number_input(
        translate("lot.limit"), 0.0, value=proposed, format="%.4g", help=translate("lot.limit.help"), key=key
    )
    if full_range:
        is_percent = slot.toggle(translate("new_lot.limit.percent"), key=f"{key}-percent")
    if not slot.checkbox(translate("new_lot.limit.agreed"), key=f"{key}-agreed") or not number:
        slot.caption(translate("new_lot.limit.none"))
        return None
    return LimitText(float(number), is_percent).rmse(full_range)


def _expected(plan: ImportPlan) -> ImportPlan | None:
    """Draw what would become of every unit; return the plan without what is refused."""
    lot = preview_lot(plan, registry())
    expected = lot.units
    refused = [one for one in expected if one.problem]
    doubtful = [one for one in expected if one.findings]
    good = len(expected) - len(refused) - len(doubtful)
    st.markdown(translate("new_lot.expected", good=good, doubtful=len(doubtful), refused=len(refused)))
    rows = []
    for one in sorted(expected, key=lambda one: (not one.problem, not one.findings)):
        outcome = "doubtful" if one.findings else "good"
        outcome = "refused" if one.problem else "source" if one.serial == plan.lot.source else outcome
        rows.append(
            {
                translate("new_lot.column.file"): one.file,
                translate("column.serial"): one.serial or None,
                translate("new_lot.column.rows"): one.rows or None,
                translate("column.duration"): f"{one.seconds:.0f} s" if one.rows else None,
                translate("new_lot.column.will"): translate(f"new_lot.will.{outcome}"),
                translate("column.reasons"): localize(one.problem)
                if one.problem
                else render_reasons(one.findings, translate),
            }
        )
    table(rows)
    for remark in lot.remarks:
        st.warning(localize(remark), icon=":material/warning:")
    if plan.audit:
        targets = sum(not one.problem and one.serial not in plan.sources for one in expected)
        st.caption(translate("not_used.audits", audits=len(lot.audits), units=targets))
    if lot.not_used:
        st.markdown(f"**{translate('not_used')}**")
        kind, name, reason_title = (translate(f"not_used.{column}") for column in ("kind", "name", "why"))
        table(
            {
                kind: translate(f"not_used.{one.kind}"),
                name: f"{one.name} ({one.file})" if one.file else one.name,
                reason_title: localize(one.why),
            }
            for one in lot.not_used
        )
    source = next((one for one in expected if one.serial == plan.lot.source), None)
    if source is None or source.problem or plan.columns.reference is None:
        st.error(translate("new_lot.no_source", source=plan.lot.source), icon=":material/error:")
        return None
    if len(expected) - len(refused) < 2:
        st.error(translate("new_lot.no_units"), icon=":material/error:")
        return None
    unreadable = {one.file for one in refused if not one.serial}
    files = tuple(file for file in plan.files if file.name not in unreadable)
    return replace(plan, files=files, without=frozenset(one.serial for one in refused if one.serial))


def draw_rig() -> None:
    """Draw the steps on a rig: the lot, the press, a look at the recording, the network."""
    st.caption(translate("source.how"))
    with step("source", 1):
        lot_ids = registry().lots.ids()
        lot_id = choose(translate("choose.lot"), lot_ids, "lot")
        lot = None if lot_id is None else registry().lots.get(lot_id)
        with st.expander(translate("lots.new"), icon=":material/add:", expanded=not lot_ids):
            with st.form("lot", border=False):
                left, middle, right = st.columns(3)
                name = str(left.text_input(translate("choose.lot"), placeholder="2026-48")).strip()
                source_serial = str(middle.text_input(translate("source.serial"), placeholder="S1")).strip()
                model = str(right.text_input(translate("source.model"), placeholder="eGaIn pad, 3 mm")).strip()
                left, middle, right = st.columns(3)
                quantity = str(left.text_input(translate("source.quantity"), "force")).strip()
                reference_unit = str(middle.text_input(translate("source.reference_unit"), "N")).strip()
                output_unit = str(right.text_input(translate("source.output_unit"), "V")).strip()
                rate_Hz = st.number_input(f"{translate('column.rate')} [Hz]", 0.1, 100_000.0, 50.0)
                is_sent = st.form_submit_button(translate("source.add_lot"))
            if is_sent:
                permit("set_up")
                with show_refusals():
                    new_lot = Lot(name, source_serial, rate_Hz, model, quantity, reference_unit, output_unit)
                    registry().lots.add(new_lot, actor=actor())
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
        pressed_at = registry().recordings.of_lot(lot.id, kind="source")[-1].added_at
        numbers([(translate(key), value, None) for key, value in source_values(source).items()], narrowest_px=235)
        st.caption(translate("source.look.how", made=format_instant(pressed_at)))
        if rest_may_follow():
            left, right = st.columns(2)
            with left:
                show_figure(charts_unit.recording(source, lot, colours(), translate), "source-recording")
            with right:
                show_figure(charts_station.source_curve(source, lot, colours(), translate), "source-curve")
    with step("source", 4):
        fresh = [row for row in network_rows(registry(), lot.id) if not row.is_stale]
        if fresh:
            st.markdown(translate("source.trained", network=fresh[0].id[:12], layers=fresh[0].layers))
        else:
            st.markdown(translate("source.untrained"))
        if st.button(translate("source.to_networks"), icon=":material/arrow_forward:"):
            go_to("lot", lot=lot.id, tab="networks")


def _press(lot: Lot) -> None:
    station = choose_station()
    if station is None:
        return
    status = registry().order_queue.heartbeat(station)
    for reason in status.reasons if status else ():
        st.warning(localize(reason), icon=":material/lock:")
    st.caption(translate("source.press.how", serial=lot.source))
    run = newest_run(station, (OrderKind.SOURCE,), lot.id)
    is_busy = registry().order_queue.active(station) is not None
    if st.button(translate("source.step.2"), type="primary", icon=":material/play_arrow:", disabled=is_busy):
        if place_order(station, OrderKind.SOURCE, lot.source, lot.id):
            st.rerun()
    if run is not None and run_panel(run):
        st.success(localize(run[1].message) or translate("source.pressed"), icon=":material/check:")
