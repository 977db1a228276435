"""Why the verdict of a unit is what it is: what was measured first, else what the forecast is made of."""

import streamlit as st

from softcal.app.charts.why import HEIGHT, why_figure
from softcal.app.ui.desk import colours, in_words, say
from softcal.app.ui.panels import figure_under, rest_may_follow
from softcal.app.ui.server_memory import registry
from softcal.app.views.unit import unit_view
from softcal.core.lot import UnitKey
from softcal.db.entries import StoredCalibration


def draw(key: UnitKey, stored: StoredCalibration) -> None:
    for reason in stored.state.decision.reasons:
        st.markdown(f"- {in_words(reason)}")
    if not rest_may_follow():
        return
    view = unit_view(registry(), key, stored.revision)
    figure = why_figure(view, colours(), say)
    figure.update_layout(title=None, margin_t=36, height=HEIGHT if view.audit else HEIGHT // 2)
    figure_under("unit.why", figure, "why")
