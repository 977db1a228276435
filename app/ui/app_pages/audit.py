"""The audit of a lot: draw the units to check with the load cell, bring their recordings, see what they say."""

from collections.abc import Sequence

import streamlit as st

from softcal.app.batch.audit import LotAudit, draw_plan, lot_audit
from softcal.app.batch.audit_files import AuditFile, look_at_audits, store_audits
from softcal.app.batch.judging import confirm
from softcal.app.batch.release import lot_standing
from softcal.app.files.spreadsheet import csv_text
from softcal.app.jobs.process import start_job
from softcal.app.registry.lot_recordings import target_serials
from softcal.app.texts.reasons import said
from softcal.app.ui.account import actor, permit, person
from softcal.app.ui.components.job_panel import job_panel, newest_job
from softcal.app.ui.components.lot_upload import choose_columns, dropped_files, first_readable, forget_files
from softcal.app.ui.desk import ask_reason, instant, registry, words
from softcal.app.ui.panels import go_to, lot_heading, numbers, table, units_of
from softcal.app.views.common import number
from softcal.core.quality.audit_plan import AuditConfig
from softcal.core.quality.lot_standing import UnitInLot
from softcal.db.access.people import may

ASKED, UPLOAD = "audit-asked", "audit"
ACTION = "set_up"


def render() -> None:
    say = words()
    lot_id = lot_heading("audit", registry().lots.ids())
    if lot_id is None:
        return
    if not units_of(lot_id):
        return
    st.markdown(say("audit.what"))
    audit = lot_audit(registry(), lot_id)
    if audit is None:
        _draw(lot_id)
    else:
        _stands(audit, lot_id)
    audits_panel(lot_id)
    _upload(lot_id)


def _draw(lot_id: str) -> None:
    say = words()
    with st.container(border=True):
        st.markdown(f"## {say('audit.draw')}")
        config = _config()
        if not may(person(), ACTION):
            st.caption(say("reason.not_allowed", role=say(f"role.{person().role}")))
        elif st.button(say("audit.draw.do"), type="primary", icon=":material/casino:", key="audit-draw"):
            permit(ACTION)
            draw_plan(registry(), lot_id, config, actor=actor())
            st.rerun()


def _config() -> AuditConfig:
    say, usual = words(), AuditConfig()
    left, right = st.columns(2)
    drawn = int(left.number_input(say("audit.random"), 1, 1000, usual.random, help=say("audit.random.help")))
    doubtful = int(right.number_input(say("audit.doubtful"), 0, 1000, usual.doubtful, help=say("audit.doubtful.help")))
    return AuditConfig(doubtful, drawn)


def _stands(audit: LotAudit, lot_id: str) -> None:
    say, unit = words(), registry().lots.get(lot_id).reference_unit
    numbers(
        (
            (say("audit.measured"), f"{len(audit.measured)} / {len(audit.plan.serials)}", None),
            (say("lot.limit"), number(audit.limit.maximum_rmse, unit), None),
            (say("audit.says"), ("–" if audit.statement is None else words()(f"verdict.{audit.statement.word}")), None),
        )
    )
    if audit.statement is not None:
        told = say(
            "audit.statement", upper=audit.statement.nonconforming_upper, ratio=f"{audit.statement.error_ratio:.2g}"
        )
        st.markdown(told)
    rows = [
        {
            say("column.serial"): serial,
            say("audit.why"): say(f"audit.why.{why}"),
            say("release.forecast"): number(forecast, unit),
            say("release.measured"): number(measured, unit),
            say("audit.result"): say(f"audit.result.{result}"),
        }
        for serial, why, forecast, measured, result in audit.rows
    ]
    table(rows)
    st.download_button(
        say("audit.list"),
        data=csv_text(list(rows[0]), [tuple(row.values()) for row in rows]).encode("utf-8-sig"),
        file_name=f"{lot_id}-audit.csv",
        mime="text/csv",
        icon=":material/download:",
        key="audit-list",
        on_click="ignore",
    )
    with st.expander(say("audit.again"), icon=":material/casino:"):
        st.caption(say("audit.again.why"))
        config = _config()
        reason = ask_reason("audit-again", say("audit.draw.do"), ACTION)
        if reason is not None:
            draw_plan(registry(), lot_id, config, reason=reason, actor=actor())
            st.rerun()


