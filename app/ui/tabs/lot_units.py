"""The units of a lot: the table, and the process that made them."""

import streamlit as st

from softcal.app.charts import lot as charts_lot
from softcal.app.charts.lot import yield_figure
from softcal.app.ui.components.unit_table import unit_table
from softcal.app.ui.panels import figure_under, numbers, rest_may_follow, show_figures
from softcal.app.ui.presentation import colours, empty, localize, translate, zone
from softcal.app.ui.server_cache import cached_lot_view
from softcal.app.views.common import number
from softcal.app.views.lot import LotView
from softcal.app.views.lot_runs import FROM_FILE, LotFilter


def draw_units(lot_id: str) -> None:
    view = _chosen_view(lot_id)
    if not view.decided:
        empty("empty.units")
        return
    unit_table(view.lot, view.chosen)
    if rest_may_follow():
        _process(view)


def _chosen_view(lot_id: str) -> LotView:
    """Draw the choice of days, stations and operators; return what it leaves of a lot."""
    every = cached_lot_view(lot_id, LotFilter(zone=zone()))
    if not every.decided:
        return every
    with st.popover(translate("lot.filter"), icon=":material/filter_alt:"):
        first, second = st.columns(2)
        since = first.date_input(translate("trail.since"), value=None, key=f"lot-since-{lot_id}")
        until = second.date_input(translate("trail.until"), value=None, key=f"lot-until-{lot_id}")
        stations, operators = (
            st.multiselect(
                translate(f"lot.filter.{kind}"),
                names,
                format_func=lambda name: translate("lot.yield.desk") if name == FROM_FILE else name,
                key=f"lot-{kind}-{lot_id}",
                placeholder=translate("choose.all"),
            )
            for kind, names in (("station", every.every_station), ("operator", every.every_operator))
        )
    lot_filter = LotFilter(since, until, tuple(stations), tuple(operators), zone())
    if lot_filter.is_open:
        return every
    view = cached_lot_view(lot_id, lot_filter)
    st.caption(f":material/filter_alt: {translate('lot.filter.on', left=len(view.chosen or ()), of=every.decided)}")
    return view if view.decided else every


def _process(view: LotView) -> None:
    """Draw yields where there are several to compare, the control chart, and why units failed."""
    groupings = [(name, getattr(view, name)) for name in ("days", "stations", "operators")]
    yields = [
        (name, yield_figure(groups, translate(f"lot.yield.{name}.axis"), colours(), translate))
        for name, groups in groupings
        if len(groups) > 1
    ]
    if yields:
        show_figures(*((f"lot.yield.{name}", figure, f"yield-{name}") for name, figure in yields))
    process = view.process
    if process.chart is None:
        st.header(translate("lot.process"))
        st.caption(localize(process.refusal or ""))
    else:
        figure = charts_lot.control_chart_figure(view, colours(), translate)
        figure_under("lot.process", figure, "control-chart")
    left, right = st.columns(2)
    with right:
        if len(view.reasons) > 1:
            figure_under("lot.reasons", charts_lot.reasons_pareto(view, colours(), translate), "reasons")
    if process.chart is None:
        return
    with left:
        st.header(translate("lot.capability"))
        capability = process.capability
        if view.limit is None or not view.limit.is_stated:
            st.caption(translate("lot.capability.no_limit"))
        elif capability is None:
            st.warning(
                localize(process.refusal or ""), icon=":material/block:", title=translate("lot.capability.refused")
            )
        else:
            interval = translate("lot.cpk.help", low=number(capability.cpk_lower), high=number(capability.cpk_upper))
            numbers(
                (("Cpk", number(capability.cpk), interval), ("Ppk", number(capability.ppk), translate("lot.ppk.help")))
            )
            st.caption(translate("lot.cp.none"))
        st.markdown(f"**{translate('lot.rules')}**")
        if not process.broken:
            st.caption(translate("lot.rules.none"))
        for broken in process.broken:
            mark = ":material/warning:" if broken.forbids else ":material/info:"
            rule = translate(f"rule.{broken.rule}")
            st.markdown(f"{mark} {translate('lot.rules.line', rule=rule, count=broken.count, last=broken.last)}")
