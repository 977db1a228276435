"""The limit and the rules of a lot in versions, and what another limit would do."""

from collections.abc import Mapping, Sequence

import streamlit as st

from softcal.app.calibration.changes import change_limit, list_affected_lots
from softcal.app.charts import lot as charts_lot
from softcal.app.export.export import withdraw_recalled_files
from softcal.app.line.load_readings import check_declared_loads
from softcal.app.registry.lot_recordings import source_recording
from softcal.app.ui.account import actor, allows
from softcal.app.ui.actions import ask_reason, finish, show_finished, show_refusals
from softcal.app.ui.components.verdict_changes import draw_changes
from softcal.app.ui.panels import figure_under, headline, rest_may_follow, table
from softcal.app.ui.presentation import colours, format_instant, translate
from softcal.app.ui.server_cache import cached_limit_changes, cached_lot_view, registry
from softcal.app.views.common import limit_number, render_limit
from softcal.core.lot import Lot
from softcal.core.quality.known_loads import MAX_LOADS, KnownLoad
from softcal.core.quality.line_rules import LETTERS, LineRules
from softcal.core.unit.method import Method
from softcal.core.unit.verdict import VERDICTS
from softcal.db.entries import LimitEntry, LineRulesEntry

MAX_UNITS, MAX_RETESTS = 10_000_000, 99


def draw_limits(lot_id: str) -> None:
    show_finished("limit")
    view, versions = cached_lot_view(lot_id), registry().lots.limit_versions(lot_id)
    unit, version_key, automatic = view.lot.reference_unit, f"limit-seen-{lot_id}", translate("lot.limit.none")
    left, right = st.columns(2)
    with left, st.container(border=True):
        version = _first_displayed_version(version_key, versions)
        newest = versions[-1].version if versions else 0
        headline(translate("limits.now", limit=render_limit(view.limit, translate), version=newest))
        is_automatic = st.toggle(translate("limits.auto"), view.lot.limit_rmse is None, key=f"auto-{lot_id}-{version}")
        default = float((view.limit and view.limit.maximum_rmse) or view.median_predicted or 1.0)
        label, step, key = (
            f"{translate('limits.new')} [{unit}]",
            float(f"{default / 10:.1g}"),
            f"limit-{lot_id}-{version}",
        )
        new_limit = st.number_input(label, 0.0, None, default, step, "%.4g", key, disabled=is_automatic)
        rmse = None if is_automatic else new_limit
        label = (
            translate("limits.withdraw") if rmse is None else translate("limits.set", limit=limit_number(rmse, unit))
        )
        # By the very decision that would be made; the limit in force changes nothing.
        is_other = rmse not in (0, view.lot.limit_rmse)
        changes = cached_limit_changes(lot_id, rmse) if allows("set_limit") and is_other else None
        if changes is not None:
            counts_text = ", ".join(
                f"{translate(f'verdict.{word}')} {count}" for word, count in changes.counts.items() if count
            )
            st.markdown(translate("limits.then", counts=counts_text or translate("limits.then.none")))
            if withdrawn := len(changes.withdrawn):
                label = translate("limits.set.withdrawing", what=label, count=withdrawn)
        reason = ask_reason(f"limit-{lot_id}-{version}", label, "set_limit")
        if reason is not None:
            st.session_state.pop(version_key)
            with show_refusals():
                change_limit(registry(), lot_id, rmse, reason=reason, actor=actor(), expected_version=version)
                withdraw_recalled_files(registry(), list_affected_lots(registry(), lot_id))
                finish("limit", translate("limits.done", limit=automatic if rmse is None else limit_number(rmse, unit)))
    if not rest_may_follow():
        return
    with right:
        figure_under("lot.distribution", charts_lot.predicted_errors(view, colours(), translate), "limit-distribution")
    if changes is not None and changes.changed:
        draw_changes(changes.changed)
    st.header(translate("limits.versions"))
    rows = [
        _row(entry, {translate("lot.limit"): limit_number(entry.rmse, unit) if entry.rmse else automatic})
        for entry in reversed(versions)
    ]
    table(rows, translate("limits.none"))
    st.header(translate("rules.title"))
    show_finished("rules")
    rules = registry().lots.line_rules_versions(lot_id)
    with st.container(border=True):
        _change_rules(view.lot, rules)
    rows = []
    for entry in reversed(rules):
        retests = ", ".join(
            f"{translate(f'verdict.{verdict}')} {times}" for verdict, times in entry.rules.retests.items()
        )
        values = {
            translate("rules.pattern"): entry.rules.serial_pattern or translate("rules.pattern.any"),
            translate("rules.letters"): _letters_label(entry.rules.letters),
            translate("rules.target"): entry.rules.target,
            translate("rules.badge"): translate("trail.yes" if entry.rules.is_badge_needed else "trail.no"),
            translate("rules.retests.column"): retests,
            translate("tab.known_loads"): ", ".join(map(str, entry.rules.loads)),
        }
        rows.append(_row(entry, values))
    table(rows, translate("rules.none"))


