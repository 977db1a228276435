"""The lot at a glance: yields, errors, the process, the units that need a look, the table."""

from datetime import UTC, datetime

import streamlit as st

from softcal.app.charts import lot as charts_lot
from softcal.app.charts import unit as charts_unit
from softcal.app.charts.audited import error_over_load, estimate_over_reference
from softcal.app.charts.lot import yield_figure
from softcal.app.registry.same_recordings import same_recordings_of
from softcal.app.texts.reasons import said
from softcal.app.ui.account import allows
from softcal.app.ui.actions import download
from softcal.app.ui.components.job_panel import begin_job, is_running, job_panel, newest_job
from softcal.app.ui.components.unit_table import unit_table
from softcal.app.ui.desk import colours, empty, errors_in_words, in_words, language, say, zone
from softcal.app.ui.panels import (
    figure_under,
    figures_beside,
    for_lot,
    go_to,
    headline,
    numbers,
    rest_may_follow,
    show_figure,
    table_to_choose,
)
from softcal.app.ui.server_memory import registry, remembered_lot_view
from softcal.app.views.alerts import alerts
from softcal.app.views.audited import AuditedView, audited_view
from softcal.app.views.common import number, percent
from softcal.app.views.lot import LotView
from softcal.app.views.lot_runs import DESK, LotFilter
from softcal.app.views.unit import unit_view
from softcal.core.lot import UnitKey

SEEN = "calibrate-seen"
ARROW = ":material/arrow_forward:"


@for_lot("lot")
def render(lot_id: str) -> None:
    first = st.container()
    job = newest_job("calibrate", lot=lot_id)
    has_source = bool(registry().recordings.of_lot(lot_id, kind="source"))
    if allows("set_up") and has_source and not is_running(job):
        if st.button(say("lot.again"), icon=":material/replay:", help=say("lot.again.help"), key="calibrate-again"):
            st.session_state[SEEN] = begin_job("calibrate", lot=lot_id)
            st.rerun()
    if job is not None and (is_running(job) or st.session_state.get(SEEN) == job.job_id):
        st.session_state[SEEN] = job.job_id
        if job_panel(job):
            st.success(say("lot.again.done", new=job.result["new"], known=job.result["known"]), icon=":material/check:")

    view = _chosen_view(lot_id)
    if not view.judged:
        empty("empty.units")
        return
    with first:
        share = view.yields.first_pass
        headline(say("lot.headline", share=percent(share.value), good=share.count, of=share.of))
    for alert in alerts(registry(), view, datetime.now(UTC).astimezone(zone())):
        draw, icon = (st.error, "report") if alert.is_urgent else (st.warning, "notifications")
        draw(say(f"alert.{alert.kind}", **alert.values), icon=f":material/{icon}:")
    for remark in same_recordings_of(registry(), lot_id):
        st.warning(in_words(remark), icon=":material/warning:")
    unit, ratio = view.lot.reference_unit, view.after_to_own
    scored = (say("lot.audited"), str(len(view.audited)), say("lot.audited.help"))
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
            scored if ratio is None else compared,
        )
    )
    st.progress(view.judged / view.total, text=say("lot.progress", done=view.judged, total=view.total))
    if not rest_may_follow():
        return
    _figures(view)
    if view.audited:
        marker = registry().pages.change_marker(lot_id)
        audited = _audited_view(str(registry().database.name), marker, lot_id, view.chosen, view)
        if audited is not None:
            figures_beside(
                ("lot.audited.estimate", estimate_over_reference(audited, colours(), say), "audited-estimate"),
                ("lot.audited.load", error_over_load(audited, colours(), say), "audited-load"),
            )
            st.caption(say("lot.audited.count", shown=len(audited.units), of=audited.of))
    st.header(say("lot.look"))
    if view.looks:
        if view.needing_a_look > len(view.looks):
            st.caption(say("lot.look.count", shown=len(view.looks), count=view.needing_a_look))
        _looks(view)
    else:
        st.caption(say("lot.look.none"))
        if view.worst and st.button(say("lot.look.worst", serial=view.worst), key="open-worst", icon=ARROW):
            go_to("unit", unit=str(UnitKey(lot_id, view.worst)))
    st.header(say("lot.table"))
    unit_table(view.lot, view.chosen)

    def report() -> bytes:
        from softcal.app.ui.lot_report_pdf import lot_report_pdf

        return lot_report_pdf(registry(), view, language(), datetime.now(UTC).astimezone(zone()))

    exported = ("lots", (lot_id,), {"file": "report.pdf"})
    name, icon = f"{lot_id}-report.pdf", "picture_as_pdf"
    download(say("lot.report"), name, report, "lot-report", exported=exported, icon=icon)


