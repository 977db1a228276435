"""The tabs of the settings: who is here, people, what certificates say, the audit trail."""

from dataclasses import fields, replace
from datetime import UTC, date, datetime, time
from functools import partial
from typing import Any

import streamlit as st

from softcal.app.export.certificates import laboratory
from softcal.app.ui.account import actor, permit, person
from softcal.app.ui.actions import ask_reason, csv_of, download, finish, refusals_in_words, role_allows, say_finished
from softcal.app.ui.components.sign_in import sign_in_panel
from softcal.app.ui.desk import choose_language, empty, in_one_language, instant, named, say, zone
from softcal.app.ui.panels import rest_may_follow, table, table_to_choose
from softcal.app.ui.pins import check_pin
from softcal.app.ui.server_memory import registry
from softcal.app.views.audit_trail import HEADINGS, Entry, TrailFilter, trail
from softcal.db.entries import ROLES, User


def draw_account() -> None:
    """Draw who is here, and the language of the screens."""
    _, middle, _ = st.columns([1, 2, 1])
    with middle:
        choose_language()
    sign_in_panel()


NEW = User("", "operator", True, 0)


def draw_people() -> None:
    """Draw people, their roles and PINs; every change asks for a reason."""
    people = registry().people.all()
    say_finished("people")
    if st.session_state.pop("people-parted", False):
        st.info(say("people.parted", role=say(f"role.{person().role}")), icon=":material/group_add:")
    left, right = st.columns([3, 2])
    with left:
        table(
            {
                say("sign_in.name"): user.name,
                say("people.role"): say(f"role.{user.role}"),
                say("column.state"): say("people.active" if user.is_active else "people.inactive"),
            }
            for user in people
        )
        for role in ROLES:
            st.caption(f"**{say(f'role.{role}')}** · {say(f'role.{role}.may')}")
        if person().is_alone:
            st.caption(say("role.alone.may"))
    if not rest_may_follow():
        return
    with right, st.container(border=True):
        known = {user.name: user for user in people}
        chosen = st.selectbox(say("people.who"), ["", *known], format_func=lambda name: name or say("people.new"))
        user = known.get(chosen, NEW)
        # Keys carry the version, so that the fields show what is stored after each change.
        mark = f"{user.name}-{user.version}"
        name = user.name or str(st.text_input(say("sign_in.name"), key=f"people-name-{mark}")).strip()
        # The first account decides about all others: of another role nobody could.
        roles = ROLES if people else ("quality",)
        index = roles.index(user.role) if people else 0
        role = st.selectbox(say("people.role"), roles, index, named("role"), key=f"people-role-{mark}")
        is_active = st.checkbox(say("people.may_sign_in"), user.is_active, key=f"people-active-{mark}")
        pin = again = ""

        def pins() -> None:
            nonlocal pin, again
            secret: dict[str, Any] = {"type": "password", "autocomplete": "new-password"}
            label = say("sign_in.new_pin") if user is NEW else say("people.pin")
            pin = st.text_input(label, key=f"people-pin-{mark}", **secret)
            again = st.text_input(say("sign_in.pin_again"), key=f"people-again-{mark}", **secret)

        reason = ask_reason(f"people-{mark}", say("people.save"), "people", pins)
        if reason is None:
            return
        was_alone = person().is_alone
        with refusals_in_words():
            if pin:
                check_pin(pin, again)
            registry().people.set(
                name, role, pin or None, actor=actor(), reason=reason, is_active=is_active, version=user.version
            )
            st.session_state["people-parted"] = was_alone and not person().is_alone
            finish("people", say("people.saved", name=name))


PARTS = {"laboratory": laboratory.Party, "customer": laboratory.Party, "person": laboratory.Person}


