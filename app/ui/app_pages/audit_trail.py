"""The audit trail: who did what to what, when and why, newest first."""

import pandas as pd
import streamlit as st

from softcal.app.ui.desk import empty, errors_in_words, registry, words
from softcal.app.ui.panels import heading

NEWEST = 500


def render() -> None:
    """Draw the page."""
    say = words()
    with errors_in_words():
        heading("audit_trail")
        rows = registry().newest_audit_rows(NEWEST)
        if not rows:
            empty(say("audit.none"), say("empty.lots.how"))
            return
        table = [
            {
                say("column.made"): f"{row.at:%Y-%m-%d %H:%M:%S} UTC",
                say("column.actor"): row.actor,
                say("column.action"): row.action,
                say("column.entity"): f"{row.entity} {row.key}",
                say("column.reason"): row.reason,
            }
            for row in rows
        ]
        st.dataframe(pd.DataFrame(table), width="stretch", hide_index=True, height=640)
