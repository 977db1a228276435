"""The files of a unit: a format, and a button a file."""

import streamlit as st

from softcal.app.export.calibrated_unit import ExportOptions, UnitLoader
from softcal.app.export.export import exported_file_record
from softcal.app.export.formats import writer_of
from softcal.app.export.names import FORMATS
from softcal.app.ui.actions import download
from softcal.app.ui.desk import in_words, named, say
from softcal.app.ui.server_memory import registry
from softcal.core.errors import UnitRefused
from softcal.core.lot import UnitKey
from softcal.db.entries import StoredCalibration


def draw(key: UnitKey, stored: StoredCalibration) -> None:
    chosen = st.segmented_control(say("unit.files.format"), FORMATS, format_func=named("format"), key=f"format-{key}")
    if chosen is None:
        st.caption(say("unit.files.how"))
        return
    # The calibration in use is asked for as such: whether it still is the answer is looked up with it.
    revision = None if stored.is_current else stored.revision
    options = ExportOptions(revision=revision, lot_id=key.lot_id)
    try:
        unit = UnitLoader(registry(), options).load(key.serial)
        files = writer_of(chosen)(unit)
    except UnitRefused as error:
        st.warning(in_words(error), icon=":material/block:")
        return
    with st.container(horizontal=True):
        for name, content in files.items():
            size = f"{len(content)} B" if len(content) < 4096 else f"{len(content) / 1024:.0f} KiB"
            exported = ("units", (key.lot_id, key.serial), {**exported_file_record(unit), "file": name})
            label = f"{name}  ({size})"
            download(label, name, content, f"file-{key}-{stored.revision}-{name}", exported=exported)
