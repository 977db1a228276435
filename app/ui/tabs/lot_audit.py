"""The audit of a lot: draw units for the load cell, bring their recordings, see the result."""

from datetime import UTC, date, datetime, time

import streamlit as st

from softcal.app.calibration.audit import LotAudit, draw_plan, lot_audit
from softcal.app.calibration.audit_files import read_audit_files, store_audits, unused_of_audits
from softcal.app.calibration.redecision import confirm
from softcal.app.charts.audited import error_over_load, estimate_over_reference
from softcal.app.files.measured_at import local_time_remarks
from softcal.app.registry.lot_recordings import source_of_lot, target_serials
from softcal.app.ui.account import actor, allows, permit
from softcal.app.ui.actions import ask_reason, csv_of, download, role_allows, show_finished
from softcal.app.ui.browser_memory import HAS_DRAWN
from softcal.app.ui.components.job_panel import awaits_calibration, begin_job
from softcal.app.ui.components.lot_upload import (
    choose_columns,
    choose_layout,
    dropped_files,
    first_readable,
    forget_files,
)
from softcal.app.ui.components.verdict_changes import draw_changes
from softcal.app.ui.panels import go_to, has_units, numbers, show_figures, table, unit_link
from softcal.app.ui.presentation import colours, format_instant, localize, translate, verdict_word, zone
from softcal.app.ui.server_cache import (
    cached_audited_view,
    cached_lot_outline,
    cached_lot_view,
    registry,
    remembered_confirmation,
)
from softcal.app.views.common import number, render_limit
from softcal.core.lot import Lot, UnitKey
from softcal.core.quality.audit_plan import AuditConfig

JOB_KEY, ACTION = "audit", "set_up"
MAX_ROWS = 200


def draw_audit(lot_id: str) -> None:
    if not has_units(lot_id):
        return
    st.markdown(translate("audit.what"))
    lot, audit = registry().lots.get(lot_id), lot_audit(registry(), lot_id)
    unit = lot.reference_unit
    if audit is None:
        with st.container(border=True):
            st.markdown(f"## {translate('audit.draw')}")
            config = _config()
            if role_allows(ACTION):
                if st.button(translate("audit.draw.do"), type="primary", icon=":material/casino:", key="audit-draw"):
                    permit(ACTION)
                    draw_plan(registry(), lot_id, config, actor=actor())
                    st.rerun()
    else:
        _plan(audit, lot)

    audited, limit = cached_lot_outline(lot_id).audited, cached_lot_view(lot_id).limit_rmse
    if audited:
        st.markdown(f"## {translate('audit.units')}")
        table(
            {
                translate("column.serial"): unit_link(UnitKey(lot_id, row.serial)),
                translate("release.forecast"): number(row.forecast_rmse, unit, limit),
                translate("release.measured"): number(row.measured_rmse, unit, limit),
                translate("column.verdict"): verdict_word(row.verdict),
                translate("audit.brought"): format_instant(row.audited_at),
            }
            for row in audited[:MAX_ROWS]
        )
        _figures(lot_id)
    for serial, suspect_reason in (
        (row.serial, row.suspect_reason) for row in audited if row.suspect_reason is not None
    ):
        with st.container(border=True):
            st.warning(localize(suspect_reason), title=serial, icon=":material/rule:")
            if allows("release"):
                draw_changes(remembered_confirmation(lot_id, serial).changed)
            reason = ask_reason(f"confirm-{lot_id}/{serial}", translate("audit.confirm", serial=serial), "release")
        if reason is not None:
            confirm(registry(), lot_id, serial, reason=reason, actor=actor())
            st.rerun()

    if not allows(ACTION):
        return
    with st.container(border=True):
        st.markdown(f"## {translate('audit.bring')}")
        if awaits_calibration(JOB_KEY, lot_id):
            return
        if show_finished(JOB_KEY):
            if st.button(translate("new_lot.to_lot"), icon=":material/arrow_forward:", key="audit-to-lot"):
                go_to("lot", lot=lot_id)
        st.caption(translate("audit.bring.how"))
        files = dropped_files(JOB_KEY)
        layout = choose_layout()
        readable = first_readable(files, layout) if files else None
        if readable is None:
            return
        columns = choose_columns(readable[1], wide=False)
        today = datetime.now(UTC).astimezone(zone()).date()
        day = st.date_input(
            translate("audit.measured_at"), None, max_value=today, help=translate("audit.measured_at.help")
        )
        declared_at = datetime.combine(day, time(), zone()).astimezone(UTC) if isinstance(day, date) else None
        audit_files = read_audit_files(lot, target_serials(registry(), lot_id), files, columns, layout, declared_at)
        rows = []
        for one in audit_files:
            recording = one.recording
            seconds = None if recording is None else len(recording) / recording.unlabelled.sample_rate_Hz
            rows.append(
                {
                    translate("new_lot.column.file"): one.file,
                    translate("column.serial"): one.serial or None,
                    translate("audit.measured_at"): None
                    if one.measured_at is None
                    else format_instant(one.measured_at),
                    translate("column.duration"): None if seconds is None else f"{seconds:.0f} s",
                    translate("column.reasons"): "" if one.refusal is None else localize(one.refusal),
                }
            )
        table(rows)
        for line in local_time_remarks(
            {one.read.table.path: one.read.start for one in audit_files if one.read is not None}
        ):
            st.caption(line)
        for remark in unused_of_audits(lot, audit_files, registry(), source=source_of_lot(registry(), lot))[1]:
            st.warning(localize(remark), icon=":material/warning:")
        usable_count = sum(one.recording is not None for one in audit_files)
        if st.button(
            translate("audit.take", count=usable_count), type="primary", disabled=not usable_count, key="audit-take"
        ):
            permit(ACTION)
            store_audits(registry(), lot_id, audit_files, actor())
            st.session_state[JOB_KEY] = begin_job("calibrate", ACTION, lot=lot_id)
            forget_files(JOB_KEY)
            st.rerun()


