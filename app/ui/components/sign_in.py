"""Sign in by PIN or company account; the first person of a registry; the way out."""

from html import escape
from typing import Any, Literal

import streamlit as st

from softcal.app.ui import account
from softcal.app.ui.actions import show_refusals
from softcal.app.ui.callbacks import run_uninterrupted
from softcal.app.ui.pins import check_pin
from softcal.app.ui.presentation import translate
from softcal.app.ui.server_cache import registry
from softcal.db.access.people import PERMISSIONS
from softcal.db.entries import ROLES


def ask_sign_in(actions: tuple[str, ...]) -> None:
    """Say which role may see this, and ask for it; once somebody of that role is here, it is drawn."""
    roles = [translate(f"role.{role}") for role in ROLES if PERMISSIONS[role] & set(actions)]
    st.info(translate("sign_in.needed", roles=" / ".join(roles)), icon=":material/lock:")
    sign_in_panel()


def sign_in_panel() -> None:
    """Draw who is here and the way out, or the way in."""
    _, middle, _ = st.columns([1, 2, 1])
    with middle:
        if account.is_signed_in():
            _draw_name(account.person().name)
            st.markdown(translate("sign_in.role", role=translate(f"role.{account.person().role}")))
            st.caption(
                translate("role.alone.may" if account.person().is_alone else f"role.{account.person().role}.may")
            )
            _draw_sign_out()
        elif account.is_open_without_account():
            _draw_name(account.person().name)
            st.caption(translate("sign_in.open"))
        elif company := account.account_without_role():
            _draw_name(company)
            st.warning(translate("sign_in.no_role", claim=account.role_claim()), icon=":material/no_accounts:")
            _draw_sign_out()
        elif not (has_people := bool(registry().people.all())) and not account.has_company_accounts():
            _first_person()
        else:
            st.title(translate("sign_in"))
            st.caption(translate("sign_in.why" if has_people else "sign_in.why.company"))
            if has_people:
                with st.form("sign-in"):
                    name = st.text_input(translate("sign_in.name"), key="sign-in-name", autocomplete="username")
                    secret: dict[str, Any] = {"type": "password", "autocomplete": "current-password"}
                    pin = st.text_input(translate("sign_in.pin"), key="sign-in-pin", **secret)
                    is_sent = st.form_submit_button(translate("sign_in"), type="primary", width="stretch")
                if is_sent:
                    with show_refusals(icon="lock"):
                        account.sign_in(name, pin)
                        st.rerun()
            if account.has_company_accounts():
                kind: Literal["primary", "secondary"] = "secondary" if has_people else "primary"
                icon = ":material/badge:"
                st.button(translate("sign_in.company"), on_click=st.login, type=kind, width="stretch", icon=icon)


def _draw_name(name: str) -> None:
    # As HTML: Markdown would make a link of an address.
    st.html(f"<h1>{escape(name)}</h1>")


def _draw_sign_out() -> None:
    # A callback: a rerun after it would throw away the order to go to the provider.
    leave = run_uninterrupted(account.sign_out)
    st.button(translate("sign_in.leave"), on_click=leave, icon=":material/logout:", type="primary", width="stretch")


def _first_person() -> None:
    account.first_code()
    st.title(translate("sign_in.first"))
    st.caption(translate("sign_in.first.why"))
    with st.form("first-person"):
        code = st.text_input(translate("sign_in.first.code"), key="first-code", autocomplete="off")
        name = st.text_input(translate("sign_in.name"), key="first-name").strip()
        pin = st.text_input(translate("sign_in.new_pin"), key="first-pin", type="password", autocomplete="new-password")
        again = st.text_input(
            translate("sign_in.pin_again"), key="first-again", type="password", autocomplete="new-password"
        )
        if not st.form_submit_button(translate("sign_in.first.enter"), type="primary", width="stretch"):
            return
    with show_refusals():
        check_pin(pin, again)
        account.make_first_account(name, pin, code)
        st.rerun()