def _chosen_view(lot_id: str) -> LotView:
    """Draw the choice of days, stations and operators; return what it leaves of a lot."""
    every = remembered_lot_view(lot_id, LotFilter(zone=zone()))
    if not every.judged:
        return every
    with st.popover(say("lot.filter"), icon=":material/filter_alt:"):
        first, second = st.columns(2)
        since = first.date_input(say("trail.since"), value=None, key=f"lot-since-{lot_id}")
        until = second.date_input(say("trail.until"), value=None, key=f"lot-until-{lot_id}")
        stations, operators = (
            st.multiselect(
                say(f"lot.filter.{kind}"),
                known,
                format_func=lambda name: say("lot.yield.desk") if name == DESK else name,
                key=f"lot-{kind}-{lot_id}",
                placeholder=say("choose.all"),
            )
            for kind, known in (("station", every.every_station), ("operator", every.every_operator))
        )
    wanted = LotFilter(since, until, tuple(stations), tuple(operators), zone())
    if wanted.is_open:
        return every
    view = remembered_lot_view(lot_id, wanted)
    st.caption(f":material/filter_alt: {say('lot.filter.on', left=len(view.chosen or ()), of=every.judged)}")
    return view if view.judged else every


def _figures(view: LotView) -> None:
    """Draw errors beside scores, yields, the control chart, and why units failed beside the capability."""
    left, right = st.columns(2)
    with left:
        figure_under("lot.distribution", charts_lot.predicted_errors(view, colours(), say), "predicted")
    with right:
        if view.audited:
            figure_under("lot.scores", charts_lot.audit_scores(view, colours(), say), "scores")
        elif view.reasons:
            figure_under("lot.reasons", charts_lot.reasons_pareto(view, colours(), say), "reasons")
    places = [("days", view.days), ("stations", view.stations)]
    if len(view.operators) > 1:
        places.append(("operators", view.operators))
    yields = ((name, yield_figure(found, say(f"lot.yield.{name}.axis"), colours(), say)) for name, found in places)
    figures_beside(*((f"lot.yield.{name}", figure, f"yield-{name}") for name, figure in yields))
    process = view.process
    if process.chart is None:
        st.header(say("lot.process"))
        st.caption(in_words(process.refusal or ""))
    else:
        figure = charts_lot.control_chart_figure(process, view.lot.reference_unit, colours(), say)
        figure_under("lot.process", figure, "control-chart")
    left, right = st.columns(2)
    with right:
        if view.audited and view.reasons:
            figure_under("lot.reasons", charts_lot.reasons_pareto(view, colours(), say), "reasons")
    if process.chart is None:
        return
    with left:
        st.header(say("lot.capability"))
        capability = process.capability
        if view.limit is None or not view.limit.is_stated:
            st.caption(say("lot.capability.no_limit"))
        elif capability is None:
            st.warning(in_words(process.refusal or ""), icon=":material/block:", title=say("lot.capability.refused"))
        else:
            interval = say("lot.cpk.help", low=number(capability.cpk_lower), high=number(capability.cpk_upper))
            numbers((("Cpk", number(capability.cpk), interval), ("Ppk", number(capability.ppk), say("lot.ppk.help"))))
            st.caption(say("lot.cp.none"))
        st.markdown(f"**{say('lot.rules')}**")
        if not process.broken:
            st.caption(say("lot.rules.none"))
        for broken in process.broken:
            mark = ":material/warning:" if broken.forbids else ":material/info:"
            rule = say(f"rule.{broken.rule}")
            st.markdown(f"{mark} {say('lot.rules.line', rule=rule, count=broken.count, last=broken.last)}")


@st.cache_resource(max_entries=8, show_spinner=False)
def _audited_view(
    registry_name: str, marker: str, lot_id: str, chosen: tuple[str, ...] | None, _lot: LotView
) -> AuditedView | None:
    return audited_view(registry(), _lot.lot, _lot.audited, _lot.limit_rmse)


@st.fragment
@errors_in_words()
def _looks(view: LotView) -> None:
    """Draw the worst units and the plot of the one that is chosen, the worst at first."""
    rows = [
        {
            say("column.serial"): unit.serial,
            say("column.verdict"): say(f"verdict.{unit.verdict}"),
            say("column.reasons"): in_words(unit.reasons[:1]),
            say("column.predicted"): number(unit.predicted_rmse, view.lot.reference_unit),
        }
        for unit in view.looks
    ]
    left, right = st.columns([3, 2])
    with left:
        unit = view.looks[table_to_choose(rows, f"looks-{view.lot.id}") or 0]
    with right:
        # What does not fit beside the name goes below it; a label is never cut.
        with st.container(horizontal=True, horizontal_alignment="distribute", vertical_alignment="center"):
            st.markdown(f"**{unit.serial}** · {say(f'verdict.{unit.verdict}')}", width="content")
            is_chosen = st.button(say("lot.look.open"), key="open-look", icon=ARROW)
        if is_chosen:
            go_to("unit", unit=str(unit.key))
        if unit.reasons:
            # The table has room for its beginning alone.
            st.caption(said(unit.reasons[0], say))
        if unit.revision is None:
            st.caption(say("empty.calibration"))
            return
        figure = charts_unit.output_distributions(unit_view(registry(), unit.key), colours(), say)
        show_figure(figure, f"look-{unit.key}")
