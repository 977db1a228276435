"""The wall board: one lot at one glance, large, drawn again by itself."""

from datetime import UTC, datetime
from functools import cache
from html import escape
from pathlib import Path

import streamlit as st

from softcal.app.ui.components import line_card
from softcal.app.ui.components.line_card import chips_row
from softcal.app.ui.desk import colours, errors_in_words, registry, say, zone
from softcal.app.ui.panels import for_lot, has_units
from softcal.app.ui.server_memory import remembered_lot_view
from softcal.app.views.alerts import alerts
from softcal.app.views.line import STATES
from softcal.app.views.lot_runs import LotFilter
from softcal.app.views.wall import StationTile, WallView, wall_view

EVERY_S = 3.0
"""Between two looks; a lot that did not change costs one query."""


def render() -> None:
    st.html(line_card.style() + line_card.theme(colours()) + board_style())
    _of_lot()


@for_lot("wall")
def _of_lot(lot_id: str) -> None:
    if has_units(lot_id):
        _board(lot_id)


@st.fragment(run_every=EVERY_S)
@errors_in_words()
def _board(lot_id: str) -> None:
    view = remembered_lot_view(lot_id, LotFilter(zone=zone()))
    now = datetime.now(UTC).astimezone(zone())
    found = alerts(registry(), view, now)
    with st.container(key="wall"):
        board = wall_view(registry(), view, found, say, now)
        st.html(board_html(board, say("line.last"), say("wall.well"), say("wall.stations.none")))


@cache
def board_style() -> str:
    """Return the style of the board; once per page, after that of the line's card."""
    return f"<style>{Path(__file__).with_suffix('.css').read_text(encoding='utf-8')}</style>"


def board_html(view: WallView, last: str, well: str, no_station: str) -> str:
    """Return the board.

    Args:
        last: heading of the last units.
        well: what stands there while nothing needs a look.
        no_station: what stands there while no station has given a sign of life.
    """
    tiles = "".join(
        f'<div class="sw-tile"><span>{escape(label)}</span><b>{escape(value)}</b><small>{escape(below)}</small></div>'
        for label, value, below in view.tiles
    )
    counts = "".join(
        f'<div class="sw-count sc-{STATES[verdict].tone}"><b>{count}</b><span>{escape(word)}</span></div>'
        for verdict, word, count in view.verdicts
    )
    stations = "".join(map(_station, view.stations)) or f"<span>{escape(no_station)}</span>"
    return (
        f'<div class="sw-tiles">{tiles}</div><div class="sw-counts">{counts}</div>'
        f'<div role="status"><ul class="sw-alerts">{_alerts(view, well)}</ul></div>'
        f'<div class="sw-stations">{stations}</div>'
        f'<div class="sc-chips"><h2>{escape(last)}</h2>{chips_row(view.chips)}</div>'
        f'<p class="sw-drawn">{escape(view.drawn)}</p>'
    )


def _alerts(view: WallView, well: str) -> str:
    said = "".join(f'<li class="{"sw-urgent" if urgent else ""}">{escape(text)}</li>' for text, urgent in view.alerts)
    return said or f'<li class="sw-well">{escape(well)}</li>'


def _station(tile: StationTile) -> str:
    look = "sw-well" if tile.is_well else "sw-ill"
    return f'<span><b>{escape(tile.name)}</b> <span class="{look}">{escape(tile.word)}</span></span>'
