"""Parts of the page of a lot: the process behind it with its control chart, units that need a look, what is shown."""

from datetime import date

import streamlit as st

from softcal.app.charts import lot as charts_lot
from softcal.app.charts import unit as charts_unit
from softcal.app.charts.lot import yield_figure
from softcal.app.texts.reasons import said
from softcal.app.ui.desk import colours, errors_in_words, in_words, registry, say, show_figure, zone
from softcal.app.ui.panels import figure_under, go_to, numbers, table_to_choose
from softcal.app.ui.server_memory import remembered_lot_view
from softcal.app.views.common import number
from softcal.app.views.lot import LotView, ProcessView
from softcal.app.views.lot_runs import DESK, LotFilter
from softcal.app.views.unit import unit_view
from softcal.core.lot import Lot
from softcal.db.entries import UnitEntry


def control_panel(process: ProcessView, lot: Lot) -> None:
    """Draw the control chart, or why there is none."""
    if process.chart is None:
        st.header(say("lot.process"))
        st.caption(in_words(process.refusal or ""))
        return
    figure = charts_lot.control_chart_figure(process, lot.reference_unit, colours(), say)
    figure_under("lot.process", figure, "control-chart")


def capability_panel(view: LotView) -> None:
    """Draw capability against the limit, or why it is refused, and the rules that points break."""
    process = view.process
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
        figure_under("lot.reasons", charts_lot.reasons_pareto(view, colours(), say), "reasons")


def yield_panel(view: LotView) -> None:
    """Draw the first-pass yield over days beside that over stations, and over operators where there are several."""
    places = [("days", view.days), ("stations", view.stations)]
    if len(view.operators) > 1:
        places.append(("operators", view.operators))
    for column, (name, found) in zip(st.columns(len(places)), places, strict=True):
        with column:
            figure = yield_figure(found, say(f"lot.yield.{name}.axis"), colours(), say)
            figure_under(f"lot.yield.{name}", figure, f"yield-{name}")


def _rules(process: ProcessView) -> None:
    st.markdown(f"**{say('lot.rules')}**")
    if not process.broken:
        st.caption(say("lot.rules.none"))
    for broken in process.broken:
        mark = ":material/warning:" if broken.forbids else ":material/info:"
        rule = say(f"rule.{broken.rule}")
        st.markdown(f"{mark} {say('lot.rules.line', rule=rule, count=broken.count, last=broken.last)}")


ARROW = ":material/arrow_forward:"


def looks(view: LotView) -> None:
    """Draw the worst units and the plot of the one that is chosen, the worst at first."""
    st.header(say("lot.look"))
    if not view.looks:
        st.caption(say("lot.look.none"))
        if view.worst and st.button(say("lot.look.worst", serial=view.worst), key="open-worst", icon=ARROW):
            go_to("unit", unit=view.worst)
        return
    if view.needing_a_look > len(view.looks):
        st.caption(say("lot.look.count", shown=len(view.looks), count=view.needing_a_look))
    _chosen(view)


@st.fragment
@errors_in_words()
def _chosen(view: LotView) -> None:
    left, right = st.columns([3, 2])
    with left:
        rows = [_row(unit, view.lot.reference_unit) for unit in view.looks]
        chosen = table_to_choose(rows, f"looks-{view.lot.id}")
    with right:
        _plot(view.looks[chosen or 0])


def _row(unit: UnitEntry, reference_unit: str) -> dict[str, object]:
    return {
        say("column.serial"): unit.serial,
        say("column.verdict"): say(f"verdict.{unit.verdict}"),
        say("column.reasons"): said(unit.reasons[0], say) if unit.reasons else "",
        say("column.predicted"): number(unit.predicted_rmse, reference_unit),
    }


def _plot(unit: UnitEntry) -> None:
    # What does not fit beside the name goes below it; a label is never cut.
    with st.container(horizontal=True, horizontal_alignment="distribute", vertical_alignment="center"):
        st.markdown(f"**{unit.serial}** · {say(f'verdict.{unit.verdict}')}", width="content")
        is_chosen = st.button(say("lot.look.open"), key="open-look", icon=ARROW)
    if is_chosen:
        go_to("unit", unit=unit.serial)
    if unit.reasons:
        # The table has room for its beginning alone.
        st.caption(said(unit.reasons[0], say))
    if unit.revision is None:
        st.caption(say("empty.calibration"))
        return
    view = unit_view(registry(), unit.serial)
    show_figure(charts_unit.output_distributions(view, colours(), say), f"look-{unit.serial}")


def chosen_lot_view(lot_id: str) -> LotView:
    """Draw the choice of days, stations and operators; return what it leaves of a lot."""
    every = remembered_lot_view(lot_id, LotFilter(zone=zone()))
    if not every.judged:
        return every
    with st.popover(say("lot.filter"), icon=":material/filter_alt:"):
        first, second = st.columns(2)
        since = _day(first.date_input(say("trail.since"), value=None, key=f"lot-since-{lot_id}"))
        until = _day(second.date_input(say("trail.until"), value=None, key=f"lot-until-{lot_id}"))
        stations = _names("station", every.every_station, lot_id)
        operators = _names("operator", every.every_operator, lot_id)
    wanted = LotFilter(since, until, stations, operators, zone())
    if wanted.is_open:
        return every
    view = remembered_lot_view(lot_id, wanted)
    st.caption(f":material/filter_alt: {say('lot.filter.on', left=len(view.chosen or ()), of=every.judged)}")
    return view if view.judged else every


def _day(chosen: object) -> date | None:
    return chosen if isinstance(chosen, date) else None


def _names(kind: str, known: tuple[str, ...], lot_id: str) -> tuple[str, ...]:
    return tuple(
        st.multiselect(
            say(f"lot.filter.{kind}"),
            known,
            format_func=lambda name: say("lot.yield.desk") if name == DESK else name,
            key=f"lot-{kind}-{lot_id}",
            placeholder=say("choose.all"),
        )
    )
