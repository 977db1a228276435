"""The tabs of a unit: why, its recordings and estimate, files, history and long use, another unit beside it."""

import streamlit as st

from softcal.app.calibration.changes import list_affected_lots
from softcal.app.calibration.release import roll_back
from softcal.app.charts import unit as charts_unit
from softcal.app.charts.compare import maps_together, predicted_over_load
from softcal.app.charts.explanation import HEIGHT, explanation_figure
from softcal.app.charts.long_term import course_figure
from softcal.app.export.calibrated_unit import ExportOptions, UnitLoader
from softcal.app.export.export import exported_file_record, withdraw_recalled_files
from softcal.app.export.formats import find_writer
from softcal.app.export.names import FORMATS
from softcal.app.texts.reasons import render_reasons, translate_phrase
from softcal.app.ui.account import actor, allows
from softcal.app.ui.actions import ask_reason, download, finish, show_refusals
from softcal.app.ui.components.verdict_changes import draw_changes
from softcal.app.ui.panels import (
    figure_under,
    rest_may_follow,
    show_figure,
    show_figures,
    table,
    table_to_choose,
    units_of_address,
)
from softcal.app.ui.presentation import (
    colours,
    empty,
    format_instant,
    label_formatter,
    localize,
    translate,
    verdict_word,
)
from softcal.app.ui.server_cache import registry, remembered_rollback
from softcal.app.views.common import number, percent
from softcal.app.views.long_term import course, units_in_use
from softcal.app.views.unit import UnitView, unit_view
from softcal.core.errors import UnitRefused
from softcal.core.lot import UnitKey
from softcal.db.entries import StoredCalibration


