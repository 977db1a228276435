"""The tabs of the settings: who is here, people, what certificates say, the audit trail."""

from dataclasses import fields, replace
from datetime import UTC, date, datetime, time
from functools import partial
from typing import Any

import streamlit as st

from softcal.app.export import laboratory
from softcal.app.ui.account import actor, permit, person
from softcal.app.ui.actions import ask_reason, csv_of, download, finish, role_allows, show_finished, show_refusals
from softcal.app.ui.components.sign_in import sign_in_panel
from softcal.app.ui.panels import rest_may_follow, table, table_to_choose
from softcal.app.ui.pins import check_pin
from softcal.app.ui.presentation import (
    choose_language,
    empty,
    format_instant,
    in_one_language,
    label_formatter,
    translate,
    zone,
)
from softcal.app.ui.server_cache import registry
from softcal.app.views.audit_trail import HEADINGS, Entry, TrailFilter, trail
from softcal.db.entries import ROLES, User


def draw_account() -> None:
    """Draw who is here, and the language of the screens."""
    _, middle, _ = st.columns([1, 2, 1])
    with middle:
        choose_language()
    sign_in_panel()


NEW_PERSON = User("", "operator", True, 0)


def draw_people() -> None:
    """Draw people, their roles and PINs; every change asks for a reason."""
    people = registry().people.all()
    show_finished("people")
    if st.session_state.pop("people-parted", False):
        st.info(translate("people.parted", role=translate(f"role.{person().role}")), icon=":material/group_add:")
    left, right = st.columns([3, 2])
    with left:
        table(
            {
                translate("sign_in.name"): user.name,
                translate("people.role"): translate(f"role.{user.role}"),
                translate("column.state"): translate("people.active" if user.is_active else "people.inactive"),
            }
            for user in people
        )
        for role in ROLES:
            st.caption(f"**{translate(f'role.{role}')}** · {translate(f'role.{role}.may')}")
        if person().is_alone:
            st.caption(translate("role.alone.may"))
    if not rest_may_follow():
        return
    with right, st.container(border=True):
        by_name = {user.name: user for user in people}
        chosen = st.selectbox(
            translate("people.who"), ["", *by_name], format_func=lambda name: name or translate("people.new")
        )
        user = by_name.get(chosen, NEW_PERSON)
        # Keys carry the version, so that the fields show what is stored after each change.
        mark = f"{user.name}-{user.version}"
        name = user.name or str(st.text_input(translate("sign_in.name"), key=f"people-name-{mark}")).strip()
        # The first account decides about all others: of another role nobody could.
        roles = ROLES if people else ("quality",)
        index = roles.index(user.role) if people else 0
        role = st.selectbox(translate("people.role"), roles, index, label_formatter("role"), key=f"people-role-{mark}")
        is_active = st.checkbox(translate("people.may_sign_in"), user.is_active, key=f"people-active-{mark}")
        pin = again = ""

        def pins() -> None:
            nonlocal pin, again
            secret: dict[str, Any] = {"type": "password", "autocomplete": "new-password"}
            label = translate("sign_in.new_pin") if user is NEW_PERSON else translate("people.pin")
            pin = st.text_input(label, key=f"people-pin-{mark}", **secret)
            again = st.text_input(translate("sign_in.pin_again"), key=f"people-again-{mark}", **secret)

        reason = ask_reason(f"people-{mark}", translate("people.save"), "people", pins)
        if reason is None:
            return
        was_alone = person().is_alone
        with show_refusals():
            if pin:
                check_pin(pin, again)
            registry().people.set(
                name, role, pin or None, actor=actor(), reason=reason, is_active=is_active, version=user.version
            )
            st.session_state["people-parted"] = was_alone and not person().is_alone
            finish("people", translate("people.saved", name=name))


SECTIONS = {"laboratory": laboratory.Party, "customer": laboratory.Party, "person": laboratory.Person}


