"""The lot at a glance: yields, errors, the process behind them, the units that need a look, the table."""

from datetime import UTC, datetime

import streamlit as st

from softcal.app.charts import lot as charts_lot
from softcal.app.charts.audited import error_over_load, estimate_over_reference
from softcal.app.jobs.process import start_job
from softcal.app.ui.account import actor, permit, person
from softcal.app.ui.callbacks import in_one_piece
from softcal.app.ui.components.job_panel import job_panel, newest_job
from softcal.app.ui.components.lot_parts import (
    capability_panel,
    chosen_lot_view,
    control_panel,
    looks,
    reasons_panel,
    yield_panel,
)
from softcal.app.ui.components.unit_table import unit_table
from softcal.app.ui.desk import colours, empty, language, registry, words, zone
from softcal.app.ui.first_paint import rest_may_follow
from softcal.app.ui.panels import figure_under, headline, lot_heading, numbers
from softcal.app.views.alerts import alerts
from softcal.app.views.audited import AuditedView, audited_view
from softcal.app.views.common import number, percent
from softcal.app.views.lot import LotView
from softcal.core.orders import RunState
from softcal.db.access.people import may


def render() -> None:
    say = words()
    lot_id = lot_heading("lot", registry().lots.ids())
    if lot_id is None:
        return
    first = st.container()
    calibrate_again(lot_id)
    view = chosen_lot_view(lot_id)
    if not view.judged:
        empty(say("empty.units"), say("empty.units.how"))
        return
    with first:
        share = view.yields.first_pass
        headline(say("lot.headline", share=percent(share.value), good=share.count, of=share.of))
    alerts_panel(view)
    _numbers(view)
    if not rest_may_follow():
        return
    _figures(view)
    audited_panel(view)
    looks(view)
    st.header(say("lot.table"))
    unit_table(view.lot, view.chosen)
    lot_report(view)


def _numbers(view: LotView) -> None:
    say, unit = words(), view.lot.reference_unit
    first, last = view.yields.first_pass, view.yields.last_pass
    ratio = view.after_to_own
    audited = (say("lot.audited"), str(len(view.audited)), say("lot.audited.help"))
    compared = (say("lot.ratio"), number(ratio), say("lot.ratio.help", count=len(view.audited)))
    numbers(
        (
            (say("lot.units"), f"{view.judged} / {view.total}", say("lot.units.help")),
            (say("lot.first_pass"), percent(first.value), _interval("lot.first_pass.help", first.interval)),
            (say("lot.yield"), percent(last.value), _interval("lot.yield.help", last.interval)),
            (say("lot.predicted"), number(view.median_predicted, unit), say("lot.predicted.help")),
            (*_limit(view), say("lot.limit.help")),
            audited if ratio is None else compared,
        )
    )
    st.progress(view.judged / view.total, text=say("lot.progress", done=view.judged, total=view.total))


def _limit(view: LotView) -> tuple[str, str]:
    """Return the label and the number of the limit; a sentence would be cut off in a tile."""
    say, limit = words(), view.limit
    is_derived = limit is not None and not limit.is_stated
    return say("lot.limit.short" if is_derived else "lot.limit"), number(view.limit_rmse, view.lot.reference_unit)


def _interval(key: str, interval: tuple[float, float]) -> str:
    low, high = interval
    return words()(key, low=percent(low), high=percent(high))


def _figures(view: LotView) -> None:
    """Draw errors and scores side by side, the control chart below, then why units failed beside the capability."""
    left, right = st.columns(2)
    with left:
        figure_under("lot.distribution", charts_lot.predicted_errors(view, colours(), words()), "predicted")
    with right:
        if view.audited:
            figure_under("lot.scores", charts_lot.audit_scores(view, colours(), words()), "scores")
        else:
            reasons_panel(view)
    yield_panel(view)
    control_panel(view.process, view.lot)
    left, right = st.columns(2)
    with left:
        capability_panel(view)
    with right:
        if view.audited:
            reasons_panel(view)


def alerts_panel(view: LotView) -> None:
    """Draw what should be looked at now, the urgent first."""
    say = words()
    for alert in alerts(registry(), view, datetime.now(UTC).astimezone(zone())):
        draw, icon = (st.error, "report") if alert.is_urgent else (st.warning, "notifications")
        draw(say(f"alert.{alert.kind}", **alert.values), icon=f":material/{icon}:")


def lot_report(view: LotView) -> None:
    """Offer the report; its bytes are made when somebody takes them."""
    st.download_button(
        words()("lot.report"),
        data=lambda: _report_pdf(view),
        file_name=f"{view.lot.id}-report.pdf",
        mime="application/pdf",
        icon=":material/picture_as_pdf:",
        key="lot-report",
        on_click=_tell_of_report,
        args=(view.lot.id,),
    )


def _report_pdf(view: LotView) -> bytes:
    from softcal.app.ui.lot_report_pdf import lot_report_pdf

    return lot_report_pdf(registry(), view, language(), datetime.now(UTC).astimezone(zone()))


@in_one_piece
def _tell_of_report(lot_id: str) -> None:
    registry().trail.add("export", "lots", (lot_id,), {"file": "report.pdf"}, actor=actor())


LOTS = 8


def audited_panel(view: LotView) -> None:
    """Draw the audited units of a lot; nothing where none was audited."""
    found = _remembered_audits(view) if view.audited else None
    if found is None:
        return
    say = words()
    left, right = st.columns(2)
    with left:
        figure_under("lot.audited.estimate", estimate_over_reference(found, colours(), say), "audited-estimate")
    with right:
        figure_under("lot.audited.load", error_over_load(found, colours(), say), "audited-load")
    st.caption(say("lot.audited.count", shown=len(found.units), of=found.of))


def _remembered_audits(view: LotView) -> AuditedView | None:
    marker = registry().pages.change_marker(view.lot.id)
    return _audited_view(str(registry().database.name), marker, view.lot.id, view.chosen, view)


@st.cache_resource(max_entries=LOTS, show_spinner=False)
def _audited_view(
    registry_name: str, marker: str, lot_id: str, chosen: tuple[str, ...] | None, _lot: LotView
) -> AuditedView | None:
    return audited_view(registry(), _lot.lot, _lot.audited, _lot.limit_rmse)


SEEN = "calibrate-seen"


def calibrate_again(lot_id: str) -> None:
    """Draw the button for whom the role allows it, and how far a calibration of the lot is for everybody."""
    say = words()
    job = newest_job("calibrate", lot=lot_id)
    is_busy = job is not None and job.state.is_active
    has_source = bool(registry().recordings.of_lot(lot_id, kind="source"))
    if may(person(), "set_up") and has_source and not is_busy:
        if st.button(say("lot.again"), icon=":material/replay:", help=say("lot.again.help"), key="calibrate-again"):
            permit("set_up")
            st.session_state[SEEN] = start_job(registry(), "calibrate", {"lot": lot_id}, actor())
            st.rerun()
    if job is None or (not is_busy and st.session_state.get(SEEN) != job.job_id):
        return
    st.session_state[SEEN] = job.job_id
    if job_panel(job) and job.state is RunState.DONE:
        st.success(say("lot.again.done", new=job.result["new"], known=job.result["known"]), icon=":material/check:")
