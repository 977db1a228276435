"""One unit by serial: why its verdict is so, its map, estimates, history and files."""

from collections.abc import Sequence

import streamlit as st

from softcal.app.batch.release import roll_back
from softcal.app.charts import unit as charts_unit
from softcal.app.charts.why import HEIGHT, why_figure
from softcal.app.export.calibrated_unit import ExportOptions, UnitLoader
from softcal.app.export.certificates.laboratory import kept_laboratory
from softcal.app.export.formats import writer_of
from softcal.app.export.names import FORMATS
from softcal.app.registry.standing import standing_of
from softcal.app.ui.account import actor
from softcal.app.ui.actions import ask_reason, download, finish, refusals_in_words, say_finished
from softcal.app.ui.desk import choose, colours, empty, in_full, in_words, instant, named, say, verdict_badge
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
from softcal.core.lot import Lot
from softcal.db.entries import StoredCalibration

TABS = ("why", "map", "estimates", "recordings", "history", "files")


def render() -> None:
    with heading("unit"):
        serial = find_unit("unit", "unit", st.columns(2, vertical_alignment="bottom"), _known)
        if serial is not None:
            in_full(serial)
    if serial is None:
        empty("empty.units")
        return
    say_finished("unit")
    lots = registry().calibrations.lots_of(serial)
    lot_id = choose(say("choose.lot"), lots, "lot") if len(lots) > 1 else lots[0]
    history = registry().calibrations.history(serial, lot_id)
    if history:
        _revision(serial, history)
        return
    (unit,) = registry().lots.units(lot_id, serial)
    verdict_badge(unit.verdict)
    empty("empty.calibration", in_words(unit.reasons))
    _recordings(serial, registry().lots.get(unit.lot_id))


def _revision(serial: str, history: list[StoredCalibration]) -> None:
    lot_id = history[0].lot_id
    current = registry().calibrations.get(serial, lot_id=lot_id).revision
    revisions = [entry.revision for entry in reversed(history)]
    left, right = st.columns([1, 4], vertical_alignment="bottom")
    revision = right.selectbox(say("column.revision"), revisions, index=revisions.index(current)) or current
    stored = next(entry for entry in history if entry.revision == revision)
    standing = standing_of(registry(), stored)
    with left:
        verdict_badge(standing.verdict if standing.summary is None else stored.state.verdict)
    if standing.summary is None:
        st.markdown(f"{say('unit.refused_since')} **{in_words(standing.reasons)}**")
    unit, errors = registry().lots.get(lot_id).reference_unit, stored.state.errors
    scores = [(say(f"column.{name}"), errors[f"{name}_rmse"], None) for name in ("before", "after", "own")]
    cells = [(say("lot.predicted"), errors["predicted_rmse"], say("unit.predicted.help")), *scores]
    numbers([(label, number(value, unit), tip) for label, value, tip in cells if value is not None])
    for reason in stored.state.decision.reasons:
        st.markdown(f"- {in_words(reason)}")
    if not rest_may_follow():
        return
    view = unit_view(registry(), serial, revision, lot_id)
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
        _recordings(serial, view.lot)
    with changes:
        _history(serial, history, view.lot)
    with files:
        # The calibration in use is asked for as such: whether it still is the answer is looked up with it.
        _files(serial, lot_id, revision, is_in_use=revision == current)


def _known(text: str) -> list[str]:
    serials = registry().pages.find_serials(text)
    if not serials and text:
        st.caption(say("unit.find.none", text=text))
        return registry().pages.find_serials("")
    return serials


def _files(serial: str, lot_id: str, revision: int, is_in_use: bool) -> None:
    """Draw the choice of a format and a button per file."""
    chosen = st.segmented_control(
        say("unit.files.format"), FORMATS, format_func=named("format"), key=f"format-{serial}"
    )
    if chosen is None:
        st.caption(say("unit.files.how"))
        return
    wanted = None if is_in_use else revision
    options = ExportOptions(revision=wanted, lot_id=lot_id, laboratory=kept_laboratory())
    try:
        files = writer_of(chosen)(UnitLoader(registry(), options).load(serial))
    except UnitRefused as error:
        st.warning(in_words(error), icon=":material/block:")
        return
    with st.container(horizontal=True):
        for name, content in files.items():
            size = f"{len(content)} B" if len(content) < 4096 else f"{len(content) / 1024:.0f} KiB"
            exported = ("units", serial, {"lot_id": lot_id, "revision": revision, "file": name})
            download(f"{name}  ({size})", name, content, f"file-{revision}-{name}", exported=exported)


def _history(serial: str, history: Sequence[StoredCalibration], lot: Lot) -> None:
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
        revision = st.selectbox(say("column.revision"), older, key=f"rollback-{serial}-{len(older)}")
        reason = ask_reason(f"rollback-{serial}-{len(older)}", say("unit.rollback.do"), "rollback")
        if reason is None:
            return
        with refusals_in_words():
            roll_back(registry(), serial, revision, reason=reason, actor=actor(), lot_id=lot.id)
            finish("unit", say("unit.rollback.done", revision=revision))


def _recordings(serial: str, lot: Lot) -> None:
    """Draw the unit's recordings and the curve of the one that is chosen, the newest at first."""
    entries = registry().recordings.of_lot(lot.id, serial)[::-1]
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
    key = f"recordings-{serial}"
    chosen = entries[table_to_choose(rows, key) or 0]
    show_figure(charts_unit.recording(registry().recordings.get(chosen.sha256), lot, colours(), say), f"{key}-plot")