def _first_displayed_version(version_key: str, versions: Sequence[LimitEntry | LineRulesEntry]) -> int:
    """Return the version a person decides on: the one first drawn, whatever was written meanwhile."""
    return int(st.session_state.setdefault(version_key, versions[-1].version if versions else 0))


def _row(entry: LimitEntry | LineRulesEntry, values: Mapping[str, object]) -> dict[str, object]:
    return {
        translate("limits.version"): entry.version,
        **values,
        translate("column.made"): format_instant(entry.made_at),
        translate("column.actor"): entry.actor,
        translate("column.reason"): entry.reason,
    }


def _change_rules(lot: Lot, versions: Sequence[LineRulesEntry]) -> None:
    """Draw one field per rule with what holds now, and take the change."""
    version_key = f"rules-seen-{lot.id}"
    version = _first_displayed_version(version_key, versions)
    now, mark = registry().lots.line_rules(lot), f"{lot.id}-{version}"
    left, middle, right = st.columns([3, 2, 2])
    key, help_ = f"rules-pattern-{mark}", translate("rules.pattern.help")
    pattern = left.text_input(translate("rules.pattern"), now.serial_pattern, key=key, help=help_)
    index, key = LETTERS.index(now.letters), f"rules-letters-{mark}"
    letters = middle.selectbox(translate("rules.letters"), LETTERS, index, format_func=_letters_label, key=key)
    key, none = f"rules-target-{mark}", translate("rules.target.none")
    target = right.number_input(translate("rules.target"), 1, MAX_UNITS, now.target, key=key, placeholder=none)
    needs_badge = st.toggle(translate("rules.badge"), now.is_badge_needed, key=f"rules-badge-{mark}")
    st.markdown(translate("rules.retests"))
    retests: dict[str, int] = {}
    for verdict, column in zip(VERDICTS, st.columns(len(VERDICTS)), strict=True):
        label, default = translate(f"verdict.{verdict}"), now.retests.get(verdict, 0)
        retests[verdict] = int(column.number_input(label, 0, MAX_RETESTS, default, key=f"rules-{verdict}-{mark}"))

    st.markdown(translate("rules.loads"), help=translate("rules.loads.help"))
    # Each load is (load, U) in the lot's unit.
    unit, loads = lot.reference_unit, []
    cells = st.columns(2 * MAX_LOADS)
    for position, (cell, uncertainty_cell) in enumerate(zip(cells[::2], cells[1::2], strict=True), 1):
        load = now.loads[position - 1] if position <= len(now.loads) else None
        label, key = f"{translate('rules.load', number=position)} [{unit}]", f"rules-load-{position}-{mark}"
        value = cell.number_input(label, 0.0, value=load.value if load else None, format="%.5g", key=key)
        label, key = f"{translate('rules.load_uncertainty')} [{unit}]", f"rules-load-u-{position}-{mark}"
        expanded = uncertainty_cell.number_input(
            label, 0.0, value=load.expanded if load else None, format="%.5g", key=key
        )
        if value is not None:
            loads.append((float(value), None if expanded is None else float(expanded)))

    reason = ask_reason(f"rules-{mark}", translate("rules.set"), "set_limit")
    if reason is None:
        return
    st.session_state.pop(version_key)
    with show_refusals():
        known_loads = tuple(KnownLoad(*load) for load in loads)
        rules = LineRules(str(pattern).strip(), letters, target, retests, known_loads, needs_badge)
        state = registry().networks.released(lot.id)
        if state is not None and rules.loads:
            check_declared_loads(rules.loads, source_recording(registry(), state.network.id), Method().map.anchors)
        registry().lots.set_line_rules(lot.id, rules, reason=reason, actor=actor(), expected_version=version)
        finish("rules", translate("rules.done"))


def _letters_label(letters: str) -> str:
    return translate(f"rules.letters.{letters.replace(' ', '_')}")