def draw_laboratory() -> None:
    """Draw laboratory, customer, responsible person, conditions and load cell."""
    st.header(translate("laboratory.title"))
    show_finished("laboratory")
    st.caption(translate("laboratory.how"))
    stored = laboratory.registry_laboratory(registry())
    if not role_allows("set_up"):
        return
    cells = {entry.cell_serial: entry for entry in registry().stations.certificates()}
    values_by_part: dict[str, dict[str, str]] = {}
    with st.form("laboratory", border=False):
        for name in SECTIONS:
            st.markdown(f"**{translate(f'laboratory.{name}')}**")
            part, values_by_part[name] = getattr(stored, name), {}
            names = [field.name for field in fields(part)]
            for column, field in zip(st.columns(len(names), vertical_alignment="bottom"), names, strict=True):
                value = str(getattr(part, field))
                text = "" if value in (laboratory.NOT_STATED, laboratory.NO_COUNTRY) else value
                label, key = translate(f"laboratory.{field}"), f"laboratory-{name}-{field}"
                unset_value = laboratory.NO_COUNTRY if field == "country" else laboratory.NOT_STATED
                values_by_part[name][field] = str(column.text_input(label, text, key=key)).strip() or unset_value

        st.markdown(f"**{translate('laboratory.conditions')}**")
        left, right, _, _ = st.columns(4)
        label, conditions = f"{translate('laboratory.temperature')} [°C]", stored.conditions
        temperature_C = left.number_input(label, -50.0, 150.0, conditions.temperature_C, format="%.1f")
        label = f"{translate('laboratory.humidity')} [%]"
        humidity_pct = right.number_input(label, 0.0, 100.0, conditions.humidity_pct, format="%.0f")

        st.markdown(f"**{translate('laboratory.load_cell')}**")
        load_cell = stored.load_cell
        options = [load_cell.serial, *(serial for serial in cells if serial != load_cell.serial)]
        unstated = {laboratory.NOT_STATED: translate("laboratory.not_stated")}
        left, _ = st.columns(2)
        chosen = str(
            left.selectbox(translate("cells.serial"), options, 0, lambda one: unstated.get(one, one), "laboratory-cell")
        )
        if chosen == load_cell.serial and load_cell.due_on is not None:
            st.caption(translate("laboratory.due", due=f"{load_cell.due_on}"))
        if not st.form_submit_button(translate("laboratory.save"), type="primary"):
            return
    permit("set_up")
    with show_refusals():
        changed_parts: dict[str, Any] = {name: SECTIONS[name](**values) for name, values in values_by_part.items()}
        changed_parts["conditions"] = replace(conditions, temperature_C=temperature_C, humidity_pct=humidity_pct)
        if entry := cells.get(chosen):
            same = ("laboratory", "issued_on", "due_on", "uncertainty_N")
            certificate_fields = {name: getattr(entry, name) for name in same}
            changed_parts["load_cell"] = laboratory.LoadCell(
                serial=entry.cell_serial, certificate=entry.number, **certificate_fields
            )
        laboratory.store_laboratory(registry(), replace(stored, **changed_parts), actor())
        finish("laboratory", translate("laboratory.saved"))


NEWEST, PAGE = 5000, 200


def draw_audit_trail() -> None:
    """Draw who did what and why, newest first: filtered, searched, taken along."""
    is_complete = bool(st.session_state.get("trail-whole"))
    rows = registry().trail.newest(10**9 if is_complete else NEWEST)
    if not rows:
        empty("audit.none", translate("empty.lots.how"))
        return
    entries = trail(rows, translate)
    first, second, third, fourth, fifth = st.columns([2, 2, 2, 3, 3])
    text = str(first.text_input(translate("trail.find"), key="trail-find", icon=":material/search:") or "")
    all_actors, unset = sorted({entry.row.actor for entry in entries}), translate("choose.all")
    actors = second.multiselect(translate("column.actor"), all_actors, key="trail-actor", placeholder=unset)
    sections = third.multiselect(
        translate("trail.section"),
        HEADINGS,
        format_func=label_formatter("trail.section"),
        key="trail-section",
        placeholder=unset,
    )
    since = _midnight(fourth.date_input(translate("trail.since"), value=None, key="trail-since"), time.min)
    until = _midnight(fifth.date_input(translate("trail.until"), value=None, key="trail-until"), time.max)
    trail_filter = TrailFilter(text, tuple(actors), tuple(sections), since, until)

    matches = [entry for entry in entries if trail_filter.takes(entry)]
    st.caption(translate("trail.count", shown=min(len(matches), PAGE), found=len(matches), of=len(entries)))
    if len(entries) >= NEWEST and not is_complete:
        st.toggle(translate("trail.whole", newest=NEWEST), key="trail-whole")
    if not matches:
        st.caption(translate("trail.none"))
        return
    chosen = table_to_choose([_row(entry) for entry in matches[:PAGE]], "trail")
    exported = ("audit_trail", ("audit_trail",), {"rows": len(matches)})
    download(translate("trail.export"), "audit-trail.csv", partial(_csv, matches), "trail-export", exported=exported)
    if chosen is None:
        return
    # The row as it is kept: for who checks the chain itself.
    row = matches[chosen].row
    with st.container(border=True):
        st.markdown(f"**{translate('trail.row')}**")
        st.code(
            f"{row.origin} #{row.seq}  {row.action} {row.entity} {row.key}\n"
            f"before: {row.before or '–'}\nafter:  {row.after or '–'}\n"
            f"hash: {row.hash}\nafter the row with: {row.prev_hash}",
            language=None,
            wrap_lines=True,
        )


def _midnight(day: date | None, at: time) -> datetime | None:
    return None if day is None else datetime.combine(day, at, zone()).astimezone(UTC)


def _row(entry: Entry) -> dict[str, object]:
    return {
        translate("column.made"): format_instant(entry.row.at),
        translate("column.actor"): entry.row.actor,
        translate("trail.what"): entry.action_text,
        translate("trail.changes"): entry.changes_text,
        translate("column.reason"): entry.row.reason,
    }


def _csv(entries: list[Entry]) -> bytes:
    with in_one_language():
        return csv_of([_row(entry) for entry in entries])
