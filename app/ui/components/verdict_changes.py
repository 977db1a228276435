"""What an act will change, before it is done: each unit whose verdict another one replaces."""

from collections.abc import Sequence

import streamlit as st

from softcal.app.calibration.changes import VerdictChange
from softcal.app.ui.panels import lot_link, table, unit_link
from softcal.app.ui.presentation import localize, translate, verdict_word
from softcal.core.lot import UnitKey

MAX_ROWS = 200


def draw_changes(changed: Sequence[VerdictChange]) -> None:
    """Draw the units that an act changes, in the order given; where there are none, say so."""
    table(
        (
            {
                translate("column.serial"): unit_link(UnitKey(one.lot_id, one.serial)),
                translate("choose.lot"): lot_link(one.lot_id),
                translate("limits.now.verdict"): verdict_word(one.verdict),
                translate("limits.then.verdict"): verdict_word(one.next_verdict),
                translate("column.reasons"): localize([one.reason]),
            }
            for one in changed[:MAX_ROWS]
        ),
        translate("changes.none"),
    )
    if len(changed) > MAX_ROWS:
        st.caption(translate("limits.more", count=len(changed) - MAX_ROWS))
