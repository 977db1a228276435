"""One unit by serial: why its verdict is what it is, its map, its estimates, its history."""

import pandas as pd
import streamlit as st

from softcal.app import charts
from softcal.app.desk import (
    choose,
    choose_language,
    colours,
    empty,
    errors_in_words,
    registry,
    show_figure,
    verdict_badge,
    words,
)
from softcal.app.views import UnitView, number, unit_view
from softcal.db.entries import StoredCalibration, UnitEntry


def render() -> None:
    """Draw the page."""
    say = words()
    with errors_in_words():
        units = {unit.serial: unit for unit in registry().units() if unit.role == "target" and unit.verdict}
        if not units:
            empty(say("empty.units"), say("empty.units.how"))
            return
        left, middle, right = st.columns([4, 1, 1])
        with right:
            choose_language()
        with left:
            serial = choose(say("choose.unit"), list(units), "unit") or next(iter(units))
        history = registry().history(serial)
        if not history:
            _refused(units[serial])
            return
        with middle:
            revision = st.selectbox(say("choose.revision"), [entry.revision for entry in reversed(history)])
        _unit(unit_view(registry(), serial, revision))
        _history(history)


def _refused(unit: UnitEntry) -> None:
    verdict_badge(unit.verdict)
    empty(words()("empty.calibration"), "; ".join(unit.reasons))


def _unit(view: UnitView) -> None:
    say, record, unit = words(), view.stored.record, view.lot.reference_unit
    left, right = st.columns([1, 3])
    with left:
        verdict_badge(record.verdict)
        st.metric(say("lot.predicted"), number(record.predicted_rmse, unit), border=True)
        if record.after_rmse is not None:
            scores = {name: number(getattr(record, f"{name}_rmse"), unit) for name in ("before", "after", "own")}
            st.caption(say("unit.audit", **scores))
        st.caption(say("unit.flags", flagged=view.flagged, rows=len(view.estimate.flag)))
    with right:
        st.subheader(say("unit.why"))
        for reason in record.reasons:
            st.markdown(f"- {reason}")
    for row in (("contributions", "interval_by_load"), ("output_distributions", "map_curve")):
        for column, name in zip(st.columns(2), row, strict=True):
            with column:
                _chart(view, name)
    _chart(view, "estimate_band")
    _chart(view, "hysteresis")


TITLES = {
    "contributions": "unit.contributions",
    "interval_by_load": "unit.error",
    "output_distributions": "unit.outputs",
    "map_curve": "unit.map",
    "hysteresis": "unit.hysteresis",
    "estimate_band": "unit.estimate",
}


def _chart(view: UnitView, name: str) -> None:
    say = words()
    st.subheader(say(TITLES[name]))
    show_figure(getattr(charts, name)(view, colours(), say), name)


def _history(history: list[StoredCalibration]) -> None:
    say = words()
    rows = [
        {
            say("column.revision"): entry.revision,
            say("column.made"): f"{entry.made_at:%Y-%m-%d %H:%M:%S} UTC",
            say("column.verdict"): say(f"verdict.{entry.record.verdict}"),
            say("column.predicted"): entry.record.predicted_rmse,
            say("column.family"): entry.record.family,
            say("column.actor"): entry.actor,
            say("column.reason"): entry.reason,
        }
        for entry in reversed(history)
    ]
    st.subheader(say("unit.history"))
    st.dataframe(pd.DataFrame(rows), width="stretch", hide_index=True)
