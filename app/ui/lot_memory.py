"""What this server remembers of a lot until something of it changes, so that ten thousand units are read once."""

import streamlit as st

from softcal.app.ui.registry_of_server import registry
from softcal.app.views.lot import LotView, lot_view

LOTS = 16


def remembered_lot_view(lot_id: str) -> LotView:
    """Return a lot at a glance, read once per change; nobody may write into it, since every page gets the same one.

    Raises:
        InputError: the lot is not in the registry.
    """
    return _view(str(registry().database.name), lot_id, registry().change_marker(lot_id))


# Not cache_data: it would copy ten thousand rows at every look.
@st.cache_resource(max_entries=LOTS, show_spinner=False)
def _view(registry_name: str, lot_id: str, marker: str) -> LotView:
    return lot_view(registry(), lot_id)
