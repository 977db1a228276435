"""The limit and the rules of a lot in versions: what holds, who set it and why, and what another limit would do."""

import streamlit as st

from softcal.app.batch.judging import judge_again
from softcal.app.charts import lot as charts_lot
from softcal.app.ui.account import actor
from softcal.app.ui.components.rules_form import rules_form
from softcal.app.ui.desk import ask_reason, colours, in_words, instant, registry, words
from softcal.app.ui.first_paint import rest_may_follow
from softcal.app.ui.panels import figure_under, headline, lot_heading, table
from softcal.app.ui.server_memory import remembered_lot_view
from softcal.app.views.common import limit_said, number, percent
from softcal.app.views.lot import LotView
from softcal.core.errors import InputError
from softcal.db.entries import LimitEntry


def render() -> None:
    say = words()
    lot_id = lot_heading("limits", registry().lots.ids())
    if lot_id is None:
        return
    if done := st.session_state.pop("limit-done", ""):
        st.success(done, icon=":material/check:")
    view, versions = remembered_lot_view(lot_id), registry().lots.limit_versions(lot_id)
    left, right = st.columns(2)
    with left, st.container(border=True):
        _change(view, versions)
    if not rest_may_follow():
        return
    with right:
        figure_under("lot.distribution", charts_lot.predicted_errors(view, colours(), say), "limit-distribution")
    st.header(say("limits.versions"))
    if versions:
        table([_row(entry, view.lot.reference_unit) for entry in reversed(versions)])
    else:
        st.caption(say("limits.none"))
    rules_form(view.lot)


def _row(entry: LimitEntry, unit: str) -> dict[str, object]:
    say = words()
    return {
        say("limits.version"): entry.version,
        say("lot.limit"): number(entry.rmse, unit) if entry.rmse else say("lot.limit.none"),
        say("column.made"): instant(entry.made_at),
        say("column.actor"): entry.actor,
        say("column.reason"): entry.reason,
    }


def _change(view: LotView, versions: list[LimitEntry]) -> None:
    say, unit = words(), view.lot.reference_unit
    newest = versions[-1].version if versions else 0
    # The version a person decides on is the one first drawn, not one that somebody else has written meanwhile.
    looked_at = f"limit-seen-{view.lot.id}"
    version = st.session_state.setdefault(looked_at, newest)
    headline(say("limits.now", limit=limit_said(view.limit, say), version=newest))
    is_automatic = st.toggle(say("limits.auto"), view.lot.limit_rmse is None, key=f"auto-{view.lot.id}-{version}")
    usual = view.limit_rmse or view.median_predicted or 1.0
    wanted = st.number_input(
        f"{say('limits.new')} [{unit}]",
        min_value=0.0,
        value=float(usual),
        step=float(f"{usual / 10:.1g}"),
        format="%.4g",
        disabled=is_automatic,
        key=f"limit-{view.lot.id}-{version}",
    )
    if not is_automatic:
        _preview(view, wanted)
    reason = ask_reason(f"limit-{view.lot.id}-{version}", say("limits.set"), "set_limit")
    if reason is None:
        return
    rmse = None if is_automatic else wanted
    st.session_state.pop(looked_at)
    try:
        registry().lots.set_limit(view.lot.id, rmse, reason=reason, actor=actor(), expected_version=version)
        judge_again(registry(), [view.lot.id], actor())
    except InputError as error:
        st.error(in_words(error), icon=":material/error:")
        return
    st.session_state["limit-done"] = say("limits.done", limit=say("lot.limit.none") if rmse is None else f"{rmse:g}")
    st.rerun()


def _preview(view: LotView, wanted: float) -> None:
    say, errors = words(), view.predicted()
    if len(errors):
        within = int((errors <= wanted).sum())
        share = percent(within / len(errors))
        st.markdown(say("limits.within", within=within, count=len(errors), share=share))
    st.caption(say("limits.note"))
