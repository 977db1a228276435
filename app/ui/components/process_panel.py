"""The process behind a lot: its control chart with the rules in words, its capability, and why units did not pass."""

import streamlit as st

from softcal.app.charts import lot as charts_lot
from softcal.app.charts.lot import yield_figure
from softcal.app.ui.desk import colours, in_words, words
from softcal.app.ui.panels import figure_under, numbers
from softcal.app.views.common import number
from softcal.app.views.lot import LotView, ProcessView
from softcal.core.lot import Lot


def control_panel(process: ProcessView, lot: Lot) -> None:
    """Draw the control chart, or why there is none."""
    if process.chart is None:
        st.header(words()("lot.process"))
        st.caption(in_words(process.refusal or ""))
        return
    figure = charts_lot.control_chart_figure(process, lot.reference_unit, colours(), words())
    figure_under("lot.process", figure, "control-chart")


def capability_panel(view: LotView) -> None:
    """Draw capability against the limit, or why it is refused, and the rules that points break."""
    say, process = words(), view.process
    found = process.capability
    if process.chart is None:
        return
    st.header(say("lot.capability"))
    if view.limit is None or not view.limit.is_stated:
        st.caption(say("lot.capability.no_limit"))
    elif found is None:
        st.warning(in_words(process.refusal or ""), icon=":material/block:", title=say("lot.capability.refused"))
    else:
        interval = say("lot.cpk.help", low=number(found.cpk_lower), high=number(found.cpk_upper))
        numbers((("Cpk", number(found.cpk), interval), ("Ppk", number(found.ppk), say("lot.ppk.help"))))
        st.caption(say("lot.cp.none"))
    _rules(process)


def reasons_panel(view: LotView) -> None:
    """Draw why units did not pass, the most frequent reason first."""
    if view.reasons:
        figure_under("lot.reasons", charts_lot.reasons_pareto(view, colours(), words()), "reasons")


def yield_panel(view: LotView) -> None:
    """Draw the first-pass yield over days beside that over stations, and over operators where there are several."""
    say = words()
    places = [("days", view.days), ("stations", view.stations)]
    if len(view.operators) > 1:
        places.append(("operators", view.operators))
    for column, (name, found) in zip(st.columns(len(places)), places, strict=True):
        with column:
            figure = yield_figure(found, say(f"lot.yield.{name}.axis"), colours(), say)
            figure_under(f"lot.yield.{name}", figure, f"yield-{name}")


def _rules(process: ProcessView) -> None:
    say = words()
    st.markdown(f"**{say('lot.rules')}**")
    if not process.broken:
        st.caption(say("lot.rules.none"))
    for broken in process.broken:
        mark = ":material/warning:" if broken.forbids else ":material/info:"
        rule = say(f"rule.{broken.rule}")
        st.markdown(f"{mark} {say('lot.rules.line', rule=rule, count=broken.count, last=broken.last)}")
