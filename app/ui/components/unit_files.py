"""The calibration files of one revision, made when somebody asks for them; who took what lands in the audit trail."""

from collections.abc import Mapping

import streamlit as st

from softcal.app.export.calibrated_unit import ExportOptions, UnitLoader
from softcal.app.export.certificates.laboratory import kept_laboratory
from softcal.app.export.formats import writer_of
from softcal.app.export.names import FORMATS
from softcal.app.ui.account import actor
from softcal.app.ui.callbacks import in_one_piece
from softcal.app.ui.desk import in_words, registry, words
from softcal.core.errors import UnitRefused

MIMES = {"pdf": "application/pdf", "json": "application/json", "xml": "application/xml"}


def unit_files(serial: str, lot_id: str, revision: int, is_in_use: bool) -> None:
    """Draw the choice of a format and a button per file."""
    say = words()
    chosen = st.segmented_control(
        say("unit.files.format"), FORMATS, format_func=lambda name: say(f"format.{name}"), key=f"format-{serial}"
    )
    if chosen is None:
        st.caption(say("unit.files.how"))
        return
    try:
        files = _files(serial, lot_id, None if is_in_use else revision, chosen)
    except UnitRefused as error:
        st.warning(in_words(error), icon=":material/block:")
        return
    with st.container(horizontal=True):
        for name, content in files.items():
            st.download_button(
                f"{name}  ({_size(content)})",
                data=content,
                file_name=name,
                mime=MIMES.get(name.rpartition(".")[2], "application/octet-stream"),
                key=f"file-{revision}-{name}",
                icon=":material/download:",
                on_click=_tell,
                args=(serial, lot_id, revision, name),
            )


def _files(serial: str, lot_id: str, revision: int | None, name: str) -> Mapping[str, bytes]:
    options = ExportOptions(revision=revision, lot_id=lot_id, laboratory=kept_laboratory())
    return writer_of(name)(UnitLoader(registry(), options).load(serial))


@in_one_piece
def _tell(serial: str, lot_id: str, revision: int, name: str) -> None:
    facts = {"lot_id": lot_id, "revision": revision, "file": name}
    registry().add_event("export", "units", (serial,), facts, actor=actor())


def _size(content: bytes) -> str:
    return f"{len(content)} B" if len(content) < 4096 else f"{len(content) / 1024:.0f} KiB"
