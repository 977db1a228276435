"""The wall board: one lot at one glance, large, drawn again by itself."""

from datetime import UTC, datetime
from html import escape
from pathlib import Path

import streamlit as st

from softcal.app.ui.components import line_card
from softcal.app.ui.components.line_card import chips_row
from softcal.app.ui.panels import chosen_lot, has_units
from softcal.app.ui.presentation import colours, show_errors, translate, zone
from softcal.app.ui.server_cache import cached_lot_view, registry
from softcal.app.views.alerts import alerts
from softcal.app.views.line_states import STATES
from softcal.app.views.lot_runs import LotFilter
from softcal.app.views.wall import wall_view

STYLE = Path(__file__).with_suffix(".css").read_text(encoding="utf-8")
EVERY_S = 3.0
"""Between two looks; a lot that did not change costs one query."""


def wall() -> None:
    """Draw the wall board of the lot that the address names."""
    st.html(line_card.style() + line_card.theme(colours()) + f"<style>{STYLE}</style>")
    if (lot_id := chosen_lot("wall")) is not None and has_units(lot_id):
        _board(lot_id)


@st.fragment(run_every=EVERY_S)
@show_errors()
def _board(lot_id: str) -> None:
    view = cached_lot_view(lot_id, LotFilter(zone=zone()))
    now = datetime.now(UTC).astimezone(zone())
    board = wall_view(registry(), view, alerts(registry(), view, now), translate, now)
    tiles = "".join(
        f'<div class="sw-tile"><span>{escape(label)}</span><b>{escape(value)}</b><small>{escape(below)}</small></div>'
        for label, value, below in board.tiles
    )
    counts = "".join(
        f'<div class="sw-count sc-{STATES[verdict].tone}"><b>{count}</b><span>{escape(word)}</span></div>'
        for verdict, word, count in board.verdicts
    )
    alert_items = "".join(
        f'<li class="{"sw-urgent" if urgent else ""}">{escape(text)}</li>' for text, urgent in board.alerts
    )
    stations = "".join(
        f'<span><b>{escape(name)}</b> <span class="{"sw-well" if is_well else "sw-ill"}">{escape(word)}</span></span>'
        for name, word, is_well in board.stations
    )
    no_station = f"<span>{escape(translate('wall.stations.none'))}</span>"
    well = f'<li class="sw-well">{escape(translate("wall.well"))}</li>'
    with st.container(key="wall"):
        st.html(
            f'<div class="sw-tiles">{tiles}</div><div class="sw-counts">{counts}</div>'
            f'<div role="status"><ul class="sw-alerts">{alert_items or well}</ul></div>'
            f'<div class="sw-stations">{stations or no_station}</div>'
            f'<div class="sc-chips"><h2>{escape(translate("line.last"))}</h2>{chips_row(board.chips)}</div>'
            f'<p class="sw-drawn">{escape(board.drawn_text)}</p>'
        )
