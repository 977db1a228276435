"""The registry of this server, and lots as it remembers them until something changes."""

from collections.abc import Callable
from functools import partial, wraps
from typing import Any, TypeVar, cast

import streamlit as st

from softcal.app.bootstrap import open_chosen_registry
from softcal.app.calibration.audit import lot_audit
from softcal.app.calibration.changes import Changes, preview, preview_limit
from softcal.app.calibration.redecision import confirm
from softcal.app.calibration.release import decide_lot, outline_lot, read_lot_status, roll_back
from softcal.app.views.audited import AuditedView, audited_view
from softcal.app.views.lot import EVERY_RUN, LotView, lot_view
from softcal.app.views.lot_runs import LotFilter
from softcal.app.views.next_step import NextStep, next_step
from softcal.core.quality.lot_status import LotStatus
from softcal.db.registry import Registry


@st.cache_resource(max_entries=1)
def registry() -> Registry:
    """Return the registry this server was started with; one connection pool for all pages."""
    return open_chosen_registry(None)


MAX_CACHED_LOTS = 96
"""Answers about lots, each as it was after one change."""

Reader = TypeVar("Reader", bound=Callable[..., Any])


# Not cache_data: it would copy ten thousand rows at every look.
@st.cache_resource(max_entries=MAX_CACHED_LOTS, show_spinner=False)
def _read_cached(_read: Callable[..., Any], name: str, registry_name: str, lot_id: str, marker: str, *more: Any) -> Any:  # noqa: V107
    return _read(lot_id, *more)


def cache_per_change(read: Reader) -> Reader:
    """Return a reader of a lot that reads once per change; every page gets the same, to read only."""

    @wraps(read)
    def read_cached(lot_id: str, *more: Any) -> Any:
        marker = registry().pages.change_marker(lot_id)
        return _read_cached(read, read.__name__, str(registry().database.name), lot_id, marker, *more)

    return cast(Reader, read_cached)


@cache_per_change
def cached_lot_view(lot_id: str, lot_filter: LotFilter = EVERY_RUN) -> LotView:
    """Return a lot at a glance."""
    return lot_view(registry(), lot_id, lot_filter)


@cache_per_change
def cached_limit_changes(lot_id: str, rmse: float | None) -> Changes:
    """Return what another limit would change."""
    return preview_limit(registry(), lot_id, rmse)


@cache_per_change
def cached_lot_status(lot_id: str) -> LotStatus:
    """Return where a lot stands, and what a release would be decided on."""
    return read_lot_status(registry(), lot_id)


@cache_per_change
def cached_lot_outline(lot_id: str) -> LotStatus:
    """Return where the units of a lot stand."""
    return outline_lot(registry(), lot_id)


@cache_per_change
def cached_release_changes(lot_id: str) -> Changes:
    """Return what a release of a lot would change."""
    return preview(registry(), lot_id, partial(decide_lot, registry(), lot_id))


@cache_per_change
def remembered_rollback(lot_id: str, serial: str, revision: int) -> Changes:
    """Return what an older revision of a unit, back in use, would change."""
    act = partial(roll_back, registry(), serial, revision, reason="preview", lot_id=lot_id)
    return preview(registry(), lot_id, act)


@cache_per_change
def remembered_network_changes(lot_id: str, decision: str, network_id: str) -> Changes:
    """Return what the release or the withdrawal of a network would change."""
    act = partial(getattr(registry().networks, decision), network_id, reason="preview")
    return preview(registry(), lot_id, act)


@cache_per_change
def remembered_confirmation(lot_id: str, serial: str) -> Changes:
    """Return what a confirmed audit would change."""
    return preview(registry(), lot_id, partial(confirm, registry(), lot_id, serial, reason="preview"))


@cache_per_change
def cached_audited_view(lot_id: str) -> AuditedView | None:
    """Return the audited units of a lot estimated anew; None where there are none."""
    view = cached_lot_view(lot_id)
    return audited_view(registry(), view.lot, view.audited, view.limit_rmse)


def cached_next_step(lot_id: str) -> NextStep:
    """Return what is to be done next with a lot."""
    audit = lot_audit(registry(), lot_id)
    return next_step(registry(), cached_lot_outline(lot_id), None if audit is None else audit.missing)
