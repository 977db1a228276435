"""The audited units of a lot: estimate against reference beside the error over the load."""

import streamlit as st

from softcal.app.charts.audited import error_over_load, estimate_over_reference
from softcal.app.ui.desk import colours, registry, words
from softcal.app.ui.panels import figure_under
from softcal.app.views.audited import AuditedView, audited_view
from softcal.app.views.lot import LotView

LOTS = 8


def audited_panel(view: LotView) -> None:
    """Draw the audited units of a lot; nothing where none was audited."""
    found = _remembered(view) if view.audited else None
    if found is None:
        return
    say = words()
    left, right = st.columns(2)
    with left:
        figure_under("lot.audited.estimate", estimate_over_reference(found, colours(), say), "audited-estimate")
    with right:
        figure_under("lot.audited.load", error_over_load(found, colours(), say), "audited-load")
    st.caption(say("lot.audited.count", shown=len(found.units), of=found.of))


def _remembered(view: LotView) -> AuditedView | None:
    marker = registry().change_marker(view.lot.id)
    return _view(str(registry().database.name), marker, view.lot.id, view.chosen, view)


@st.cache_resource(max_entries=LOTS, show_spinner=False)
def _view(
    registry_name: str, marker: str, lot_id: str, chosen: tuple[str, ...] | None, _lot: LotView
) -> AuditedView | None:
    return audited_view(registry(), _lot.lot, _lot.audited, _lot.limit_rmse)
