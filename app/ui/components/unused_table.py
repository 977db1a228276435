"""What of a person's files was not used, as a table."""

from collections.abc import Sequence

import streamlit as st

from softcal.app.files.not_used import NotUsed
from softcal.app.ui.desk import in_words, say
from softcal.app.ui.panels import table


def unused_table(items: Sequence[NotUsed]) -> None:
    """Draw one row for each thing that was not used, with why; nothing where all was used."""
    if not items:
        return
    st.markdown(f"**{say('not_used')}**")
    columns = {name: say(f"not_used.{name}") for name in ("kind", "name", "why")}
    table(
        [
            {
                columns["kind"]: say(f"not_used.{item.kind}"),
                columns["name"]: f"{item.name} ({item.file})" if item.file else item.name,
                columns["why"]: in_words(item.why),
            }
            for item in items
        ]
    )