def _figures(lot_id: str) -> None:
    """Draw the audited units: estimate against reference, and the error over the load."""
    audited = cached_audited_view(lot_id) if st.session_state.get(HAS_DRAWN) else None
    if audited is None:
        return
    show_figures(
        ("lot.audited.estimate", estimate_over_reference(audited, colours(), translate), "audited-estimate"),
        ("lot.audited.load", error_over_load(audited, colours(), translate), "audited-load"),
    )
    st.caption(translate("lot.audited.count", shown=len(audited.units), of=audited.of))


def _plan(audit: LotAudit, lot: Lot) -> None:
    """Draw the drawn units, what their audits say of the lot, and a way to draw others."""
    unit, statement, limit = lot.reference_unit, audit.statement, audit.limit.maximum_rmse
    numbers(
        (
            (translate("audit.measured"), f"{len(audit.measured)} / {len(audit.plan.serials)}", None),
            (translate("lot.limit"), render_limit(audit.limit, translate), None),
            (translate("audit.beyond"), "–" if statement is None else str(len(statement.failed)), None),
        )
    )
    if statement is not None:
        st.markdown(
            translate("audit.statement", upper=statement.nonconforming_upper, ratio=f"{statement.error_ratio:.2g}")
        )
    shown, listed = list[dict[str, object]](), list[dict[str, object]]()
    for serial, cause, forecast, measured, result in audit.rows:
        words = {
            translate("audit.why"): translate(f"audit.why.{cause}"),
            translate("station.result"): translate(f"audit.result.{result}"),
        }
        errors = {translate("release.forecast"): forecast, translate("release.measured"): measured}
        rendered = {name: number(error, unit, limit) for name, error in errors.items()}
        shown.append({translate("column.serial"): unit_link(UnitKey(lot.id, serial)), **rendered, **words})
        # A file keeps the full precision.
        precise = {f"{name} [{unit}]": error for name, error in errors.items()}
        listed.append({translate("column.serial"): serial, **precise, **words})
    table(shown)
    download(translate("audit.list"), f"{lot.id}-audit.csv", csv_of(listed), "audit-list")
    with st.expander(translate("audit.again"), icon=":material/casino:"):
        st.caption(translate("audit.again.why"))
        config = _config()
        reason = ask_reason("audit-again", translate("audit.draw.do"), ACTION)
        if reason is not None:
            draw_plan(registry(), lot.id, config, reason=reason, actor=actor())
            st.rerun()


def _config() -> AuditConfig:
    defaults = AuditConfig()
    left, right = st.columns(2)
    random_count = int(
        left.number_input(translate("audit.random"), 1, 1000, defaults.random, help=translate("audit.random.help"))
    )
    doubtful = int(
        right.number_input(
            translate("audit.doubtful"), 0, 1000, defaults.doubtful, help=translate("audit.doubtful.help")
        )
    )
    return AuditConfig(doubtful, random_count)
