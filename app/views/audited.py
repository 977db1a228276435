"""The audited units of a lot: estimate against reference, and the error over the load."""

from dataclasses import dataclass

import numpy as np

from softcal.app.registry.lot_recordings import audit_of, newest_audits
from softcal.core.lot import Lot
from softcal.core.metrics import rmse
from softcal.core.recording import Array
from softcal.core.unit.estimate import estimate
from softcal.core.unit.state import UnitState
from softcal.db.entries import UnitEntry
from softcal.db.registry import Registry

MAX_UNITS = 12
"""So many audited units are drawn, the largest errors first; each is read and estimated anew."""

BANDS = 8
"""Load bands of equal width over what the audits were pressed to."""

MIN_SAMPLES_IN_BAND = 10
"""A band of fewer samples has no error of its own."""


@dataclass(frozen=True, eq=False)
class AuditTrace:
    """All rows of one audit that have an estimate: (n,) each, in the reference unit."""

    serial: str
    t_s: Array
    output: Array
    reference: Array
    estimate: Array


@dataclass(frozen=True, eq=False)
class AuditedView:
    """Audited units of a lot, the largest errors first, `of` so many.

    Args:
        edges: (BANDS + 1,) of the load bands, in the reference unit.
        limit_rmse: in force, in the reference unit; None where there is none.
    """

    lot: Lot
    units: tuple[AuditTrace, ...]
    of: int
    edges: Array
    limit_rmse: float | None = None

    def band_errors(self, unit: AuditTrace) -> Array:
        """Return (BANDS,) RMSE of a unit in each load band; NaN where it has too few samples."""
        band = np.clip(np.digitize(unit.reference, self.edges) - 1, 0, BANDS - 1)
        inside = [band == k for k in range(BANDS)]
        return np.array(
            [
                rmse(unit.estimate[rows], unit.reference[rows]) if rows.sum() >= MIN_SAMPLES_IN_BAND else np.nan
                for rows in inside
            ]
        )

    @property
    def middles(self) -> Array:
        """(BANDS,) middle of each load band."""
        return (self.edges[:-1] + self.edges[1:]) / 2


def audit_trace(registry: Registry, lot_id: str, state: UnitState) -> AuditTrace | None:
    """Estimate the newest audit of a unit with a map of it, on the rows its error is stated on; None without one."""
    serial = state.fit.serial
    audit = audit_of(registry, newest_audits(registry, lot_id, serial).get(serial))
    if audit is None:
        return None
    recording, rows = audit.unlabelled, audit.unlabelled.window_rows
    estimates = estimate(registry.networks.get(state.fit.network_id), state, recording)
    return AuditTrace(
        serial, recording.t_s[rows], recording.output[rows], audit.window_reference, estimates.estimate[rows]
    )


def audited_view(
    registry: Registry, lot: Lot, audited: tuple[UnitEntry, ...], limit_rmse: float | None = None
) -> AuditedView | None:
    """Estimate the newest audits of a lot with the maps in use; None where there are none."""
    worst = sorted(audited, key=lambda row: -(row.after_rmse or 0.0))[:MAX_UNITS]
    units: list[AuditTrace] = []
    for row in worst:
        state = registry.calibrations.get(row.serial, lot_id=lot.id).state
        if (trace := audit_trace(registry, lot.id, state)) is not None:
            units.append(trace)
    if not units:
        return None
    loads = np.concatenate([unit.reference for unit in units])
    low, high = float(loads.min()), float(loads.max())
    edges = np.linspace(low, high if high > low else low + 1.0, BANDS + 1)
    return AuditedView(lot, tuple(units), len(audited), edges, limit_rmse)
