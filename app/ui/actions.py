"""What a person does on a page: changes with a reason, what came of them, and files to take."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any, Literal

import streamlit as st

from softcal.app.files.spreadsheet import csv_text
from softcal.app.registry.given_files import remember_files
from softcal.app.ui.account import actor, allows, permit, person
from softcal.app.ui.callbacks import in_one_piece
from softcal.app.ui.desk import in_words, say
from softcal.app.ui.server_memory import registry
from softcal.core.errors import InputError
from softcal.core.lot import UnitKey

SHORTEST_REASON = 5
MIMES = {
    "csv": "text/csv",
    "html": "text/html",
    "json": "application/json",
    "pdf": "application/pdf",
    "xml": "application/xml",
    "zip": "application/zip",
}


@contextmanager
def refusals_in_words(icon: str = "error") -> Iterator[None]:
    """Say in one line why what a person asked for is refused; what else the page draws is drawn."""
    try:
        yield
    except InputError as error:
        st.error(in_words(error), icon=f":material/{icon}:")


def finish(change: str, told: str) -> None:
    """Draw the page anew, where `say_finished` says what was done."""
    st.session_state[f"{change}-done"] = told
    st.rerun()


def say_finished(change: str) -> bool:
    """Say once what a change did, in the drawing after it; return whether there was one."""
    done = st.session_state.pop(f"{change}-done", "")
    if done:
        st.success(done, icon=":material/check:")
    return bool(done)


def role_allows(action: str) -> bool:
    """Whether the role allows an action of `PERMISSIONS`; else say that it does not."""
    if allows(action):
        return True
    st.caption(say("reason.not_allowed", role=say(f"role.{person().role}")))
    return False


def ask_reason(key: str, label: str, action: str, fields: Callable[[], None] = lambda: None) -> str | None:
    """Ask for the reason of a change; return it in the run in which the button was pressed.

    The caller passes it with `account.actor()` to the function that makes the change and its row in
    the audit trail.

    Args:
        key: unique on the page.
        label: of the button: what will be done.
        action: of `PERMISSIONS`; a role without it sees why there is no button.
        fields: draws what is sent with the reason. A PIN belongs there: outside a form the browser
            keeps it to itself when a person leaves its field with the Tab key.
    """
    if not role_allows(action):
        return None
    with st.form(f"reason-{key}", border=False):
        fields()
        reason = str(st.text_input(say("column.reason"), placeholder=say("reason.example"), key=f"reason-text-{key}"))
        if not st.form_submit_button(label, type="primary"):
            return None
    if len(reason.strip()) < SHORTEST_REASON:
        st.warning(say("reason.missing"), icon=":material/edit:")
        return None
    permit(action)
    return reason.strip()


def download(
    label: str,
    name: str,
    data: bytes | Callable[[], bytes | str],
    key: str,
    *,
    exported: tuple[str, tuple[str, ...], Mapping[str, object]] | None = None,
    icon: str = "download",
    kind: Literal["primary", "secondary"] = "secondary",
) -> None:
    """Offer a file; a function makes it when somebody takes it.

    `exported` is (entity, key, facts) of its row of the audit trail; None has none.
    """
    mime = MIMES.get(name.rpartition(".")[2], "application/octet-stream")
    look: Any = {"icon": f":material/{icon}:", "type": kind}
    draw = partial(st.download_button, label, data=data, file_name=name, mime=mime, key=key, **look)
    if exported is None:
        draw(on_click="ignore")
    else:
        draw(on_click=_tell_export, args=exported)


def csv_of(rows: Sequence[Mapping[str, object]]) -> bytes:
    """Return rows as CSV; the mark at its beginning tells Excel that these bytes are UTF-8."""
    return csv_text(list(rows[0]) if rows else [], [tuple(row.values()) for row in rows]).encode("utf-8-sig")


@in_one_piece
def _tell_export(entity: str, key: tuple[str, ...], facts: Mapping[str, object]) -> None:
    registry().trail.add("export", entity, key, facts, actor=actor())
    if "map_sha256" in facts:
        given = {name: facts[name] for name in ("revision", "map_sha256", "verdict")}
        remember_files(registry(), {UnitKey(*key): given}, "page")
