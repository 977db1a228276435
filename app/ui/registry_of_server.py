"""The registry this server was started with."""

import streamlit as st

from softcal.app.bootstrap import open_chosen_registry
from softcal.db.registry import Registry


@st.cache_resource(max_entries=1)
def registry() -> Registry:
    """Return the registry this server was started with; one connection pool for all pages."""
    return open_chosen_registry(None)
