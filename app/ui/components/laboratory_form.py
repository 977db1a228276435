"""What every certificate says that no recording knows: laboratory, customer, person, conditions, load cell."""

from dataclasses import fields, replace
from datetime import date
from typing import Any

import streamlit as st

from softcal.app.export.certificates.laboratory import (
    NO_COUNTRY,
    NOT_STATED,
    Conditions,
    LoadCell,
    Party,
    Person,
    keep_laboratory,
    kept_laboratory,
    read_laboratory,
)
from softcal.app.ui.account import actor, permit, person
from softcal.app.ui.desk import in_words, registry, words
from softcal.core.errors import InputError
from softcal.db.access.people import may
from softcal.db.entries import CellCertificate

PARTS = {"laboratory": Party, "customer": Party, "person": Person}


def laboratory_form() -> None:
    """Draw the form, filled with what is kept; what it says stands on every certificate from then on."""
    say = words()
    with st.expander(say("laboratory.title"), icon=":material/badge:"):
        st.caption(say("laboratory.how"))
        kept = read_laboratory(kept_laboratory())
        if not may(person(), "set_up"):
            st.caption(say("reason.not_allowed", role=say(f"role.{person().role}")))
            return
        cells = {entry.cell_serial: entry for entry in registry().stations.certificates()}
        with st.form("laboratory", border=False):
            given = {name: _section(name, getattr(kept, name)) for name in PARTS}
            conditions = _conditions(kept.conditions)
            cell = _cell(kept.load_cell, list(cells))
            if not st.form_submit_button(say("laboratory.save"), type="primary"):
                return
        permit("set_up")
        try:
            parts: dict[str, Any] = {name: PARTS[name](**values) for name, values in given.items()}
            load_cell = _of_certificate(cells[cell]) if cell in cells else kept.load_cell
            stated = replace(kept, **parts, conditions=conditions, load_cell=load_cell)
        except InputError as error:
            st.error(in_words(error), icon=":material/error:")
            return
        keep_laboratory(stated)
        registry().trail.add("change", "laboratory", ("certificates",), {**given, "load_cell": cell}, actor=actor())
        st.session_state["release-done"] = say("laboratory.saved")
        st.rerun()


def _section(name: str, kept: Party | Person) -> dict[str, str]:
    say = words()
    st.markdown(f"**{say(f'laboratory.{name}')}**")
    names = [field.name for field in fields(kept)]
    given = {}
    for column, field in zip(st.columns(len(names)), names, strict=True):
        value = str(getattr(kept, field))
        shown = "" if value in (NOT_STATED, NO_COUNTRY) else value
        text = str(column.text_input(say(f"laboratory.{field}"), shown, key=f"laboratory-{name}-{field}")).strip()
        given[field] = text or (NO_COUNTRY if field == "country" else NOT_STATED)
    return given


def _conditions(kept: Conditions) -> Conditions:
    say = words()
    st.markdown(f"**{say('laboratory.conditions')}**")
    left, right, _, _ = st.columns(4)
    temperature_C = left.number_input(
        f"{say('laboratory.temperature')} [°C]", -50.0, 150.0, value=kept.temperature_C, format="%.1f"
    )
    humidity_pct = right.number_input(
        f"{say('laboratory.humidity')} [%]", 0.0, 100.0, value=kept.humidity_pct, format="%.0f"
    )
    return replace(kept, temperature_C=temperature_C, humidity_pct=humidity_pct)


def _cell(kept: LoadCell, known: list[str]) -> str:
    say = words()
    st.markdown(f"**{say('laboratory.load_cell')}**")
    options = [kept.serial, *(serial for serial in known if serial != kept.serial)]
    shown = {NOT_STATED: say("laboratory.not_stated")}
    left, _ = st.columns(2)
    chosen = str(
        left.selectbox(
            say("cells.serial"), options, format_func=lambda serial: shown.get(serial, serial), key="laboratory-cell"
        )
    )
    due: date | None = kept.due_on if chosen == kept.serial else None
    if due is not None:
        st.caption(say("laboratory.due", due=f"{due:%Y-%m-%d}"))
    return chosen


def _of_certificate(entry: CellCertificate) -> LoadCell:
    """Return what certificates say of a load cell whose certificate the registry has; its due date with it."""
    return LoadCell(
        serial=entry.cell_serial,
        certificate=entry.number,
        laboratory=entry.laboratory,
        issued_on=entry.issued_on,
        due_on=entry.due_on,
        uncertainty_N=entry.uncertainty_N,
    )
