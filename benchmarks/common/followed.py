"""What the long-term benchmarks share: a unit that is its own source, a stream followed, a table."""

from dataclasses import dataclass

import numpy as np

from softcal.app.registry.unit import source_state
from softcal.core.metrics import rmse
from softcal.core.network.config import NetworkConfig
from softcal.core.network.network import Network
from softcal.core.network.training import fit_network
from softcal.core.operation.adapter import QUEUES, AdaptConfig, Adapter
from softcal.core.operation.method import DriftTracking, OnlineConfig
from softcal.core.operation.queued_transport import QueuedTransport
from softcal.core.operation.stream_estimator import MapUpdate, StreamEstimator
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.unit.state import UnitState


@dataclass(frozen=True, eq=False)
class Unit:
    """A unit calibrated against its own reference."""

    source: LabelledRecording
    network: Network
    calibration: UnitState

    def adapter(self, mode: str, calibrated: OutputRecording | None = None) -> StreamEstimator:
        """Return what follows the unit in a mode, from its beginning; `ot 1500` has a queue of 1500 windows.

        Args:
            calibrated: its recording at calibration, where it is not the source itself.
        """
        calibration_inputs = (self.network, self.calibration, calibrated or self.source.unlabelled)
        mode, _, queue = mode.partition(" ")
        if mode not in QUEUES:
            return Adapter(*calibration_inputs, AdaptConfig(mode))
        online = OnlineConfig(int(queue)) if queue else OnlineConfig()
        return QueuedTransport(*calibration_inputs, self.source, AdaptConfig(mode, DriftTracking(online=online)))


def calibrate(t_s: Array, output: Array, reference: Array, rate_Hz: float, config: NetworkConfig) -> Unit:
    """Train f on a labelled stretch and give the unit the identity as its map."""
    source = LabelledRecording(OutputRecording("unit", t_s, output, rate_Hz), reference)
    network = fit_network(source, config).network
    return Unit(source, network, source_state(source, network))


def follow(
    unit: Unit, mode: str, t_s: Array, output: Array, calibrated: OutputRecording | None = None
) -> tuple[Array, list[MapUpdate]]:
    """Return the estimates of a stream and what happened to the map."""
    adapter = unit.adapter(mode, calibrated)
    return adapter.advance(t_s, output).estimate, adapter.take_updates()


def part_rmse(estimate: Array, reference: Array, parts: int) -> list[float]:
    """Return the RMSE of equal parts of a stream."""
    edges = np.linspace(0, len(reference), parts + 1).astype(int)
    return [rmse(estimate[a:b], reference[a:b]) for a, b in zip(edges[:-1], edges[1:], strict=True)]
