"""Sign in by PIN or company account; the first person of a registry; the language; and the way out."""

import streamlit as st

from softcal.app.desk import choose_language, in_words, registry, words
from softcal.app.identity import has_company_accounts, is_signed_in, person, sign_in, sign_out
from softcal.core.errors import InputError


def render() -> None:
    """Draw the page."""
    say = words()
    _, middle, _ = st.columns([1, 2, 1])
    with middle:
        choose_language()
        if is_signed_in():
            _leave()
        elif registry().users():
            st.title(say("sign_in.title"))
            st.caption(say("sign_in.why"))
            _by_pin()
        else:
            _first_person()
        if has_company_accounts() and not is_signed_in():
            st.button(say("sign_in.company"), on_click=st.login, width="stretch", icon=":material/badge:")


def _leave() -> None:
    say = words()
    st.title(person().name)
    st.markdown(say("sign_in.role", role=say(f"role.{person().role}")))
    st.caption(say(f"role.{person().role}.may"))
    if st.button(say("sign_in.leave"), icon=":material/logout:", type="primary", width="stretch"):
        sign_out()
        st.rerun()


def _by_pin() -> None:
    say = words()
    with st.form("sign-in"):
        name = st.text_input(say("sign_in.name"), key="sign-in-name", autocomplete="username")
        pin = st.text_input(say("sign_in.pin"), key="sign-in-pin", type="password", autocomplete="current-password")
        if not st.form_submit_button(say("sign_in.enter"), type="primary", width="stretch"):
            return
    try:
        sign_in(name, pin)
    except InputError as error:
        st.error(in_words(error), icon=":material/lock:")
    else:
        st.rerun()


def _first_person() -> None:
    say = words()
    st.title(say("sign_in.first"))
    st.caption(say("sign_in.first.why"))
    with st.form("first-person"):
        name = st.text_input(say("sign_in.name"), key="first-name").strip()
        pin = st.text_input(say("sign_in.new_pin"), key="first-pin", type="password", autocomplete="new-password")
        if not st.form_submit_button(say("sign_in.first.enter"), type="primary", width="stretch"):
            return
    try:
        registry().set_user(name, "quality", pin, actor=name, reason=say("sign_in.first"))
        sign_in(name, pin)
    except InputError as error:
        st.error(in_words(error), icon=":material/error:")
    else:
        st.rerun()
