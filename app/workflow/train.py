"""Train the shared network f of a lot, or find the one trained before from the same recording and configuration."""

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


def training_sha256(source: LabelledRecording, config: NetworkConfig) -> str:
    """Return the content hash of all that a training depends on."""
    arrays = {"t_s": source.unlabelled.t_s, "output": source.unlabelled.output, "reference": source.reference}
    units = {"output_unit": source.unlabelled.output_unit, "reference_unit": source.reference_unit}
    return content_sha256(arrays, {"config": asdict(config), **units})


def train_or_find(
    lot: Lot,
    source: LabelledRecording,
    registry: Registry,
    config: NetworkConfig,
    actor: str,
    on_epoch: Callable[[EpochReport], None] | None = None,
    timer: Callable[[], float] | None = None,
) -> TrainedOrFound:
    """Return the registered network of this source and configuration; train and register it where there is none."""
    import time

    now = timer or time.perf_counter
    registry.add_lot(lot.id, lot.sensor_model, lot.settings(), actor=actor)
    recording_sha256 = registry.add_recording(lot.id, lot.source, "source", source.unlabelled, source.reference)
    input_sha256 = training_sha256(source, config)
    found = registry.find_network(input_sha256)
    if found is not None:
        return TrainedOrFound(found, False, dict(registry.network_metrics(found.id)))
    start_s = now()
    trained = fit_network(source, config, on_epoch)
    metrics = {
        "validation_rmse": trained.validation_rmse,
        "epochs": float(trained.epochs),
        "train_s": now() - start_s,
    }
    registry.add_network(
        lot.id,
        trained.network,
        metrics,
        {"config": asdict(config), "source_recording_sha256": recording_sha256},
        input_sha256,
        actor=actor,
    )
    return TrainedOrFound(trained.network, True, metrics)
