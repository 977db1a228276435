"""Choose a unit by its serial among any number of them: typed, scanned or picked from what fits."""

import streamlit as st

from softcal.app.ui.desk import in_full, registry, words


def choose_unit() -> str | None:
    """Return the serial of the address or of the field; None where no unit has a result yet.

    The serial stays in the address, so that a link leads back to it.
    """
    say = words()
    asked = str(st.query_params.get("unit", ""))
    left, right = st.columns(2, vertical_alignment="bottom")
    text = str(left.text_input(say("unit.find"), key="unit-find", icon=":material/search:") or "").strip()
    found = registry().find_serials(text)
    if not found and text:
        st.caption(say("unit.find.none", text=text))
        found = registry().find_serials("")
    if asked and not text and asked not in found:
        found = [asked, *found]
    if not found:
        return None
    index = found.index(asked) if asked in found else 0
    chosen = str(right.selectbox(say("choose.unit"), found, index=index, key=f"unit-choice-{text}-{asked}"))
    if chosen != asked:
        st.query_params["unit"] = chosen
    in_full(chosen)
    return chosen
