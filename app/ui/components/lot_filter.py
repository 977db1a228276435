"""Which runs of a lot a page is about: by day, station and operator."""

from datetime import date

import streamlit as st

from softcal.app.ui.desk import words, zone
from softcal.app.ui.server_memory import remembered_lot_view
from softcal.app.views.lot import LotView
from softcal.app.views.lot_runs import DESK, LotFilter


def chosen_lot_view(lot_id: str) -> LotView:
    """Draw the choice of days, stations and operators; return what it leaves of a lot."""
    say, every = words(), remembered_lot_view(lot_id, LotFilter(zone=zone()))
    if not every.judged:
        return every
    with st.popover(say("lot.filter"), icon=":material/filter_alt:"):
        first, second = st.columns(2)
        since = _day(first.date_input(say("trail.since"), value=None, key=f"lot-since-{lot_id}"))
        until = _day(second.date_input(say("trail.until"), value=None, key=f"lot-until-{lot_id}"))
        stations = _names("station", every.every_station, lot_id)
        operators = _names("operator", every.every_operator, lot_id)
    wanted = LotFilter(since, until, stations, operators, zone())
    if wanted.is_open:
        return every
    view = remembered_lot_view(lot_id, wanted)
    st.caption(f":material/filter_alt: {say('lot.filter.on', left=len(view.chosen or ()), of=every.judged)}")
    return view if view.judged else every


def _day(chosen: object) -> date | None:
    return chosen if isinstance(chosen, date) else None


def _names(kind: str, known: tuple[str, ...], lot_id: str) -> tuple[str, ...]:
    say = words()
    return tuple(
        st.multiselect(
            say(f"lot.filter.{kind}"),
            known,
            format_func=lambda name: say("lot.yield.desk") if name == DESK else name,
            key=f"lot-{kind}-{lot_id}",
            placeholder=say("choose.all"),
        )
    )
