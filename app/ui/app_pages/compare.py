"""Side by side: two units with their maps in one picture, or lots with their yields and errors."""

import streamlit as st

from softcal.app.charts.compare import errors_of_lots, maps_together, predicted_over_load
from softcal.app.texts.reasons import all_said
from softcal.app.ui.desk import colours, empty, instant, say, verdict_badge
from softcal.app.ui.panels import figure_under, figures_beside, find_unit, heading, rest_may_follow, table
from softcal.app.ui.server_memory import registry, remembered_lot_view
from softcal.app.views.common import number
from softcal.app.views.lot_report import MOST_LOTS, lot_rows
from softcal.app.views.unit import UnitView, unit_view
from softcal.core.lot import UnitKey

PLACES = ("a", "b")
KINDS = ("units", "lots")


def render() -> None:
    with heading("compare"):
        kinds = {kind: say(f"compare.{kind}") for kind in KINDS}
        asked = str(st.query_params.get("kind", KINDS[0]))
        kind = st.segmented_control(
            say("compare.what"),
            KINDS,
            default=asked if asked in KINDS else KINDS[0],
            format_func=kinds.__getitem__,
            key="compare-kind",
            label_visibility="collapsed",
        )
    if kind == "lots":
        known = registry().lots.ids()
        if not known:
            empty("empty.lots")
            return
        wanted = [lot for lot in st.query_params.get_all("lot") if lot in known]
        lots = st.multiselect(
            say("compare.lots"),
            known,
            wanted or known[-2:],
            max_selections=MOST_LOTS,
            key="compare-lots",
            placeholder=say("choose.some"),
        )
        if not lots:
            return
        views = [remembered_lot_view(lot) for lot in lots]
        table(lot_rows(views, say))
        if rest_may_follow():
            figure_under("lot.distribution", errors_of_lots(views, colours(), say), "compare-errors")
        return

    chosen = []
    for usual, (place, column) in enumerate(zip(PLACES, st.columns(2), strict=True)):
        unit = find_unit(place, f"compare-{place}", (column, column), _calibrated, usual)
        if unit is None:
            return
        chosen.append(unit)
    left, right = (unit_view(registry(), unit) for unit in chosen)
    for column, view in zip(st.columns(2), (left, right), strict=True):
        with column:
            verdict_badge(view.stored.state.verdict)
    one, other = _facts(left), _facts(right)
    first, second = str(left.stored.key), str(right.stored.key)
    second = second if second != first else f"{second} "
    table([{say("compare.fact"): name, first: one[name], second: other[name]} for name in one])
    if rest_may_follow():
        figures_beside(
            ("unit.map", maps_together((left, right), colours(), say), "compare-maps"),
            ("compare.interval", predicted_over_load((left, right), colours(), say), "compare-interval"),
        )


def _calibrated(text: str) -> list[UnitKey]:
    units = registry().pages.find_units(text)
    return [unit for unit in units if registry().calibrations.history(unit.serial, unit.lot_id)]


def _facts(view: UnitView) -> dict[str, str]:
    errors, unit = view.stored.state.errors, view.lot.reference_unit
    return {
        say("column.revision"): str(view.stored.revision),
        say("column.made"): instant(view.stored.made_at),
        say("column.family"): view.stored.state.fit.family,
        say("lot.predicted"): number(errors["predicted_rmse"], unit),
        say("column.before"): number(errors["before_rmse"], unit),
        say("column.after"): number(errors["after_rmse"], unit),
        say("column.own"): number(errors["own_rmse"], unit),
        say("column.reasons"): all_said(view.stored.state.decision.reasons, say),
    }
