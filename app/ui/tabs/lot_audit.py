"""The audit of a lot: draw units for the load cell, bring their recordings, see the result."""

from datetime import UTC, date, datetime, time

import streamlit as st

from softcal.app.calibration.audit import LotAudit, draw_plan, lot_audit
from softcal.app.calibration.audit_files import look_at_audits, store_audits, unused_of_audits
from softcal.app.calibration.redecision import confirm
from softcal.app.charts.audited import error_over_load, estimate_over_reference
from softcal.app.files.measured_at import local_time_remarks
from softcal.app.registry.lot_recordings import source_of_lot, target_serials
from softcal.app.ui.account import actor, allows, permit
from softcal.app.ui.actions import ask_reason, csv_of, download, role_allows, say_finished
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
from softcal.app.ui.desk import colours, in_words, instant, say, verdict_word, zone
from softcal.app.ui.panels import figures_beside, go_to, has_units, numbers, table, unit_link
from softcal.app.ui.server_memory import (
    registry,
    remembered_audited,
    remembered_confirmation,
    remembered_lot_view,
    remembered_outline,
)
from softcal.app.views.common import number
from softcal.core.lot import Lot, UnitKey
from softcal.core.quality.audit_plan import AuditConfig

ASKED, ACTION = "audit", "set_up"
MOST_ROWS = 200


def draw_audit(lot_id: str) -> None:
    if not has_units(lot_id):
        return
    st.markdown(say("audit.what"))
    lot, audit = registry().lots.get(lot_id), lot_audit(registry(), lot_id)
    unit = lot.reference_unit
    if audit is None:
        with st.container(border=True):
            st.markdown(f"## {say('audit.draw')}")
            config = _config()
            if role_allows(ACTION):
                if st.button(say("audit.draw.do"), type="primary", icon=":material/casino:", key="audit-draw"):
                    permit(ACTION)
                    draw_plan(registry(), lot_id, config, actor=actor())
                    st.rerun()
    else:
        _plan(audit, lot)

    audited, limit = remembered_outline(lot_id).audited, remembered_lot_view(lot_id).limit_rmse
    if audited:
        st.markdown(f"## {say('audit.units')}")
        table(
            {
                say("column.serial"): unit_link(UnitKey(lot_id, row.serial)),
                say("release.forecast"): number(row.forecast_rmse, unit, limit),
                say("release.measured"): number(row.measured_rmse, unit, limit),
                say("column.verdict"): verdict_word(row.verdict),
                say("audit.brought"): instant(row.audited_at),
            }
            for row in audited[:MOST_ROWS]
        )
        _figures(lot_id)
    for serial, doubt in ((row.serial, row.doubt) for row in audited if row.doubt is not None):
        with st.container(border=True):
            st.warning(in_words(doubt), title=serial, icon=":material/rule:")
            if allows("release"):
                draw_changes(remembered_confirmation(lot_id, serial).changed)
            reason = ask_reason(f"confirm-{lot_id}/{serial}", say("audit.confirm", serial=serial), "release")
        if reason is not None:
            confirm(registry(), lot_id, serial, reason=reason, actor=actor())
            st.rerun()

    if not allows(ACTION):
        return
    with st.container(border=True):
        st.markdown(f"## {say('audit.bring')}")
        if awaits_calibration(ASKED, lot_id):
            return
        if say_finished(ASKED):
            if st.button(say("new_lot.to_lot"), icon=":material/arrow_forward:", key="audit-to-lot"):
                go_to("lot", lot=lot_id)
        st.caption(say("audit.bring.how"))
        files = dropped_files(ASKED)
        layout = choose_layout()
        readable = first_readable(files, layout) if files else None
        if readable is None:
            return
        columns = choose_columns(readable[1], wide=False)
        today = datetime.now(UTC).astimezone(zone()).date()
        day = st.date_input(say("audit.measured_at"), None, max_value=today, help=say("audit.measured_at.help"))
        stated = datetime.combine(day, time(), zone()).astimezone(UTC) if isinstance(day, date) else None
        looked = look_at_audits(lot, target_serials(registry(), lot_id), files, columns, layout, stated)
        rows = []
        for one in looked:
            recording = one.recording
            seconds = None if recording is None else len(recording) / recording.unlabelled.sample_rate_Hz
            rows.append(
                {
                    say("new_lot.column.file"): one.file,
                    say("column.serial"): one.serial or None,
                    say("audit.measured_at"): None if one.measured_at is None else instant(one.measured_at),
                    say("column.duration"): None if seconds is None else f"{seconds:.0f} s",
                    say("column.reasons"): "" if one.refusal is None else in_words(one.refusal),
                }
            )
        table(rows)
        for line in local_time_remarks({one.read.table.path: one.read.start for one in looked if one.read is not None}):
            st.caption(line)
        for remark in unused_of_audits(lot, looked, registry(), source=source_of_lot(registry(), lot))[1]:
            st.warning(in_words(remark), icon=":material/warning:")
        taken = sum(one.recording is not None for one in looked)
        if st.button(say("audit.take", count=taken), type="primary", disabled=not taken, key="audit-take"):
            permit(ACTION)
            store_audits(registry(), lot_id, looked, actor())
            st.session_state[ASKED] = begin_job("calibrate", ACTION, lot=lot_id)
            forget_files(ASKED)
            st.rerun()


