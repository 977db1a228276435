"""The limit and the rules of a lot in versions, and what another limit would do."""

from collections.abc import Mapping, Sequence

import streamlit as st

from softcal.app.calibration.changes import change_limit, reached_lots
from softcal.app.charts import lot as charts_lot
from softcal.app.export.export import withdraw_given
from softcal.app.line.load_readings import check_stated
from softcal.app.registry.lot_recordings import source_recording
from softcal.app.ui.account import actor, allows
from softcal.app.ui.actions import ask_reason, finish, refusals_in_words, say_finished
from softcal.app.ui.components.verdict_changes import draw_changes
from softcal.app.ui.desk import colours, instant, say
from softcal.app.ui.panels import figure_under, headline, rest_may_follow, table
from softcal.app.ui.server_memory import registry, remembered_limit_changes, remembered_lot_view
from softcal.app.views.common import limit_said, number
from softcal.core.lot import Lot
from softcal.core.quality.known_loads import MOST_LOADS, KnownLoad
from softcal.core.quality.line_rules import LETTERS, LineRules
from softcal.core.unit.method import Method
from softcal.core.unit.verdict import VERDICTS
from softcal.db.entries import LimitEntry, LineRulesEntry

MOST_UNITS, MOST_RETESTS = 10_000_000, 99


def draw_limits(lot_id: str) -> None:
    say_finished("limit")
    view, versions = remembered_lot_view(lot_id), registry().lots.limit_versions(lot_id)
    unit, looked_at, automatic = view.lot.reference_unit, f"limit-seen-{lot_id}", say("lot.limit.none")
    left, right = st.columns(2)
    with left, st.container(border=True):
        version = _seen(looked_at, versions)
        newest = versions[-1].version if versions else 0
        headline(say("limits.now", limit=limit_said(view.limit, say), version=newest))
        is_automatic = st.toggle(say("limits.auto"), view.lot.limit_rmse is None, key=f"auto-{lot_id}-{version}")
        usual = float(view.limit_rmse or view.median_predicted or 1.0)
        label, step, key = f"{say('limits.new')} [{unit}]", float(f"{usual / 10:.1g}"), f"limit-{lot_id}-{version}"
        wanted = st.number_input(label, 0.0, None, usual, step, "%.4g", key, disabled=is_automatic)
        rmse = None if is_automatic else wanted
        label = say("limits.withdraw") if rmse is None else say("limits.set", limit=f"{rmse:g} {unit}")
        # By the very decision that would be made; the limit in force changes nothing.
        is_other = rmse not in (0, view.lot.limit_rmse)
        changes = remembered_limit_changes(lot_id, rmse) if allows("set_limit") and is_other else None
        if changes is not None:
            words = ", ".join(f"{say(f'verdict.{word}')} {count}" for word, count in changes.counts.items() if count)
            st.markdown(say("limits.then", counts=words or say("limits.then.none")))
            if withdrawn := len(changes.withdrawn):
                label = say("limits.set.withdrawing", what=label, count=withdrawn)
        reason = ask_reason(f"limit-{lot_id}-{version}", label, "set_limit")
        if reason is not None:
            st.session_state.pop(looked_at)
            with refusals_in_words():
                change_limit(registry(), lot_id, rmse, reason=reason, actor=actor(), expected_version=version)
                withdraw_given(registry(), reached_lots(registry(), lot_id))
                finish("limit", say("limits.done", limit=automatic if rmse is None else f"{rmse:g}"))
    if not rest_may_follow():
        return
    with right:
        figure_under("lot.distribution", charts_lot.predicted_errors(view, colours(), say), "limit-distribution")
    if changes is not None and changes.changed:
        draw_changes(changes.changed)
    st.header(say("limits.versions"))
    rows = [
        _row(entry, {say("lot.limit"): number(entry.rmse, unit, entry.rmse) if entry.rmse else automatic})
        for entry in reversed(versions)
    ]
    table(rows, say("limits.none"))
    st.header(say("rules.title"))
    say_finished("rules")
    rules = registry().lots.line_rules_versions(lot_id)
    with st.container(border=True):
        _change_rules(view.lot, rules)
    rows = []
    for entry in reversed(rules):
        retests = ", ".join(f"{say(f'verdict.{verdict}')} {times}" for verdict, times in entry.rules.retests.items())
        facts = {
            say("rules.pattern"): entry.rules.serial_pattern or say("rules.pattern.any"),
            say("rules.letters"): _letters_said(entry.rules.letters),
            say("rules.target"): entry.rules.target,
            say("rules.badge"): say("trail.yes" if entry.rules.is_badge_needed else "trail.no"),
            say("rules.retests.column"): retests,
            say("tab.known_loads"): ", ".join(map(str, entry.rules.loads)),
        }
        rows.append(_row(entry, facts))
    table(rows, say("rules.none"))


