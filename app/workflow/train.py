"""Train the shared network f of a lot, or find the one trained before from the same recording and configuration."""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass

from softcal.core.identity import content_sha256
from softcal.core.lot import Lot
from softcal.core.network import Network
from softcal.core.recording import LabelledRecording
from softcal.core.training import EpochReport, NetworkConfig, fit_network
from softcal.db.registry import Registry


@dataclass(frozen=True, eq=False)
class TrainedOrFound:
    """The shared network of a lot.

    Args:
        network: f.
        is_new: whether it was trained now; otherwise the registry had it.
        metrics: errors on the validation blocks of the source and how long training took, in named units.
    """

    network: Network
    is_new: bool
    metrics: dict[str, float]


def train_or_find(
    lot: Lot,
    source: LabelledRecording,
    registry: Registry,
    config: NetworkConfig,
    actor: str | None = None,
    on_epoch: Callable[[EpochReport], None] | None = None,
) -> TrainedOrFound:
    """Return the registered network of this source and configuration; train and register it where there is none."""
    registry.add_lot(lot, actor=actor)
    recording_sha256 = registry.add_recording(lot.id, source, "source", actor=actor)
    input_sha256 = content_sha256({}, {"source": recording_sha256, "config": asdict(config)})
    found = registry.find_network(input_sha256)
    if found is not None:
        return _registered(registry, found, False)
    start_s = time.perf_counter()
    trained = fit_network(source, config, on_epoch)
    metrics = {
        "validation_rmse": trained.validation_rmse,
        "epochs": float(max(trained.epochs)),
        "train_s": time.perf_counter() - start_s,
    }
    training = {"config": asdict(config), "source_recording_sha256": recording_sha256}
    # Another process may have trained the same in the meantime; the id that comes back is the one to go on with.
    network_id = registry.add_network(lot.id, trained.network, metrics, training, input_sha256, actor=actor)
    return _registered(registry, network_id, True)


def _registered(registry: Registry, network_id: str, is_new: bool) -> TrainedOrFound:
    metrics = {name: float(str(value)) for name, value in registry.network_entry(network_id).metrics.items()}
    return TrainedOrFound(registry.network(network_id), is_new, metrics)
