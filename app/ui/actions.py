"""What a person does on a page: changes with a reason, what came of them, and files to take."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any, Literal

import streamlit as st

from softcal.app.files.spreadsheet import csv_text
from softcal.app.registry.exported_files import record_exported_files
from softcal.app.ui.account import actor, allows, permit, person
from softcal.app.ui.callbacks import run_uninterrupted
from softcal.app.ui.presentation import localize, translate
from softcal.app.ui.server_cache import registry
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
def show_refusals(icon: str = "error") -> Iterator[None]:
    """Say in one line why what a person asked for is refused; what else the page draws is drawn."""
    try:
        yield
    except InputError as error:
        st.error(localize(error), icon=f":material/{icon}:")


def finish(change: str, message: str) -> None:
    """Draw the page anew, where `show_finished` says what was done."""
    st.session_state[f"{change}-done"] = message
    st.rerun()


def show_finished(change: str) -> bool:
    """Say once what a change did, in the drawing after it; return whether there was one."""
    done = st.session_state.pop(f"{change}-done", "")
    if done:
        st.success(done, icon=":material/check:")
    return bool(done)


def role_allows(action: str) -> bool:
    """Whether the role allows an action of `PERMISSIONS`; else say that it does not."""
    if allows(action):
        return True
    st.caption(translate("reason.not_allowed", role=translate(f"role.{person().role}")))
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
        reason = str(
            st.text_input(translate("column.reason"), placeholder=translate("reason.example"), key=f"reason-text-{key}")
        )
        if not st.form_submit_button(label, type="primary"):
            return None
    if len(reason.strip()) < SHORTEST_REASON:
        st.warning(translate("reason.missing"), icon=":material/edit:")
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
        draw(on_click=_record_export, args=exported)


def csv_of(rows: Sequence[Mapping[str, object]]) -> bytes:
    """Return rows as CSV; the mark at its beginning tells Excel that these bytes are UTF-8."""
    return csv_text(list(rows[0]) if rows else [], [tuple(row.values()) for row in rows]).encode("utf-8-sig")


@run_uninterrupted
def _record_export(entity: str, key: tuple[str, ...], details: Mapping[str, object]) -> None:
    registry().trail.add("export", entity, key, details, actor=actor())
    if "map_sha256" in details:
        export_record = {name: details[name] for name in ("revision", "map_sha256", "verdict")}
        record_exported_files(registry(), {UnitKey(*key): export_record}, "page")
