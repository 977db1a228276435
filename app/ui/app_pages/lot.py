"""One lot: where it stands and what is next, its units, audits, release, rules and networks."""

from softcal.app.ui.panels import chosen_lot
from softcal.app.ui.tab_bar import draw_tabs


def render() -> None:
    if (lot_id := chosen_lot("lot")) is not None:
        draw_tabs("lot", lot_id)
