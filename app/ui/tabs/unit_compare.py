"""A unit beside another one: their numbers, and their maps in one picture."""

import streamlit as st

from softcal.app.charts.compare import maps_together, predicted_over_load
from softcal.app.texts.reasons import all_said
from softcal.app.ui.desk import colours, empty, instant, say, verdict_word
from softcal.app.ui.panels import figures_beside, named_units, rest_may_follow, table
from softcal.app.ui.server_memory import registry
from softcal.app.views.common import number
from softcal.app.views.unit import UnitView, unit_view
from softcal.core.lot import UnitKey
from softcal.db.entries import StoredCalibration


def draw(key: UnitKey, stored: StoredCalibration) -> None:
    asked = str(st.query_params.get("with", ""))
    text = str(st.text_input(say("unit.find"), key=f"compare-find-{key}", icon=":material/search:") or "").strip()
    offered = list(dict.fromkeys([*(() if text else named_units(asked)), *_others(key, text)]))
    if not offered:
        empty("empty.units")
        return
    other = st.selectbox(
        say("choose.unit"),
        offered,
        format_func=lambda unit: f"{unit.serial} · {unit.lot_id}",
        key=f"compare-with-{key}-{text}",
    )
    st.query_params["with"] = str(other)
    left, right = unit_view(registry(), key, stored.revision), unit_view(registry(), other)
    one, two = _facts(left), _facts(right)
    table([{say("compare.fact"): name, str(key): one[name], str(other): two[name]} for name in one])
    if rest_may_follow():
        figures_beside(
            ("unit.map", maps_together((left, right), colours(), say), "compare-maps"),
            ("compare.interval", predicted_over_load((left, right), colours(), say), "compare-interval"),
        )


def _others(key: UnitKey, text: str) -> list[UnitKey]:
    units = [unit for unit in registry().pages.find_units(text) if unit != key]
    return [unit for unit in units if registry().calibrations.history(unit.serial, unit.lot_id)]


def _facts(view: UnitView) -> dict[str, str]:
    errors, unit = view.stored.state.errors, view.lot.reference_unit
    limit = view.stored.state.limit.maximum_rmse
    return {
        say("column.verdict"): verdict_word(view.stored.state.verdict),
        say("column.revision"): str(view.stored.revision),
        say("column.made"): instant(view.stored.made_at),
        say("column.family"): view.stored.state.fit.family,
        say("lot.predicted"): number(errors["predicted_rmse"], unit, limit),
        say("column.before"): number(errors["before_rmse"], unit, limit),
        say("column.after"): number(errors["after_rmse"], unit, limit),
        say("column.own"): number(errors["own_rmse"], unit, limit),
        say("column.reasons"): all_said(view.stored.state.decision.reasons, say),
    }
