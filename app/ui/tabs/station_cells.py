"""Why a station's references can be trusted: certificates and checks with golden units."""

import tempfile
from datetime import UTC, date, datetime
from pathlib import Path

import streamlit as st

from softcal.app.charts.station import golden_figure
from softcal.app.line.cell_certificate import certificate_from
from softcal.app.ui.account import actor, allows, permit
from softcal.app.ui.actions import finish, refusals_in_words, say_finished
from softcal.app.ui.components.station_run import choose_station, place
from softcal.app.ui.desk import colours, empty, in_words, say, zone
from softcal.app.ui.panels import rest_may_follow, show_figure, table
from softcal.app.ui.server_memory import registry
from softcal.app.views.common import number
from softcal.app.views.station import golden_units
from softcal.core.errors import InputError
from softcal.core.orders import OrderKind

LARGEST_BYTES = 20_000_000
FIRST_DAY, LAST_DAY = date(2000, 1, 1), date(2100, 1, 1)
TEXTS = {"cell_serial": "cells.serial", "number": "cells.number", "laboratory": "cells.laboratory"}
DAYS = {"issued_on": "cells.issued", "due_on": "cells.due"}
FORCES = {"capacity_N": "cells.capacity", "uncertainty_N": "cells.uncertainty"}


def draw() -> None:
    say_finished("cells")
    certificates, today = registry().stations.certificates(), datetime.now(UTC).astimezone(zone()).date()
    rows = [
        {
            say("cells.serial"): entry.cell_serial,
            say("cells.number"): entry.number,
            say("cells.laboratory"): entry.laboratory,
            say("cells.issued"): f"{entry.issued_on}",
            say("cells.due"): f"{entry.due_on}",
            say("cells.capacity"): number(entry.capacity_N, "N"),
            say("cells.uncertainty"): number(entry.uncertainty_N, "N"),
            say("column.state"): say("cells.valid", days=(entry.due_on - today).days)
            if entry.is_valid(today)
            else say("cells.invalid"),
        }
        for entry in reversed(certificates)
    ]
    if rows:
        table(rows)
    else:
        empty("cells.none")
    if allows("set_up"):
        _certificate_form()
    st.header(say("golden.title"))
    if not rest_may_follow():
        return
    for unit in golden_units(registry()):
        last = unit.runs[-1]
        word = say("golden.passed" if last.passed else "golden.failed")
        st.markdown(f"**{unit.serial}** · {unit.lot_id} · {unit.station} · {word}")
        show_figure(
            golden_figure(unit.runs, unit.chart, colours(), say), f"golden-{unit.station}-{unit.lot_id}-{unit.serial}"
        )
        for line in (*last.reasons, unit.note):
            if line:
                st.caption(in_words(line))
    if not registry().stations.golden_runs():
        st.caption(say("golden.none"))
    if allows("set_up"):
        with st.container(border=True):
            station = choose_station()
            serial = str(st.text_input(say("golden.serial"), key="golden-serial")).strip()
            if st.button(say("golden.do"), disabled=not (station and serial), icon=":material/verified:") and station:
                if place(station, OrderKind.GOLDEN, serial):
                    st.info(say("golden.ordered"), icon=":material/hourglass:")


def _certificate_form() -> None:
    with st.form("certificate", border=True):
        st.markdown(f"**{say('cells.add')}**")
        document = st.file_uploader(say("cells.dcc"), type=["xml"])
        st.caption(say("cells.typed"))
        given: dict[str, object] = {}
        for column, (name, label) in zip(st.columns(4), TEXTS.items(), strict=False):
            given[name] = str(column.text_input(say(label), key=f"cell-{name}")).strip() or None
        columns = st.columns(4)
        for column, (name, label) in zip(columns[:2], DAYS.items(), strict=True):
            given[name] = column.date_input(say(label), None, FIRST_DAY, LAST_DAY, key=f"cell-{name}")
        for column, (name, label) in zip(columns[2:], FORCES.items(), strict=True):
            title = f"{say(label)} [N]"
            given[name] = column.number_input(title, 0.0, value=None, format="%.4g", key=f"cell-{name}")
        if not st.form_submit_button(say("cells.store"), type="primary"):
            return
    permit("set_up")
    with refusals_in_words(), tempfile.TemporaryDirectory(prefix="softcal-dcc-") as folder:
        file = None
        if document is not None:
            if document.size > LARGEST_BYTES:
                raise InputError(f"the document has {document.size} bytes; at most {LARGEST_BYTES} are taken")
            file = Path(folder) / "certificate.xml"
            file.write_bytes(document.getvalue())
        certificate = certificate_from(given, file)
        registry().stations.add_certificate(certificate, actor=actor())
        finish("cells", say("cells.stored", number=certificate.number))
