"""The lot on one screen: what is next, its numbers, and the errors of its units."""

from datetime import UTC, datetime

import streamlit as st

from softcal.app.calibration.lot_decision import decision_in_force
from softcal.app.charts import lot as charts_lot
from softcal.app.registry.same_recordings import same_recordings_of
from softcal.app.ui.account import allows
from softcal.app.ui.actions import download
from softcal.app.ui.components.job_panel import begin_job, is_running, job_panel, newest_job
from softcal.app.ui.panels import go_to, headline, numbers, rest_may_follow, show_figure
from softcal.app.ui.presentation import colours, current_translator, language, localize, translate, zone
from softcal.app.ui.server_cache import cached_lot_view, cached_next_step, registry
from softcal.app.views.alerts import alerts
from softcal.app.views.common import limit_number, number, percent
from softcal.app.views.lot import LotView
from softcal.app.views.lot_runs import FROM_FILE, LotFilter

JOB_KEY = "calibrate-seen"
HEIGHT = 180
"""Of the histogram, so that the whole stands on a screen of 800 px."""


def draw_overview(lot_id: str) -> None:
    view = cached_lot_view(lot_id, LotFilter(zone=zone()))
    _next(lot_id)
    if view.decided:
        current_alerts = alerts(registry(), view, datetime.now(UTC).astimezone(zone()))
        sources = decision_in_force(registry(), lot_id).fit.sources
        remarks = [localize(remark) for remark in (*same_recordings_of(registry(), lot_id), *sources)]
        urgent = [translate(f"alert.{one.kind}", **one.values) for one in current_alerts if one.is_urgent]
        others = [translate(f"alert.{one.kind}", **one.values) for one in current_alerts if not one.is_urgent] + remarks
        for lines, announce, icon in ((urgent, st.error, "report"), (others, st.warning, "notifications")):
            if lines:
                announce("  \n".join(lines), icon=f":material/{icon}:")
        _tiles(view)
    if not view.decided or not rest_may_follow():
        _calibrate(lot_id)
        return

    def report() -> bytes:
        from softcal.app.ui.lot_report_pdf import lot_report_pdf  # noqa: PLC0415

        return lot_report_pdf(registry(), view, language(), datetime.now(UTC).astimezone(zone()))

    exported = ("lots", (lot_id,), {"file": "report.pdf"})
    name, icon = f"{lot_id}-report.pdf", "picture_as_pdf"
    with st.container(horizontal=True, vertical_alignment="center"):
        st.header(translate("lot.distribution"), width="stretch")
        download(translate("lot.report"), name, report, "lot-report", exported=exported, icon=icon)
        _calibrate(lot_id)
    show_figure(charts_lot.predicted_errors(view, colours(), translate).update_layout(height=HEIGHT), "predicted")


def _next(lot_id: str) -> None:
    """Draw the next step and the way to it."""
    step = cached_next_step(lot_id)
    with st.container(border=True, horizontal=True, horizontal_alignment="distribute", vertical_alignment="center"):
        with st.container(width="stretch"):
            headline(f"**{translate('next')}** · {step.render(current_translator())}")
        if step.kind == "source":
            if st.button(translate("next.open.rig"), icon=":material/arrow_forward:", key="next-step"):
                go_to("lots", tab="rig", lot=lot_id)
        elif step.tab and st.button(translate(f"tab.{step.tab}"), icon=":material/arrow_forward:", key="next-step"):
            go_to("lot", lot=lot_id, tab=step.tab)


def _tiles(view: LotView) -> None:
    unit, ratio = view.lot.reference_unit, view.after_to_own
    scored = (translate("lot.audited"), str(len(view.audited)), translate("lot.audited.help"))
    compared = (translate("lot.ratio"), number(ratio), translate("lot.ratio.help", count=len(view.audited)))
    shares, of_files = [], all(station.name == FROM_FILE for station in view.stations)
    for name, share in (("first_pass", view.yields.first_pass), ("yield", view.yields.last_pass)):
        # Files are brought once: their first pass is the yield.
        if of_files and name == "first_pass":
            continue
        low, high = map(percent, share.interval)
        shares.append(
            (translate(f"lot.{name}"), percent(share.value), translate(f"lot.{name}.help", low=low, high=high))
        )
    # A sentence would be cut off in a tile.
    limit = translate("lot.limit.short" if view.limit is not None and not view.limit.is_stated else "lot.limit")
    maximum = None if view.limit is None else view.limit.maximum_rmse
    numbers(
        (
            (translate("lot.units"), f"{view.decided} / {view.total}", translate("lot.units.help")),
            *shares,
            (
                translate("lot.predicted"),
                number(view.median_predicted, unit, view.limit_rmse),
                translate("lot.predicted.help"),
            ),
            (limit, limit_number(maximum, unit), translate("lot.limit.help")),
            scored if ratio is None else compared,
        )
    )


def _calibrate(lot_id: str) -> None:
    """Draw the button that calibrates the lot's recordings, and the calibration under way."""
    job = newest_job("calibrate", lot=lot_id)
    has_source = bool(registry().recordings.of_lot(lot_id, kind="source"))
    if allows("set_up") and has_source and not is_running(job):
        if st.button(
            translate("lot.again"), icon=":material/replay:", help=translate("lot.again.help"), key="calibrate-again"
        ):
            st.session_state[JOB_KEY] = begin_job("calibrate", lot=lot_id)
            st.rerun()
    if job is not None and (is_running(job) or st.session_state.get(JOB_KEY) == job.job_id):
        st.session_state[JOB_KEY] = job.job_id
        if job_panel(job):
            st.success(
                translate("lot.again.done", new=job.result["new"], known=job.result["known"]), icon=":material/check:"
            )
