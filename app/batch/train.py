"""Training of the shared network f of a lot, or the stored network of the same input."""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass

from softcal.app.batch.claims import Claims
from softcal.app.logs import note
from softcal.core.identity import content_sha256
from softcal.core.lot import Lot
from softcal.core.network.config import EpochReport, NetworkConfig
from softcal.core.network.network import Network
from softcal.core.network.training import fit_network
from softcal.core.recording import LabelledRecording
from softcal.db.queues.work_queue import WorkSet
from softcal.db.registry import Registry

POLL_S = 1.0
"""How often a process that waits for another one's network looks whether it is there."""


@dataclass(frozen=True, eq=False)
class LotNetwork:
    """The shared network of a lot, whether it was trained now, errors on the source's validation
    blocks and the time of training.
    """

    network: Network
    is_new: bool
    metrics: dict[str, float]


def provide_network(
    lot: Lot,
    source: LabelledRecording,
    registry: Registry,
    config: NetworkConfig,
    actor: str | None = None,
    on_epoch: Callable[[EpochReport], None] | None = None,
    proof_method: str | None = None,
) -> LotNetwork:
    """Return the network of this source and configuration, trained if it is not stored.

    If another process trains the same network, this call waits for it.
    """
    registry.lots.add(lot, actor=actor)
    recording_sha256 = registry.recordings.add(lot.id, source, "source", actor=actor, proof_method=proof_method)
    input_sha256 = content_sha256({}, {"source": recording_sha256, "config": asdict(config)})
    stored = registry.networks.find(input_sha256)
    if stored is not None:
        return _read_network(registry, stored, False)
    with Claims(registry, WorkSet(lot.id, input_sha256, "train")) as claims:
        claims.queue.enqueue(claims.work, {source.serial: input_sha256})
        # Claim the training, or wait for the process that has it; nothing is claimed where that one has
        # finished it
        while not (claimed := claims.take(1)) and claims.queue.counts(work=claims.work)["claimed"]:
            time.sleep(POLL_S)
        stored = registry.networks.find(input_sha256)
        if stored is not None:
            return _read_network(registry, stored, False)
        start_s = time.perf_counter()
        result = fit_network(source, config, on_epoch)
        metrics = {
            "validation_rmse": result.validation_rmse,
            "epochs": float(max(result.epochs)),
            "train_s": time.perf_counter() - start_s,
        }
        training = {"config": asdict(config), "source_recording_sha256": recording_sha256}
        # Who loses its lease finds the other one's network: go on with the id that comes back.
        id_ = registry.networks.add(lot.id, result.network, metrics, training, input_sha256, actor=actor)
        for item in claimed:
            claims.queue.finish(claims.owner, [item.id])
    note("network", lot=lot.id, network=id_, **metrics)
    return _read_network(registry, id_, True)


def _read_network(registry: Registry, network_id: str, is_new: bool) -> LotNetwork:
    metrics = {name: float(str(value)) for name, value in registry.networks.entry(network_id).metrics.items()}
    return LotNetwork(registry.networks.get(network_id), is_new, metrics)