def draw_why(key: UnitKey, stored: StoredCalibration) -> None:
    """Draw what was measured first, else what the forecast is made of."""
    for reason in stored.state.decision.reasons:
        st.markdown(f"- {localize(reason)}")
    if not rest_may_follow():
        return
    view = unit_view(registry(), key, stored.revision)
    figure = explanation_figure(view, colours(), translate)
    figure.update_layout(title=None, margin_t=36, height=HEIGHT if view.audit else HEIGHT // 2)
    figure_under("unit.why", figure, "why")


def draw_recording(key: UnitKey, stored: StoredCalibration) -> None:
    """Draw the recordings, the estimate on them, and the map."""
    if not rest_may_follow():
        return
    view = unit_view(registry(), key, stored.revision)
    share = percent(view.flagged / len(view.estimate.flag))
    st.caption(translate("unit.flags", flagged=view.flagged, rows=len(view.estimate.flag), share=share))
    show_figures(
        ("unit.estimate", charts_unit.estimate_band(view, colours(), translate), "estimate_band"),
        ("unit.hysteresis", charts_unit.hysteresis(view, colours(), translate), "hysteresis"),
    )
    show_figures(
        ("unit.outputs", charts_unit.output_distributions(view, colours(), translate), "output_distributions"),
        ("unit.map", charts_unit.map_curve(view, colours(), translate), "map_curve"),
    )
    draw_recordings(key)


def draw_recordings(key: UnitKey) -> None:
    """Draw the unit's recordings and the curve of the one that is chosen, the newest at first."""
    lot = registry().lots.get(key.lot_id)
    entries = registry().recordings.of_lot(lot.id, key.serial)[::-1]
    if not entries:
        st.caption(translate("unit.recordings.none"))
        return
    rows = [
        {
            translate("column.kind"): translate(f"kind.{entry.kind}"),
            translate("column.made"): format_instant(entry.added_at),
            translate("column.duration"): f"{entry.samples / entry.sample_rate_Hz:.1f} s",
            translate("column.rate"): f"{entry.sample_rate_Hz:g} Hz",
            "SHA-256": entry.sha256[:12],
        }
        for entry in entries
    ]
    chosen = entries[table_to_choose(rows, f"recordings-{key}") or 0]
    show_figure(
        charts_unit.recording(registry().recordings.get(chosen.sha256), lot, colours(), translate),
        f"recordings-{key}-plot",
    )


def draw_files(key: UnitKey, stored: StoredCalibration) -> None:
    """Draw the choice of a format, and a button a file."""
    chosen = st.segmented_control(
        translate("unit.files.format"), FORMATS, format_func=label_formatter("format"), key=f"format-{key}"
    )
    if chosen is None:
        st.caption(translate("unit.files.how"))
        return
    # The calibration in use is asked for as such: whether it still is the answer is looked up with it.
    revision = None if stored.is_current else stored.revision
    options = ExportOptions(revision=revision, lot_id=key.lot_id)
    try:
        unit = UnitLoader(registry(), options).load(key.serial)
        files = find_writer(chosen)(unit)
    except UnitRefused as error:
        st.warning(localize(error), icon=":material/block:")
        return
    with st.container(horizontal=True):
        for name, content in files.items():
            size = f"{len(content)} B" if len(content) < 4096 else f"{len(content) / 1024:.0f} KiB"
            exported = ("units", (key.lot_id, key.serial), {**exported_file_record(unit), "file": name})
            label = f"{name}  ({size})"
            download(label, name, content, f"file-{key}-{stored.revision}-{name}", exported=exported)


def draw_history(key: UnitKey, stored: StoredCalibration) -> None:
    """Draw the revisions, a way back to an older one, and the course in long use."""
    unit, rows, older = registry().lots.get(key.lot_id).reference_unit, [], []
    for entry in reversed(registry().calibrations.history(key.serial, key.lot_id)):
        state, errors = entry.state, entry.state.errors
        back = translate("unit.rolled_back", revision=entry.rolled_back_to) if entry.rolled_back_to else ""
        rows.append(
            {
                translate("column.revision"): entry.revision,
                translate("column.in_use"): translate("unit.in_use") if entry.is_current else "",
                translate("column.made"): format_instant(entry.made_at),
                translate("column.verdict"): verdict_word(state.verdict),
                translate("column.predicted"): number(errors["predicted_rmse"], unit, state.limit.maximum_rmse),
                translate("column.after"): number(errors["after_rmse"], unit, state.limit.maximum_rmse),
                translate("column.family"): state.fit.family,
                translate("column.actor"): entry.actor,
                translate("column.reason"): "; ".join(filter(None, (back, entry.reason))),
            }
        )
        if not entry.is_current:
            older.append(entry.revision)
    table(rows)
    if older:
        _roll_back(key, older)
    _draw_operation(key, stored)


def _roll_back(key: UnitKey, older: list[int]) -> None:
    with st.container(border=True):
        st.markdown(f"**{translate('unit.rollback')}**")
        revision = int(st.selectbox(translate("column.revision"), older, key=f"rollback-{key}-{len(older)}"))
        if allows("rollback"):
            with show_refusals():
                draw_changes(remembered_rollback(key.lot_id, key.serial, revision).changed)
        reason = ask_reason(f"rollback-{key}-{len(older)}", translate("unit.rollback.do"), "rollback")
        if reason is None:
            return
        with show_refusals():
            roll_back(registry(), key.serial, revision, reason=reason, actor=actor(), lot_id=key.lot_id)
            withdraw_recalled_files(registry(), list_affected_lots(registry(), key.lot_id))
            finish("unit", translate("unit.rollback.done", revision=revision))


def _draw_operation(key: UnitKey, stored: StoredCalibration) -> None:
    """Draw the state and the course of a unit in use; nothing where it is not followed."""
    entry = next((candidate for candidate in units_in_use(registry()) if candidate[0].key == key), None)
    if entry is None:
        return
    unit, reference_unit = entry
    st.header(translate("long_term.course", serial=key.serial))
    state, limit = "alarm" if unit.entry["alarm"] else unit.entry["verdict"], stored.state.limit.maximum_rmse
    cells = (
        (translate("column.state"), translate(f"event.{state}")),
        (translate("lot.predicted"), number(unit.entry["predicted_rmse"], reference_unit, limit)),
        (translate("chart.drift_scale"), number(unit.entry["shift"])),
        (translate("long_term.steps"), str(unit.steps)),
        (translate("column.made"), format_instant(unit.made_at)),
    )
    st.markdown(" · ".join(f"{label}: **{value}**" for label, value in cells))
    streams = registry().adaptations.streams(key)
    stream = streams[0] if len(streams) == 1 else str(st.selectbox(translate("long_term.stream"), streams))
    stream_course = course(registry(), key, stream)
    if stream_course.alarm:
        message = translate_phrase("adapt", stream_course.alarm, translate)
        st.warning(message, icon=":material/notification_important:", title=translate("long_term.due"))
    if not stream_course.steps:
        st.caption(translate("long_term.no_steps"))
        return
    if rest_may_follow():
        show_figure(course_figure(stream_course, colours(), translate), f"course-{key}")


def draw_compare(key: UnitKey, stored: StoredCalibration) -> None:
    """Draw the numbers of this unit and another one, and their maps in one picture."""
    requested_unit = str(st.query_params.get("with", ""))
    text = str(st.text_input(translate("unit.find"), key=f"compare-find-{key}", icon=":material/search:") or "").strip()
    offered = list(dict.fromkeys([*(() if text else units_of_address(requested_unit)), *_others(key, text)]))
    if not offered:
        empty("empty.units")
        return
    other = st.selectbox(
        translate("choose.unit"),
        offered,
        format_func=lambda unit: f"{unit.serial} · {unit.lot_id}",
        key=f"compare-with-{key}-{text}",
    )
    st.query_params["with"] = str(other)
    left, right = unit_view(registry(), key, stored.revision), unit_view(registry(), other)
    one, two = _unit_values(left), _unit_values(right)
    table([{translate("compare.fact"): name, str(key): one[name], str(other): two[name]} for name in one])
    if rest_may_follow():
        show_figures(
            ("unit.map", maps_together((left, right), colours(), translate), "compare-maps"),
            ("compare.interval", predicted_over_load((left, right), colours(), translate), "compare-interval"),
        )


def _others(key: UnitKey, text: str) -> list[UnitKey]:
    units = [unit for unit in registry().pages.find_units(text) if unit != key]
    return [unit for unit in units if registry().calibrations.history(unit.serial, unit.lot_id)]


def _unit_values(view: UnitView) -> dict[str, str]:
    errors, unit = view.stored.state.errors, view.lot.reference_unit
    limit = view.stored.state.limit.maximum_rmse
    return {
        translate("column.verdict"): verdict_word(view.stored.state.verdict),
        translate("column.revision"): str(view.stored.revision),
        translate("column.made"): format_instant(view.stored.made_at),
        translate("column.family"): view.stored.state.fit.family,
        translate("lot.predicted"): number(errors["predicted_rmse"], unit, limit),
        translate("column.before"): number(errors["before_rmse"], unit, limit),
        translate("column.after"): number(errors["after_rmse"], unit, limit),
        translate("column.own"): number(errors["own_rmse"], unit, limit),
        translate("column.reasons"): render_reasons(view.stored.state.decision.reasons, translate),
    }
