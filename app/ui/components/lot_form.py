"""Choose a lot, or register a new one with its source unit."""

import streamlit as st

from softcal.app.ui.account import actor, permit
from softcal.app.ui.desk import choose, in_words, registry, words
from softcal.core.errors import InputError
from softcal.core.lot import Lot


def choose_or_add_lot() -> Lot | None:
    """Draw the choice and the form; None while there is no lot."""
    say = words()
    known = registry().lot_ids()
    lot_id = choose(say("choose.lot"), known, "lot")
    with st.expander(say("source.new_lot"), icon=":material/add:", expanded=not known):
        _form()
    return None if lot_id is None else registry().lot(lot_id)


def _form() -> None:
    say = words()
    with st.form("lot", border=False):
        left, middle, right = st.columns(3)
        name = str(left.text_input(say("source.lot_id"), placeholder="2026-48")).strip()
        source = str(middle.text_input(say("source.serial"), placeholder="S1")).strip()
        model = str(right.text_input(say("source.model"), placeholder="eGaIn pad, 3 mm")).strip()
        left, middle, right = st.columns(3)
        quantity = str(left.text_input(say("source.quantity"), "force")).strip()
        reference_unit = str(middle.text_input(say("source.reference_unit"), "N")).strip()
        output_unit = str(right.text_input(say("source.output_unit"), "V")).strip()
        rate_Hz = st.number_input(f"{say('column.rate')} [Hz]", 0.1, 100_000.0, 50.0)
        if not st.form_submit_button(say("source.add_lot")):
            return
    permit("set_up")
    try:
        registry().add_lot(Lot(name, source, rate_Hz, model, quantity, reference_unit, output_unit), actor=actor())
    except InputError as error:
        st.error(in_words(error), icon=":material/error:")
        return
    st.query_params["lot"] = name
    st.rerun()
