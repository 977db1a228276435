"""The lot at a glance: yields, errors, the process behind them, the units that need a look, the table."""

import streamlit as st

from softcal.app.charts import lot as charts_lot
from softcal.app.ui.components.alerts_panel import alerts_panel
from softcal.app.ui.components.audited_panel import audited_panel
from softcal.app.ui.components.calibrate_again import calibrate_again
from softcal.app.ui.components.looks import looks
from softcal.app.ui.components.lot_filter import chosen_lot_view
from softcal.app.ui.components.lot_report import lot_report
from softcal.app.ui.components.process_panel import capability_panel, control_panel, reasons_panel, yield_panel
from softcal.app.ui.components.unit_table import unit_table
from softcal.app.ui.desk import colours, empty, errors_in_words, registry, words
from softcal.app.ui.first_paint import rest_may_follow
from softcal.app.ui.panels import figure_under, headline, lot_heading, numbers
from softcal.app.views.common import number, percent
from softcal.app.views.lot import LotView


def render() -> None:
    """Draw the page."""
    say = words()
    with errors_in_words():
        lot_id = lot_heading("lot", registry().lot_ids())
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
