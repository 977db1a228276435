"""What makes a station's references trustworthy: the load cells' certificates and the checks with golden units."""

from datetime import UTC, datetime

import streamlit as st

from softcal.app.charts.station import golden_figure
from softcal.app.ui.account import person
from softcal.app.ui.components.certificate_form import certificate_form
from softcal.app.ui.components.station_run import choose_station, place
from softcal.app.ui.desk import colours, empty, errors_in_words, in_words, registry, show_figure, words
from softcal.app.ui.first_paint import rest_may_follow
from softcal.app.ui.panels import heading, table
from softcal.app.views.common import number
from softcal.app.views.station import golden_units
from softcal.core.orders import OrderKind
from softcal.db.access.people import may
from softcal.db.entries import CellCertificate


def render() -> None:
    """Draw the page."""
    say = words()
    with errors_in_words():
        heading("load_cells")
        if done := st.session_state.pop("cells-done", ""):
            st.success(done, icon=":material/check:")
        found = registry().certificates()
        if found:
            table([_row(entry) for entry in reversed(found)])
        else:
            empty(say("cells.none"), say("cells.none.how"))
        if may(person(), "set_up"):
            certificate_form()
        st.header(say("golden.title"))
        if rest_may_follow():
            _golden()


def _row(entry: CellCertificate) -> dict[str, object]:
    say, today = words(), datetime.now(UTC).date()
    left = (entry.due_on - today).days
    state = say("cells.valid", days=left) if entry.is_valid(today) else say("cells.invalid")
    return {
        say("cells.serial"): entry.cell_serial,
        say("cells.number"): entry.number,
        say("cells.laboratory"): entry.laboratory,
        say("cells.issued"): f"{entry.issued_on:%Y-%m-%d}",
        say("cells.due"): f"{entry.due_on:%Y-%m-%d}",
        say("cells.capacity"): number(entry.capacity_N, "N"),
        say("cells.uncertainty"): number(entry.uncertainty_N, "N"),
        say("cells.state"): state,
    }


def _golden() -> None:
    say = words()
    for unit in golden_units(registry()):
        last = unit.runs[-1]
        word = say("golden.passed" if last.passed else "golden.failed")
        st.markdown(f"**{unit.serial}** · {unit.station} · {word}")
        show_figure(golden_figure(unit.runs, unit.chart, colours(), say), f"golden-{unit.station}-{unit.serial}")
        for line in (*last.reasons, unit.note):
            if line:
                st.caption(in_words(line))
    if not registry().golden_runs():
        st.caption(say("golden.none"))
    if may(person(), "set_up"):
        with st.container(border=True):
            _check()


def _check() -> None:
    say = words()
    station = choose_station()
    serial = str(st.text_input(say("golden.serial"), key="golden-serial")).strip()
    if st.button(say("golden.do"), disabled=not (station and serial), icon=":material/verified:") and station:
        if place(station, OrderKind.GOLDEN, serial):
            st.info(say("golden.ordered"), icon=":material/hourglass:")
