"""A load cell's certificate, from its DCC or typed in; what is typed stands over what the document says."""

import tempfile
from datetime import date
from pathlib import Path

import streamlit as st

from softcal.app.line.cell_certificate import certificate_from
from softcal.app.ui.account import actor, permit
from softcal.app.ui.desk import in_words, registry, words
from softcal.core.errors import InputError

LARGEST_BYTES = 20_000_000
FIRST_DAY, LAST_DAY = date(2000, 1, 1), date(2100, 1, 1)
TEXTS = {"cell_serial": "cells.serial", "number": "cells.number", "laboratory": "cells.laboratory"}
DAYS = {"issued_on": "cells.issued", "due_on": "cells.due"}
FORCES = {"capacity_N": "cells.capacity", "uncertainty_N": "cells.uncertainty"}


def certificate_form() -> None:
    """Draw the form; a certificate that is stored appears in the list above it."""
    say = words()
    with st.form("certificate", border=True):
        st.markdown(f"**{say('cells.add')}**")
        document = st.file_uploader(say("cells.dcc"), type=["xml"])
        st.caption(say("cells.typed"))
        given: dict[str, object] = {}
        columns = st.columns(4)
        for column, (name, label) in zip(columns[:3], TEXTS.items(), strict=True):
            given[name] = str(column.text_input(say(label), key=f"cell-{name}")).strip() or None
        columns = st.columns(4)
        for column, (name, label) in zip(columns[:2], DAYS.items(), strict=True):
            given[name] = column.date_input(
                say(label), value=None, min_value=FIRST_DAY, max_value=LAST_DAY, key=f"cell-{name}"
            )
        for column, (name, label) in zip(columns[2:], FORCES.items(), strict=True):
            given[name] = column.number_input(
                f"{say(label)} [N]", value=None, min_value=0.0, format="%.4g", key=f"cell-{name}"
            )
        if not st.form_submit_button(say("cells.store"), type="primary"):
            return
    permit("set_up")
    try:
        number = _store(given, None if document is None else document.getvalue())
    except InputError as error:
        st.error(in_words(error), icon=":material/error:")
        return
    st.session_state["cells-done"] = say("cells.stored", number=number)
    st.rerun()


def _store(given: dict[str, object], document: bytes | None) -> str:
    if document is not None and len(document) > LARGEST_BYTES:
        raise InputError(f"the document has {len(document)} bytes; at most {LARGEST_BYTES} are taken")
    with tempfile.TemporaryDirectory(prefix="softcal-dcc-") as folder:
        file = None
        if document is not None:
            file = Path(folder) / "certificate.xml"
            file.write_bytes(document)
        certificate = certificate_from(given, file)
    registry().add_certificate(certificate, actor=actor())
    return certificate.number
