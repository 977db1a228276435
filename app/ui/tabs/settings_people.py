"""Who may do what: people, their roles and PINs; every change asks for a reason."""

from typing import Any

import streamlit as st

from softcal.app.ui.account import actor, person
from softcal.app.ui.actions import ask_reason, finish, refusals_in_words, say_finished
from softcal.app.ui.desk import named, say
from softcal.app.ui.panels import rest_may_follow, table
from softcal.app.ui.pins import check_pin
from softcal.app.ui.server_memory import registry
from softcal.db.entries import ROLES, User

NEW = User("", "operator", True, 0)


def draw() -> None:
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
