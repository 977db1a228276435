"""The registry of this server, and lots as it remembers them until something changes."""

from functools import partial

import streamlit as st

from softcal.app.batch.audit import lot_audit
from softcal.app.batch.changes import Changes, preview, preview_limit
from softcal.app.batch.release import decide_lot, lot_standing
from softcal.app.bootstrap import open_chosen_registry
from softcal.app.views.lot import EVERY_RUN, LotView, lot_view
from softcal.app.views.lot_runs import LotFilter
from softcal.app.views.next_step import NextStep, next_step
from softcal.core.quality.lot_standing import LotStanding
from softcal.db.registry import Registry


@st.cache_resource(max_entries=1)
def registry() -> Registry:
    """Return the registry this server was started with; one connection pool for all pages."""
    return open_chosen_registry(None)


LOTS = 16


def remembered_lot_view(lot_id: str, wanted: LotFilter = EVERY_RUN) -> LotView:
    """Return a lot at a glance, read once per change; every page gets the same, to read only."""
    return _view(str(registry().database.name), lot_id, registry().pages.change_marker(lot_id), wanted)


def remembered_limit_changes(lot_id: str, rmse: float | None) -> Changes:
    """Return what another limit would change, decided once per change of the lot."""
    return _limit_changes(str(registry().database.name), lot_id, registry().pages.change_marker(lot_id), rmse)


@st.cache_resource(max_entries=LOTS, show_spinner=False)
def _limit_changes(registry_name: str, lot_id: str, marker: str, rmse: float | None) -> Changes:
    return preview_limit(registry(), lot_id, rmse)


def remembered_standing(lot_id: str) -> LotStanding:
    """Return where a lot stands, read once per change."""
    return _standing(str(registry().database.name), lot_id, registry().pages.change_marker(lot_id))


def remembered_step(lot_id: str) -> NextStep:
    """Return what is to be done next with a lot."""
    audit = lot_audit(registry(), lot_id)
    return next_step(registry(), remembered_standing(lot_id), None if audit is None else audit.missing)


def remembered_release_changes(lot_id: str) -> Changes:
    """Return what a release of a lot would change, decided once per change of the lot."""
    return _release_changes(str(registry().database.name), lot_id, registry().pages.change_marker(lot_id))


@st.cache_resource(max_entries=LOTS, show_spinner=False)
def _standing(registry_name: str, lot_id: str, marker: str) -> LotStanding:
    return lot_standing(registry(), lot_id)


@st.cache_resource(max_entries=LOTS, show_spinner=False)
def _release_changes(registry_name: str, lot_id: str, marker: str) -> Changes:
    return preview(registry(), lot_id, partial(decide_lot, registry(), lot_id))


# Not cache_data: it would copy ten thousand rows at every look.
@st.cache_resource(max_entries=LOTS, show_spinner=False)
def _view(registry_name: str, lot_id: str, marker: str, wanted: LotFilter) -> LotView:
    return lot_view(registry(), lot_id, wanted)
