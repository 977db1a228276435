"""One unit of a lot: why its verdict is so, its map, estimates, history and files."""

from collections.abc import Sequence

import streamlit as st

from softcal.app.batch.changes import reached_lots
from softcal.app.batch.release import roll_back
from softcal.app.charts import unit as charts_unit
from softcal.app.charts.why import HEIGHT, why_figure
from softcal.app.export.calibrated_unit import ExportOptions, UnitLoader
from softcal.app.export.export import given_facts, withdraw_given
from softcal.app.export.formats import writer_of
from softcal.app.export.names import FORMATS
from softcal.app.registry.standing import standing_of
from softcal.app.ui.account import actor
from softcal.app.ui.actions import ask_reason, download, finish, refusals_in_words, say_finished
from softcal.app.ui.desk import colours, empty, in_full, in_words, instant, named, say, verdict_badge
from softcal.app.ui.panels import (
    figure_under,
    figures_beside,
    find_unit,
    heading,
    numbers,
    rest_may_follow,
    show_figure,
    table,
    table_to_choose,
)
from softcal.app.ui.server_memory import registry
from softcal.app.views.common import number, percent
from softcal.app.views.unit import unit_view
from softcal.core.errors import UnitRefused
from softcal.core.lot import Lot, UnitKey
from softcal.db.entries import StoredCalibration

TABS = ("why", "map", "estimates", "recordings", "history", "files")


def render() -> None:
    with heading("unit"):
        columns = st.columns(2, vertical_alignment="bottom")
    key = find_unit("unit", "unit", columns, _known)
    if key is None:
        return
    in_full(key.serial)
    say_finished("unit")
    history = registry().calibrations.history(key.serial, key.lot_id)
    if history:
        _revision(key, history)
        return
    (unit,) = registry().lots.units(key.lot_id, key.serial)
    verdict_badge(unit.verdict)
    empty("empty.calibration", in_words(unit.reasons))
    _recordings(key, registry().lots.get(key.lot_id))


def _revision(key: UnitKey, history: list[StoredCalibration]) -> None:
    current = registry().calibrations.get(key.serial, lot_id=key.lot_id).revision
    revisions = [entry.revision for entry in reversed(history)]
    left, right = st.columns([1, 4], vertical_alignment="bottom")
    revision = right.selectbox(say("column.revision"), revisions, index=revisions.index(current)) or current
    stored = next(entry for entry in history if entry.revision == revision)
    standing = standing_of(registry(), stored)
    with left:
        verdict_badge(standing.verdict if standing.summary is None else stored.state.verdict)
    if standing.summary is None:
        st.markdown(f"{say('unit.refused_since')} **{in_words(standing.reasons)}**")
    unit, errors = registry().lots.get(key.lot_id).reference_unit, stored.state.errors
    scores = [(say(f"column.{name}"), errors[f"{name}_rmse"], None) for name in ("before", "after", "own")]
    cells = [(say("lot.predicted"), errors["predicted_rmse"], say("unit.predicted.help")), *scores]
    numbers([(label, number(value, unit), tip) for label, value, tip in cells if value is not None])
    for reason in stored.state.decision.reasons:
        st.markdown(f"- {in_words(reason)}")
    if not rest_may_follow():
        return
    view = unit_view(registry(), key, revision)
    share = percent(view.flagged / len(view.estimate.flag))
    st.caption(say("unit.flags", flagged=view.flagged, rows=len(view.estimate.flag), share=share))
    why, map_tab, estimates, recordings, changes, files = st.tabs([say(f"unit.tab.{name}") for name in TABS])
    with why:
        # The head of the figure says what stands above it already.
        figure = why_figure(view, colours(), say).update_layout(title=None, margin_t=60, height=HEIGHT)
        figure_under("unit.why", figure, "why")
    with map_tab:
        figures_beside(
            ("unit.outputs", charts_unit.output_distributions(view, colours(), say), "output_distributions"),
            ("unit.map", charts_unit.map_curve(view, colours(), say), "map_curve"),
        )
    with estimates:
        figures_beside(
            ("unit.hysteresis", charts_unit.hysteresis(view, colours(), say), "hysteresis"),
            ("unit.estimate", charts_unit.estimate_band(view, colours(), say), "estimate_band"),
        )
    with recordings:
        _recordings(key, view.lot)
    with changes:
        _history(key, history, view.lot)
    with files:
        # The calibration in use is asked for as such: whether it still is the answer is looked up with it.
        _files(key, revision, is_in_use=revision == current)


