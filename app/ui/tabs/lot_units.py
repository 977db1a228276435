"""The units of a lot: the table, and the process that made them."""

import streamlit as st

from softcal.app.charts import lot as charts_lot
from softcal.app.charts.lot import yield_figure
from softcal.app.ui.components.unit_table import unit_table
from softcal.app.ui.desk import colours, empty, in_words, say, zone
from softcal.app.ui.panels import figure_under, figures_beside, numbers, rest_may_follow
from softcal.app.ui.server_memory import remembered_lot_view
from softcal.app.views.common import number
from softcal.app.views.lot import LotView
from softcal.app.views.lot_runs import DESK, LotFilter


def draw_units(lot_id: str) -> None:
    view = _chosen_view(lot_id)
    if not view.judged:
        empty("empty.units")
        return
    unit_table(view.lot, view.chosen)
    if rest_may_follow():
        _process(view)


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


def _process(view: LotView) -> None:
    """Draw yields where there are several to compare, the control chart, and why units failed."""
    places = [(name, getattr(view, name)) for name in ("days", "stations", "operators")]
    yields = [
        (name, yield_figure(groups, say(f"lot.yield.{name}.axis"), colours(), say))
        for name, groups in places
        if len(groups) > 1
    ]
    if yields:
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
        if len(view.reasons) > 1:
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