def _figures(lot_id: str) -> None:
    """Draw the audited units: estimate against reference, and the error over the load."""
    audited = remembered_audited(lot_id) if st.session_state.get(HAS_DRAWN) else None
    if audited is None:
        return
    figures_beside(
        ("lot.audited.estimate", estimate_over_reference(audited, colours(), say), "audited-estimate"),
        ("lot.audited.load", error_over_load(audited, colours(), say), "audited-load"),
    )
    st.caption(say("lot.audited.count", shown=len(audited.units), of=audited.of))


def _plan(audit: LotAudit, lot: Lot) -> None:
    """Draw the drawn units, what their audits say of the lot, and a way to draw others."""
    unit, statement, limit = lot.reference_unit, audit.statement, audit.limit.maximum_rmse
    numbers(
        (
            (say("audit.measured"), f"{len(audit.measured)} / {len(audit.plan.serials)}", None),
            (say("lot.limit"), number(limit, unit, limit), None),
            (say("audit.says"), "–" if statement is None else say(f"verdict.{statement.word}"), None),
        )
    )
    if statement is not None:
        st.markdown(say("audit.statement", upper=statement.nonconforming_upper, ratio=f"{statement.error_ratio:.2g}"))
    rows = [
        {
            say("column.serial"): unit_link(UnitKey(lot.id, serial)),
            say("audit.why"): say(f"audit.why.{why}"),
            say("release.forecast"): number(forecast, unit, limit),
            say("release.measured"): number(measured, unit, limit),
            say("station.result"): say(f"audit.result.{result}"),
        }
        for serial, why, forecast, measured, result in audit.rows
    ]
    table(rows)
    download(say("audit.list"), f"{lot.id}-audit.csv", csv_of(rows), "audit-list")
    with st.expander(say("audit.again"), icon=":material/casino:"):
        st.caption(say("audit.again.why"))
        config = _config()
        reason = ask_reason("audit-again", say("audit.draw.do"), ACTION)
        if reason is not None:
            draw_plan(registry(), lot.id, config, reason=reason, actor=actor())
            st.rerun()


def _config() -> AuditConfig:
    usual = AuditConfig()
    left, right = st.columns(2)
    drawn = int(left.number_input(say("audit.random"), 1, 1000, usual.random, help=say("audit.random.help")))
    doubtful = int(right.number_input(say("audit.doubtful"), 0, 1000, usual.doubtful, help=say("audit.doubtful.help")))
    return AuditConfig(doubtful, drawn)