def _known(text: str) -> list[UnitKey]:
    units = registry().pages.find_units(text)
    if not units and text:
        st.caption(say("unit.find.none", text=text))
        return registry().pages.find_units("")
    return units


def _files(key: UnitKey, revision: int, is_in_use: bool) -> None:
    """Draw the choice of a format and a button per file."""
    chosen = st.segmented_control(say("unit.files.format"), FORMATS, format_func=named("format"), key=f"format-{key}")
    if chosen is None:
        st.caption(say("unit.files.how"))
        return
    wanted = None if is_in_use else revision
    options = ExportOptions(revision=wanted, lot_id=key.lot_id)
    try:
        unit = UnitLoader(registry(), options).load(key.serial)
        files = writer_of(chosen)(unit)
    except UnitRefused as error:
        st.warning(in_words(error), icon=":material/block:")
        return
    with st.container(horizontal=True):
        for name, content in files.items():
            size = f"{len(content)} B" if len(content) < 4096 else f"{len(content) / 1024:.0f} KiB"
            exported = ("units", (key.lot_id, key.serial), {**given_facts(unit), "file": name})
            download(f"{name}  ({size})", name, content, f"file-{key}-{revision}-{name}", exported=exported)


def _history(key: UnitKey, history: Sequence[StoredCalibration], lot: Lot) -> None:
    """Draw the revisions, newest first, and a way back to an older one."""
    rows, older = [], []
    for entry in reversed(history):
        state, errors = entry.state, entry.state.errors
        back = say("unit.rolled_back", revision=entry.rolled_back_to) if entry.rolled_back_to else ""
        rows.append(
            {
                say("column.revision"): entry.revision,
                say("column.in_use"): say("unit.in_use") if entry.is_current else "",
                say("column.made"): instant(entry.made_at),
                say("column.verdict"): say(f"verdict.{state.verdict}"),
                say("column.predicted"): number(errors["predicted_rmse"], lot.reference_unit),
                say("column.after"): number(errors["after_rmse"], lot.reference_unit),
                say("column.family"): state.fit.family,
                say("column.actor"): entry.actor,
                say("column.reason"): "; ".join(filter(None, (back, entry.reason))),
            }
        )
        if not entry.is_current:
            older.append(entry.revision)
    table(rows)
    if not older:
        return
    with st.container(border=True):
        st.markdown(f"**{say('unit.rollback')}**")
        revision = st.selectbox(say("column.revision"), older, key=f"rollback-{key}-{len(older)}")
        reason = ask_reason(f"rollback-{key}-{len(older)}", say("unit.rollback.do"), "rollback")
        if reason is None:
            return
        with refusals_in_words():
            roll_back(registry(), key.serial, revision, reason=reason, actor=actor(), lot_id=key.lot_id)
            withdraw_given(registry(), reached_lots(registry(), key.lot_id))
            finish("unit", say("unit.rollback.done", revision=revision))


def _recordings(key: UnitKey, lot: Lot) -> None:
    """Draw the unit's recordings and the curve of the one that is chosen, the newest at first."""
    entries = registry().recordings.of_lot(lot.id, key.serial)[::-1]
    if not entries:
        st.caption(say("unit.recordings.none"))
        return
    rows = [
        {
            say("column.kind"): say(f"kind.{entry.kind}"),
            say("column.made"): instant(entry.added_at),
            say("column.duration"): f"{entry.samples / entry.sample_rate_Hz:.1f} s",
            say("column.rate"): f"{entry.sample_rate_Hz:g} Hz",
            "SHA-256": entry.sha256[:12],
        }
        for entry in entries
    ]
    chosen = entries[table_to_choose(rows, f"recordings-{key}") or 0]
    show_figure(
        charts_unit.recording(registry().recordings.get(chosen.sha256), lot, colours(), say), f"recordings-{key}-plot"
    )
