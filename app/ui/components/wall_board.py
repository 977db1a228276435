"""The wall board as HTML. Everything from outside is escaped."""

from functools import cache
from html import escape
from pathlib import Path

from softcal.app.ui.components.line_card import chips_row
from softcal.app.views.line import TONES
from softcal.app.views.wall import StationTile, WallView


@cache
def style() -> str:
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
        f'<div class="sw-count sc-{TONES[verdict]}"><b>{count}</b><span>{escape(word)}</span></div>'
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
