"""What somebody should look at now, as bars above a lot."""

from datetime import UTC, datetime

import streamlit as st

from softcal.app.ui.desk import registry, words
from softcal.app.views.alerts import alerts
from softcal.app.views.lot import LotView


def alerts_panel(view: LotView) -> None:
    """Draw what should be looked at now, the urgent first."""
    say = words()
    for alert in alerts(registry(), view, datetime.now(UTC)):
        draw, icon = (st.error, "report") if alert.is_urgent else (st.warning, "notifications")
        draw(say(f"alert.{alert.kind}", **alert.values), icon=f":material/{icon}:")
