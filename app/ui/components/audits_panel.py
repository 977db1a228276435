"""Every audited unit of a lot, and the way to confirm an audit that is in doubt, with a reason."""

import streamlit as st

from softcal.app.batch.judging import confirm
from softcal.app.batch.release import lot_standing
from softcal.app.texts.reasons import said
from softcal.app.ui.account import actor
from softcal.app.ui.desk import ask_reason, instant, registry, words
from softcal.app.ui.panels import table
from softcal.app.views.common import number
from softcal.core.quality.lot_standing import UnitInLot

MOST_ROWS = 200


def audits_panel(lot_id: str) -> None:
    """Draw the audited units; nothing where none was."""
    say, unit = words(), registry().lot(lot_id).reference_unit
    rows = lot_standing(registry(), lot_id).audited
    if not rows:
        return
    st.markdown(f"## {say('audit.units')}")
    table([_row(row, unit) for row in rows[:MOST_ROWS]])
    for row in rows:
        if row.doubt is not None:
            _doubt(lot_id, row)


def _row(row: UnitInLot, unit: str) -> dict[str, object]:
    say = words()
    return {
        say("column.serial"): row.serial,
        say("release.forecast"): number(row.forecast_rmse, unit),
        say("release.measured"): number(row.measured_rmse, unit),
        say("column.verdict"): say(f"verdict.{row.verdict}"),
        say("audit.brought"): instant(row.audited_at),
    }


def _doubt(lot_id: str, row: UnitInLot) -> None:
    say = words()
    with st.container(border=True):
        st.warning(said(row.doubt, say) if row.doubt else "", title=row.serial, icon=":material/rule:")
        reason = ask_reason(f"confirm-{row.serial}", say("audit.confirm", serial=row.serial), "release")
    if reason is not None:
        confirm(registry(), lot_id, row.serial, reason=reason, actor=actor())
        st.rerun()