def _seen(looked_at: str, versions: Sequence[LimitEntry | LineRulesEntry]) -> int:
    """Return the version a person decides on: the one first drawn, whatever was written meanwhile."""
    return int(st.session_state.setdefault(looked_at, versions[-1].version if versions else 0))


def _row(entry: LimitEntry | LineRulesEntry, facts: Mapping[str, object]) -> dict[str, object]:
    return {
        say("limits.version"): entry.version,
        **facts,
        say("column.made"): instant(entry.made_at),
        say("column.actor"): entry.actor,
        say("column.reason"): entry.reason,
    }


def _change_rules(lot: Lot, versions: Sequence[LineRulesEntry]) -> None:
    """Draw one field per rule with what holds now, and take the change."""
    looked_at = f"rules-seen-{lot.id}"
    version = _seen(looked_at, versions)
    now, mark = registry().lots.line_rules(lot), f"{lot.id}-{version}"
    left, middle, right = st.columns([3, 2, 2])
    key, help_ = f"rules-pattern-{mark}", say("rules.pattern.help")
    pattern = left.text_input(say("rules.pattern"), now.serial_pattern, key=key, help=help_)
    index, key = LETTERS.index(now.letters), f"rules-letters-{mark}"
    letters = middle.selectbox(say("rules.letters"), LETTERS, index, format_func=_letters_said, key=key)
    key, none = f"rules-target-{mark}", say("rules.target.none")
    target = right.number_input(say("rules.target"), 1, MOST_UNITS, now.target, key=key, placeholder=none)
    needs_badge = st.toggle(say("rules.badge"), now.is_badge_needed, key=f"rules-badge-{mark}")
    st.markdown(say("rules.retests"))
    retests: dict[str, int] = {}
    for verdict, column in zip(VERDICTS, st.columns(len(VERDICTS)), strict=True):
        label, usual = say(f"verdict.{verdict}"), now.retests.get(verdict, 0)
        retests[verdict] = int(column.number_input(label, 0, MOST_RETESTS, usual, key=f"rules-{verdict}-{mark}"))

    st.markdown(say("rules.loads"), help=say("rules.loads.help"))
    # Each load is (load, U) in the lot's unit.
    unit, loads = lot.reference_unit, []
    cells = st.columns(2 * MOST_LOADS)
    for place, (cell, beside) in enumerate(zip(cells[::2], cells[1::2], strict=True), 1):
        load = now.loads[place - 1] if place <= len(now.loads) else None
        label, key = f"{say('rules.load', number=place)} [{unit}]", f"rules-load-{place}-{mark}"
        value = cell.number_input(label, 0.0, value=load.value if load else None, format="%.5g", key=key)
        label, key = f"{say('rules.load_uncertainty')} [{unit}]", f"rules-load-u-{place}-{mark}"
        expanded = beside.number_input(label, 0.0, value=load.expanded if load else None, format="%.5g", key=key)
        if value is not None:
            loads.append((float(value), None if expanded is None else float(expanded)))

    reason = ask_reason(f"rules-{mark}", say("rules.set"), "set_limit")
    if reason is None:
        return
    st.session_state.pop(looked_at)
    with refusals_in_words():
        known = tuple(KnownLoad(*load) for load in loads)
        rules = LineRules(str(pattern).strip(), letters, target, retests, known, needs_badge)
        state = registry().networks.released(lot.id)
        if state is not None and rules.loads:
            check_stated(rules.loads, source_recording(registry(), state.network.id), Method().map.anchors)
        registry().lots.set_line_rules(lot.id, rules, reason=reason, actor=actor(), expected_version=version)
        finish("rules", say("rules.done"))


def _letters_said(letters: str) -> str:
    return say(f"rules.letters.{letters.replace(' ', '_')}")
