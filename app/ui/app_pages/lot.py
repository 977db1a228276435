"""The lot at a glance: yields, errors, the process behind them, the units that need a look, the table."""

from datetime import UTC, datetime

import streamlit as st

from softcal.app.charts import lot as charts_lot
from softcal.app.charts.audited import error_over_load, estimate_over_reference
from softcal.app.ui.account import allows
from softcal.app.ui.components.job_panel import begin_job, is_running, job_panel, newest_job
from softcal.app.ui.components.lot_parts import (
    capability_panel,
    chosen_lot_view,
    control_panel,
    looks,
    reasons_panel,
    yield_panel,
)
from softcal.app.ui.components.unit_table import unit_table
from softcal.app.ui.desk import colours, empty, language, registry, say, zone
from softcal.app.ui.first_paint import rest_may_follow
from softcal.app.ui.panels import download, figure_under, figures_beside, for_lot, headline, numbers
from softcal.app.views.alerts import alerts
from softcal.app.views.audited import AuditedView, audited_view
from softcal.app.views.common import number, percent
from softcal.app.views.lot import LotView


@for_lot("lot")
def render(lot_id: str) -> None:
    first = st.container()
    calibrate_again(lot_id)
    view = chosen_lot_view(lot_id)
    if not view.judged:
        empty("empty.units")
        return
    with first:
        share = view.yields.first_pass
        headline(say("lot.headline", share=percent(share.value), good=share.count, of=share.of))
    for alert in alerts(registry(), view, datetime.now(UTC).astimezone(zone())):
        draw, icon = (st.error, "report") if alert.is_urgent else (st.warning, "notifications")
        draw(say(f"alert.{alert.kind}", **alert.values), icon=f":material/{icon}:")
    _numbers(view)
    if not rest_may_follow():
        return
    _figures(view)
    if view.audited:
        _audited(view)
    looks(view)
    st.header(say("lot.table"))
    unit_table(view.lot, view.chosen)
    exported = ("lots", lot_id, {"file": "report.pdf"})
    name, icon = f"{lot_id}-report.pdf", "picture_as_pdf"
    download(say("lot.report"), name, lambda: _report_pdf(view), "lot-report", exported=exported, icon=icon)


def _numbers(view: LotView) -> None:
    unit = view.lot.reference_unit
    ratio = view.after_to_own
    audited = (say("lot.audited"), str(len(view.audited)), say("lot.audited.help"))
    compared = (say("lot.ratio"), number(ratio), say("lot.ratio.help", count=len(view.audited)))
    shares = []
    for name, share in (("first_pass", view.yields.first_pass), ("yield", view.yields.last_pass)):
        low, high = map(percent, share.interval)
        shares.append((say(f"lot.{name}"), percent(share.value), say(f"lot.{name}.help", low=low, high=high)))
    # A sentence would be cut off in a tile.
    limit = say("lot.limit.short" if view.limit is not None and not view.limit.is_stated else "lot.limit")
    numbers(
        (
            (say("lot.units"), f"{view.judged} / {view.total}", say("lot.units.help")),
            *shares,
            (say("lot.predicted"), number(view.median_predicted, unit), say("lot.predicted.help")),
            (limit, number(view.limit_rmse, unit), say("lot.limit.help")),
            audited if ratio is None else compared,
        )
    )
    st.progress(view.judged / view.total, text=say("lot.progress", done=view.judged, total=view.total))


def _figures(view: LotView) -> None:
    """Draw errors and scores side by side, the control chart below, then why units failed beside the capability."""
    left, right = st.columns(2)
    with left:
        figure_under("lot.distribution", charts_lot.predicted_errors(view, colours(), say), "predicted")
    with right:
        if view.audited:
            figure_under("lot.scores", charts_lot.audit_scores(view, colours(), say), "scores")
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


def _report_pdf(view: LotView) -> bytes:
    from softcal.app.ui.lot_report_pdf import lot_report_pdf

    return lot_report_pdf(registry(), view, language(), datetime.now(UTC).astimezone(zone()))


def _audited(view: LotView) -> None:
    """Draw the audited units of a lot; nothing where none was audited."""
    marker = registry().pages.change_marker(view.lot.id)
    found = _audited_view(str(registry().database.name), marker, view.lot.id, view.chosen, view)
    if found is None:
        return
    figures_beside(
        ("lot.audited.estimate", estimate_over_reference(found, colours(), say), "audited-estimate"),
        ("lot.audited.load", error_over_load(found, colours(), say), "audited-load"),
    )
    st.caption(say("lot.audited.count", shown=len(found.units), of=found.of))


@st.cache_resource(max_entries=8, show_spinner=False)
def _audited_view(
    registry_name: str, marker: str, lot_id: str, chosen: tuple[str, ...] | None, _lot: LotView
) -> AuditedView | None:
    return audited_view(registry(), _lot.lot, _lot.audited, _lot.limit_rmse)


SEEN = "calibrate-seen"


def calibrate_again(lot_id: str) -> None:
    """Draw the button for whom the role allows it, and how far a calibration of the lot is for everybody."""
    job = newest_job("calibrate", lot=lot_id)
    has_source = bool(registry().recordings.of_lot(lot_id, kind="source"))
    if allows("set_up") and has_source and not is_running(job):
        if st.button(say("lot.again"), icon=":material/replay:", help=say("lot.again.help"), key="calibrate-again"):
            st.session_state[SEEN] = begin_job("calibrate", lot=lot_id)
            st.rerun()
    if job is None or (not is_running(job) and st.session_state.get(SEEN) != job.job_id):
        return
    st.session_state[SEEN] = job.job_id
    if job_panel(job):
        st.success(say("lot.again.done", new=job.result["new"], known=job.result["known"]), icon=":material/check:")
