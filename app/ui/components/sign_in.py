"""Sign in by PIN or company account; the first person of a registry; the way out."""

from html import escape
from typing import Any, Literal

import streamlit as st

from softcal.app.ui import account
from softcal.app.ui.actions import refusals_in_words
from softcal.app.ui.callbacks import in_one_piece
from softcal.app.ui.desk import say
from softcal.app.ui.pins import check_pin
from softcal.app.ui.server_memory import registry
from softcal.db.access.people import PERMISSIONS
from softcal.db.entries import ROLES


def ask_sign_in(actions: tuple[str, ...]) -> None:
    """Say which role may see this, and ask for it; once somebody of that role is here, it is drawn."""
    roles = [say(f"role.{role}") for role in ROLES if PERMISSIONS[role] & set(actions)]
    st.info(say("sign_in.needed", roles=" / ".join(roles)), icon=":material/lock:")
    sign_in_panel()


def sign_in_panel() -> None:
    """Draw who is here and the way out, or the way in."""
    _, middle, _ = st.columns([1, 2, 1])
    with middle:
        if account.is_signed_in():
            _who(account.person().name)
            st.markdown(say("sign_in.role", role=say(f"role.{account.person().role}")))
            st.caption(say("role.alone.may" if account.person().is_alone else f"role.{account.person().role}.may"))
            _leave()
        elif account.is_open_here():
            _who(account.person().name)
            st.caption(say("sign_in.open"))
        elif company := account.account_without_role():
            _who(company)
            st.warning(say("sign_in.no_role", claim=account.role_claim()), icon=":material/no_accounts:")
            _leave()
        elif not (is_known := bool(registry().people.all())) and not account.has_company_accounts():
            _first_person()
        else:
            st.title(say("sign_in"))
            st.caption(say("sign_in.why" if is_known else "sign_in.why.company"))
            if is_known:
                with st.form("sign-in"):
                    name = st.text_input(say("sign_in.name"), key="sign-in-name", autocomplete="username")
                    secret: dict[str, Any] = {"type": "password", "autocomplete": "current-password"}
                    pin = st.text_input(say("sign_in.pin"), key="sign-in-pin", **secret)
                    is_sent = st.form_submit_button(say("sign_in"), type="primary", width="stretch")
                if is_sent:
                    with refusals_in_words(icon="lock"):
                        account.sign_in(name, pin)
                        st.rerun()
            if account.has_company_accounts():
                kind: Literal["primary", "secondary"] = "secondary" if is_known else "primary"
                icon = ":material/badge:"
                st.button(say("sign_in.company"), on_click=st.login, type=kind, width="stretch", icon=icon)


def _who(name: str) -> None:
    # As HTML: Markdown would make a link of an address.
    st.html(f"<h1>{escape(name)}</h1>")


def _leave() -> None:
    # A callback: a rerun after it would throw away the order to go to the provider.
    leave = in_one_piece(account.sign_out)
    st.button(say("sign_in.leave"), on_click=leave, icon=":material/logout:", type="primary", width="stretch")


def _first_person() -> None:
    account.first_code()
    st.title(say("sign_in.first"))
    st.caption(say("sign_in.first.why"))
    with st.form("first-person"):
        code = st.text_input(say("sign_in.first.code"), key="first-code", autocomplete="off")
        name = st.text_input(say("sign_in.name"), key="first-name").strip()
        pin = st.text_input(say("sign_in.new_pin"), key="first-pin", type="password", autocomplete="new-password")
        again = st.text_input(say("sign_in.pin_again"), key="first-again", type="password", autocomplete="new-password")
        if not st.form_submit_button(say("sign_in.first.enter"), type="primary", width="stretch"):
            return
    with refusals_in_words():
        check_pin(pin, again)
        account.make_first_account(name, pin, code)
        st.rerun()