def _upload(lot_id: str) -> None:
    """Draw the field for labelled recordings, what would become of each, and how far their scoring is."""
    say = words()
    if not may(person(), ACTION):
        return
    with st.container(border=True):
        st.markdown(f"## {say('audit.bring')}")
        job = newest_job("calibrate", lot=lot_id)
        if job is not None and st.session_state.get(ASKED) == job.job_id:
            if job_panel(job):
                del st.session_state[ASKED]
                st.session_state["audit-done"] = True
                st.rerun()
            if job.state.is_active:
                return
        if st.session_state.pop("audit-done", False):
            st.success(say("audit.done"), icon=":material/check:")
            if st.button(say("new_lot.to_lot"), icon=":material/arrow_forward:", key="audit-to-lot"):
                go_to("lot", lot=lot_id)
        st.caption(say("audit.bring.how"))
        files = dropped_files(UPLOAD)
        found = first_readable(files) if files else None
        if found is None:
            return
        columns = choose_columns(found[1], wide=False)
        looked = look_at_audits(registry().lots.get(lot_id), target_serials(registry(), lot_id), files, columns)
        table([_row(one) for one in looked])
        taken = sum(one.recording is not None for one in looked)
        if st.button(say("audit.take", count=taken), type="primary", disabled=not taken, key="audit-take"):
            _take(lot_id, looked)


def _row(one: AuditFile) -> dict[str, object]:
    say, recording = words(), one.recording
    seconds = None if recording is None else f"{len(recording) / recording.unlabelled.sample_rate_Hz:.0f} s"
    return {
        say("new_lot.column.file"): one.file,
        say("column.serial"): one.serial or None,
        say("column.duration"): seconds,
        say("column.reasons"): "" if one.refusal is None else said(one.refusal, say),
    }


def _take(lot_id: str, looked: Sequence[AuditFile]) -> None:
    permit(ACTION)
    store_audits(registry(), lot_id, looked, actor())
    st.session_state[ASKED] = start_job(registry(), "calibrate", {"lot": lot_id}, actor())
    forget_files(UPLOAD)
    st.rerun()


MOST_ROWS = 200


def audits_panel(lot_id: str) -> None:
    """Draw the audited units; nothing where none was."""
    say, unit = words(), registry().lots.get(lot_id).reference_unit
    rows = lot_standing(registry(), lot_id).audited
    if not rows:
        return
    st.markdown(f"## {say('audit.units')}")
    table([_audited_row(row, unit) for row in rows[:MOST_ROWS]])
    for row in rows:
        if row.doubt is not None:
            _doubt(lot_id, row)


def _audited_row(row: UnitInLot, unit: str) -> dict[str, object]:
    say = words()
    return {
        say("column.serial"): row.serial,
        say("release.forecast"): number(row.forecast_rmse, unit),
        say("release.measured"): number(row.measured_rmse, unit),
        say("column.verdict"): say(f"verdict.{row.verdict or 'none'}"),
        say("audit.brought"): instant(row.audited_at),
    }


def _doubt(lot_id: str, row: UnitInLot) -> None:
    say = words()
    with st.container(border=True):
        st.warning(said(row.doubt, say) if row.doubt else "", title=row.serial, icon=":material/rule:")
        reason = ask_reason(f"confirm-{row.serial}", say("audit.confirm", serial=row.serial), "release")
    if reason is not None:
        confirm(registry(), lot_id, row.serial, reason=reason, actor=actor())
        st.rerun()
