"""One unit in full: a revision of its map, its estimates, and why its verdict is so."""

from dataclasses import dataclass

import numpy as np

from softcal.app.registry.lot_recordings import source_recording, unlabelled
from softcal.app.views.audited import AuditTrace, audit_trace
from softcal.core.lot import Lot, UnitKey
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.unit.estimate import Estimate, estimate
from softcal.core.unit.state import UnitState
from softcal.core.windows import resting
from softcal.db.entries import StoredCalibration
from softcal.db.registry import Registry

CURVE_POINTS = 200


@dataclass(frozen=True, eq=False)
class UnitSignals:
    """A recording of a calibrated unit, with the source and f∘γ over it."""

    state: UnitState
    lot: Lot
    source: LabelledRecording
    recording: OutputRecording
    estimate: Estimate

    @property
    def mapped(self) -> Array:
        """(m,) newest sample of every mapped window, in the source's output."""
        return self.state.unit_map.apply(self.recording.windows)[:, -1]

    def map_curve(self) -> tuple[Array, Array]:
        """Return levels of a unit at rest, and as the source would show them."""
        low, high = float(self.recording.output.min()), float(self.recording.output.max())
        level = np.linspace(low, high, CURVE_POINTS)
        return level, self.state.unit_map.apply(resting(level))[:, -1]

    @property
    def flagged(self) -> int:
        return int(np.sum(self.estimate.flag != ""))


@dataclass(frozen=True, eq=False)
class UnitView(UnitSignals):
    """One revision of one unit in full, and why its verdict is so; `audit` is None where no measurement decided."""

    stored: StoredCalibration
    audit: AuditTrace | None


def station_of(registry: Registry, key: UnitKey) -> str:
    """Return the station at which the newest recording of a unit was pressed; "" where it came as a file."""
    presses = [press for press in registry.order_queue.list_presses(key.lot_id) if press.serial == key.serial]
    return max(presses, key=lambda press: press.begun).station if presses else ""


def unit_view(registry: Registry, unit: UnitKey, revision: int | None = None) -> UnitView:
    """Read one revision of a unit in full, the one in use without a number."""
    stored = registry.calibrations.get(unit.serial, revision, lot_id=unit.lot_id)
    state = stored.state
    network = registry.networks.get(state.fit.network_id)
    recording = unlabelled(registry.recordings.get(state.fit.recording_sha256))
    return UnitView(
        state,
        registry.lots.get(stored.lot_id),
        source_recording(registry, network.id),
        recording,
        estimate(network, state, recording),
        stored,
        audit_trace(registry, stored.lot_id, state) if state.decision.is_audited else None,
    )