def draw_laboratory() -> None:
    """Draw laboratory, customer, responsible person, conditions and load cell."""
    st.header(say("laboratory.title"))
    say_finished("laboratory")
    st.caption(say("laboratory.how"))
    kept = laboratory.registry_laboratory(registry())
    if not role_allows("set_up"):
        return
    cells = {entry.cell_serial: entry for entry in registry().stations.certificates()}
    given: dict[str, dict[str, str]] = {}
    with st.form("laboratory", border=False):
        for name in PARTS:
            st.markdown(f"**{say(f'laboratory.{name}')}**")
            part, given[name] = getattr(kept, name), {}
            names = [field.name for field in fields(part)]
            for column, field in zip(st.columns(len(names)), names, strict=True):
                value = str(getattr(part, field))
                shown = "" if value in (laboratory.NOT_STATED, laboratory.NO_COUNTRY) else value
                label, key = say(f"laboratory.{field}"), f"laboratory-{name}-{field}"
                nothing = laboratory.NO_COUNTRY if field == "country" else laboratory.NOT_STATED
                given[name][field] = str(column.text_input(label, shown, key=key)).strip() or nothing

        st.markdown(f"**{say('laboratory.conditions')}**")
        left, right, _, _ = st.columns(4)
        label, usual = f"{say('laboratory.temperature')} [°C]", kept.conditions
        temperature_C = left.number_input(label, -50.0, 150.0, usual.temperature_C, format="%.1f")
        label = f"{say('laboratory.humidity')} [%]"
        humidity_pct = right.number_input(label, 0.0, 100.0, usual.humidity_pct, format="%.0f")

        st.markdown(f"**{say('laboratory.load_cell')}**")
        load_cell = kept.load_cell
        options = [load_cell.serial, *(serial for serial in cells if serial != load_cell.serial)]
        unstated = {laboratory.NOT_STATED: say("laboratory.not_stated")}
        left, _ = st.columns(2)
        chosen = str(
            left.selectbox(say("cells.serial"), options, 0, lambda one: unstated.get(one, one), "laboratory-cell")
        )
        if chosen == load_cell.serial and load_cell.due_on is not None:
            st.caption(say("laboratory.due", due=f"{load_cell.due_on}"))
        if not st.form_submit_button(say("laboratory.save"), type="primary"):
            return
    permit("set_up")
    with refusals_in_words():
        changed: dict[str, Any] = {name: PARTS[name](**values) for name, values in given.items()}
        changed["conditions"] = replace(usual, temperature_C=temperature_C, humidity_pct=humidity_pct)
        if entry := cells.get(chosen):
            same = ("laboratory", "issued_on", "due_on", "uncertainty_N")
            facts = {name: getattr(entry, name) for name in same}
            changed["load_cell"] = laboratory.LoadCell(serial=entry.cell_serial, certificate=entry.number, **facts)
        laboratory.store_laboratory(registry(), replace(kept, **changed), actor())
        finish("laboratory", say("laboratory.saved"))


NEWEST, PAGE = 5000, 200


def draw_audit_trail() -> None:
    """Draw who did what and why, newest first: filtered, searched, taken along."""
    is_whole = bool(st.session_state.get("trail-whole"))
    rows = registry().trail.newest(10**9 if is_whole else NEWEST)
    if not rows:
        empty("audit.none", say("empty.lots.how"))
        return
    entries = trail(rows, say)
    first, second, third, fourth, fifth = st.columns([3, 2, 3, 2, 2])
    text = str(first.text_input(say("trail.find"), key="trail-find", icon=":material/search:") or "")
    everybody, unset = sorted({entry.row.actor for entry in entries}), say("choose.all")
    actors = second.multiselect(say("column.actor"), everybody, key="trail-actor", placeholder=unset)
    sections = third.multiselect(
        say("trail.section"), HEADINGS, format_func=named("trail.section"), key="trail-section", placeholder=unset
    )
    since = _midnight(fourth.date_input(say("trail.since"), value=None, key="trail-since"), time.min)
    until = _midnight(fifth.date_input(say("trail.until"), value=None, key="trail-until"), time.max)
    wanted = TrailFilter(text, tuple(actors), tuple(sections), since, until)

    found = [entry for entry in entries if wanted.takes(entry)]
    st.caption(say("trail.count", shown=min(len(found), PAGE), found=len(found), of=len(entries)))
    if len(entries) >= NEWEST and not is_whole:
        st.toggle(say("trail.whole", newest=NEWEST), key="trail-whole")
    if not found:
        st.caption(say("trail.none"))
        return
    chosen = table_to_choose([_row(entry) for entry in found[:PAGE]], "trail")
    exported = ("audit_trail", ("audit_trail",), {"rows": len(found)})
    download(say("trail.export"), "audit-trail.csv", partial(_csv, found), "trail-export", exported=exported)
    if chosen is None:
        return
    # The row as it is kept: for who checks the chain itself.
    row = found[chosen].row
    with st.container(border=True):
        st.markdown(f"**{say('trail.row')}**")
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
        say("column.made"): instant(entry.row.at),
        say("column.actor"): entry.row.actor,
        say("trail.what"): entry.what,
        say("trail.changes"): entry.changed,
        say("column.reason"): entry.row.reason,
    }


def _csv(found: list[Entry]) -> bytes:
    with in_one_language():
        return csv_of([_row(entry) for entry in found])
