"""Limit of a lot: stated, or from the source's own error."""

from dataclasses import replace

from softcal.app.registry.lot_recordings import source_model
from softcal.app.registry.reference import reference_expanded
from softcal.core.errors import NotCalibrated
from softcal.core.unit.verdict import Limit, default_limit
from softcal.db.registry import Registry


def lot_limit(registry: Registry, lot_id: str) -> Limit:
    """Return the lot's limit; without a stated limit the one from its source's error.

    Raises:
        InputError: none was stated, and no unit was calibrated yet.
    """
    lot, expanded = registry.lots.get(lot_id), reference_expanded(registry, lot_id)
    if lot.limit_rmse is not None:
        return Limit(lot.reference_unit, lot.limit_rmse, reference_expanded=expanded)
    units = registry.lots.units(lot_id)
    serial = next((unit.serial for unit in units if unit.role == "target" and unit.revision is not None), None)
    if serial is None:
        raise NotCalibrated(f"lot {lot_id!r} states no limit and has no calibrated unit yet; calibrate its units first")
    state = registry.calibrations.get(serial, lot_id=lot_id).state
    if not state.limit.is_stated:
        return replace(state.limit, reference_expanded=expanded)
    # Its limit was taken back since.
    source = source_model(registry, state.fit.network_id, state.fit.method)
    limit = default_limit(lot.reference_unit, source.held_out_rmse, source.full_range, state.fit.method.decision)
    return replace(limit, reference_expanded=expanded)


def limit_or_none(registry: Registry, lot_id: str) -> Limit | None:
    """Return the limit as `lot_limit`; None without one, and without a calibrated unit."""
    try:
        return lot_limit(registry, lot_id)
    except NotCalibrated:
        return None
