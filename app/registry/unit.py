"""A calibrated unit as the registry keeps it: what its estimate f∘γ is made of."""

from dataclasses import dataclass

from softcal.app.registry.lot_recordings import source_recording, unlabelled
from softcal.core.lot import Lot
from softcal.core.maps.affine_map import AffineMap
from softcal.core.network.network import Network
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.unit.calibration import Calibration
from softcal.core.unit.health import output_limits
from softcal.core.unit.knowledge import known_by
from softcal.core.unit.source_model import make_source_model
from softcal.core.unit.uncertainty import ErrorForecast
from softcal.core.unit.verdict import Decision, Judgement, Verdict
from softcal.core.words.reason import plain
from softcal.db.registry import Registry


def calibrated_unit(
    registry: Registry, serial: str, revision: int | None = None, lot_id: str | None = None
) -> tuple[Lot, Network, Calibration]:
    """Return the lot, the shared network and the calibration of a unit.

    Raises:
        InputError: the registry has no calibration of the serial, or it stands in several lots and none is named.
    """
    stored = registry.calibrations.get(serial, revision, lot_id=lot_id)
    network = registry.networks.get(stored.record.network_id)
    return registry.lots.get(stored.lot_id), network, Calibration.from_record(stored.record)


REASON = "the source unit itself: the shared network needs no map"


@dataclass(frozen=True, eq=False)
class UnitInUse:
    """All that following a unit needs from the registry.

    Args:
        revision: of the calibration it starts from.
        recording: the unit's own output at calibration.
    """

    lot: Lot
    revision: int
    network: Network
    calibration: Calibration
    recording: OutputRecording


def unit_in_use(registry: Registry, serial: str, revision: int | None = None, lot_id: str | None = None) -> UnitInUse:
    """Return a unit as the registry knows it. The source of a lot has the identity as its map.

    Raises:
        InputError: the registry has no calibration of the serial, and it is not the source of a lot with a network.
    """
    if revision is None and not registry.calibrations.history(serial, lot_id):
        _register_source(registry, serial, lot_id)
    stored = registry.calibrations.get(serial, revision, lot_id=lot_id)
    output = unlabelled(registry.recordings.get(stored.record.recording_sha256))
    network = registry.networks.get(stored.record.network_id)
    calibration = Calibration.from_record(stored.record)
    return UnitInUse(registry.lots.get(stored.lot_id), stored.revision, network, calibration, output)


def _register_source(registry: Registry, serial: str, lot_id: str | None) -> None:
    """Give the source of a lot its calibration: f itself with the identity map."""
    lots = [lot for lot in registry.lots.all() if lot.source == serial and lot_id in (None, lot.id)]
    sources = {entry.sha256: lot.id for lot in lots for entry in registry.recordings.of_lot(lot.id, serial, "source")}
    trained = [entry for entry in registry.networks.all() if entry.training.get("source_recording_sha256") in sources]
    if not trained:
        return
    network = trained[-1]
    source = source_recording(registry, network.id)
    calibration = source_calibration(source, registry.networks.get(network.id))
    record = calibration.to_record(input_sha256=network.input_sha256, recording_sha256=source.sha256)
    registry.calibrations.add(sources[source.sha256], record, reason=REASON)


def source_calibration(source: LabelledRecording, network: Network) -> Calibration:
    """Return the calibration of the source unit itself."""
    model = make_source_model(source, network)
    error, known = model.held_out_rmse, source.unlabelled
    return Calibration(
        serial=source.serial,
        network_id=network.id,
        unit_map=AffineMap(1.0, 0.0, "identity"),
        interval=model.interval,
        output_limits=output_limits(known, known, model.interval.slope_limit > 0, model.method.health),
        forecast=ErrorForecast(error, error, error),
        decision=Decision(Judgement(Verdict.PASS, (plain(REASON),))),
        knowledge=known_by({}, model.method.knowledge),
        evidence={},
        method=model.method,
    )
