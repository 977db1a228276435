"""What every certificate says: laboratory, customer, responsible person, conditions, load cell."""

from dataclasses import fields, replace
from typing import Any

import streamlit as st

from softcal.app.export.certificates import laboratory
from softcal.app.ui.account import actor, permit
from softcal.app.ui.actions import finish, refusals_in_words, role_allows, say_finished
from softcal.app.ui.desk import say
from softcal.app.ui.server_memory import registry

PARTS = {"laboratory": laboratory.Party, "customer": laboratory.Party, "person": laboratory.Person}


def draw() -> None:
    st.header(say("laboratory.title"))
    say_finished("laboratory")
    st.caption(say("laboratory.how"))
    kept = laboratory.registry_laboratory(registry())
    if not role_allows("set_up"):
        return
    cells = {entry.cell_serial: entry for entry in registry().stations.certificates()}
    given: dict[str, dict[str, str]] = {}
    with st.form("laboratory", border=False):
        for name in PARTS:
            st.markdown(f"**{say(f'laboratory.{name}')}**")
            part, given[name] = getattr(kept, name), {}
            names = [field.name for field in fields(part)]
            for column, field in zip(st.columns(len(names)), names, strict=True):
                value = str(getattr(part, field))
                shown = "" if value in (laboratory.NOT_STATED, laboratory.NO_COUNTRY) else value
                label, key = say(f"laboratory.{field}"), f"laboratory-{name}-{field}"
                nothing = laboratory.NO_COUNTRY if field == "country" else laboratory.NOT_STATED
                given[name][field] = str(column.text_input(label, shown, key=key)).strip() or nothing

        st.markdown(f"**{say('laboratory.conditions')}**")
        left, right, _, _ = st.columns(4)
        label, usual = f"{say('laboratory.temperature')} [°C]", kept.conditions
        temperature_C = left.number_input(label, -50.0, 150.0, usual.temperature_C, format="%.1f")
        label = f"{say('laboratory.humidity')} [%]"
        humidity_pct = right.number_input(label, 0.0, 100.0, usual.humidity_pct, format="%.0f")

        st.markdown(f"**{say('laboratory.load_cell')}**")
        load_cell = kept.load_cell
        options = [load_cell.serial, *(serial for serial in cells if serial != load_cell.serial)]
        unstated = {laboratory.NOT_STATED: say("laboratory.not_stated")}
        left, _ = st.columns(2)
        chosen = str(
            left.selectbox(say("cells.serial"), options, 0, lambda one: unstated.get(one, one), "laboratory-cell")
        )
        if chosen == load_cell.serial and load_cell.due_on is not None:
            st.caption(say("laboratory.due", due=f"{load_cell.due_on}"))
        if not st.form_submit_button(say("laboratory.save"), type="primary"):
            return
    permit("set_up")
    with refusals_in_words():
        changed: dict[str, Any] = {name: PARTS[name](**values) for name, values in given.items()}
        changed["conditions"] = replace(usual, temperature_C=temperature_C, humidity_pct=humidity_pct)
        if entry := cells.get(chosen):
            same = ("laboratory", "issued_on", "due_on", "uncertainty_N")
            facts = {name: getattr(entry, name) for name in same}
            changed["load_cell"] = laboratory.LoadCell(serial=entry.cell_serial, certificate=entry.number, **facts)
        laboratory.store_laboratory(registry(), replace(kept, **changed), actor())
        finish("laboratory", say("laboratory.saved"))
