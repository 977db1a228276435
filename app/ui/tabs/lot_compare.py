"""This lot beside others: their numbers, and the errors of their units in one picture."""

import streamlit as st

from softcal.app.charts.compare import errors_of_lots
from softcal.app.ui.panels import figure_under, rest_may_follow, table
from softcal.app.ui.presentation import colours, translate
from softcal.app.ui.server_cache import cached_lot_view, registry
from softcal.app.views.lot_report import MAX_LOTS, lot_rows


def draw_compare(lot_id: str) -> None:
    others = [lot for lot in registry().lots.ids() if lot != lot_id]
    requested = [lot for lot in st.query_params.get_all("with") if lot in others]
    chosen = st.multiselect(
        translate("compare.lots"),
        others,
        requested or others[-1:],
        max_selections=MAX_LOTS - 1,
        key=f"compare-lots-{lot_id}",
        placeholder=translate("choose.some"),
    )
    views = [cached_lot_view(lot) for lot in (lot_id, *chosen)]
    table(lot_rows(views, translate))
    # One lot alone has its histogram on its first tab.
    if chosen and rest_may_follow():
        figure_under("lot.distribution", errors_of_lots(views, colours(), translate), "compare-errors")
