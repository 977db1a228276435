"""A calibrated unit of the registry, with the parts of its estimate f∘γ."""

from dataclasses import dataclass

from softcal.app.registry.lot_recordings import source_recording, unlabelled
from softcal.core.identity import content_sha256
from softcal.core.lot import Lot
from softcal.core.maps.affine_map import AffineMap
from softcal.core.maps.interface import map_sha256
from softcal.core.messages.reason import plain
from softcal.core.network.network import Network
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.unit.correspondence import find_correspondence
from softcal.core.unit.fit import Fit, FittedMap
from softcal.core.unit.health import output_limits
from softcal.core.unit.method import Method
from softcal.core.unit.source_model import make_source_model
from softcal.core.unit.state import UnitState
from softcal.core.unit.uncertainty import ErrorForecast
from softcal.core.unit.verdict import default_limit
from softcal.db.registry import Registry


def calibrated_unit(
    registry: Registry, serial: str, revision: int | None = None, lot_id: str | None = None
) -> tuple[Lot, Network, UnitState]:
    """Return the lot, the shared network and the state of a unit.

    Raises:
        InputError: the registry has no calibration of the serial, or several lots have it and no lot is given.
    """
    stored = registry.calibrations.get(serial, revision, lot_id=lot_id)
    network = registry.networks.get(stored.state.fit.network_id)
    return registry.lots.get(stored.lot_id), network, stored.state


REASON = "the source unit itself: the shared network needs no map"


@dataclass(frozen=True, eq=False)
class UnitInUse:
    """Data of the registry that drift tracking of a unit needs.

    Args:
        revision: of the calibration it starts from.
        recording: the unit's own output at calibration.
    """

    lot: Lot
    revision: int
    network: Network
    state: UnitState
    recording: OutputRecording


def unit_in_use(registry: Registry, serial: str, revision: int | None = None, lot_id: str | None = None) -> UnitInUse:
    """Return a unit of the registry. The source of a lot has the identity as its map.

    Raises:
        InputError: the registry has no calibration of the serial, and it is not the source of a lot with a network.
    """
    if revision is None and not registry.calibrations.history(serial, lot_id):
        _register_source(registry, serial, lot_id)
    stored = registry.calibrations.get(serial, revision, lot_id=lot_id)
    output = unlabelled(registry.recordings.get(stored.state.fit.recording_sha256))
    network = registry.networks.get(stored.state.fit.network_id)
    return UnitInUse(registry.lots.get(stored.lot_id), stored.revision, network, stored.state, output)


def _register_source(registry: Registry, serial: str, lot_id: str | None) -> None:
    """Store the calibration of a lot's source: f itself with the identity map."""
    lots = [lot for lot in registry.lots.all() if lot.source == serial and lot_id in (None, lot.id)]
    sources = {entry.sha256: lot.id for lot in lots for entry in registry.recordings.of_lot(lot.id, serial, "source")}
    networks = [entry for entry in registry.networks.all() if entry.training.get("source_recording_sha256") in sources]
    if not networks:
        return
    network = networks[-1]
    source = source_recording(registry, network.id)
    state = source_state(source, registry.networks.get(network.id))
    registry.calibrations.add(sources[source.sha256], state, reason=REASON)


def source_state(source: LabelledRecording, network: Network) -> UnitState:
    """Return the state of the source unit itself, which f reads without a map."""
    model = make_source_model(source, network, method=Method())
    error, output = model.held_out_rmse, source.unlabelled
    identity = AffineMap(1.0, 0.0, "identity")
    limits = output_limits(output, output, model.interval.slope_limit > 0, model.method)
    fit = Fit(
        id=content_sha256({}, {"source": source.sha256, "network": network.id, "method": model.method.id}),
        serial=source.serial,
        network_id=network.id,
        recording_sha256=source.sha256,
        family=identity.family,
        map_sha256=map_sha256(identity),
        method=model.method,
        correspondence=find_correspondence({}, model.method.correspondence),
        forecast=ErrorForecast(error, error, error),
        remarks=(plain(REASON),),
        fitted=FittedMap(identity, model.interval, limits),
    )
    return UnitState(
        fit=fit, limit=default_limit(source.reference_unit, error, model.full_range, model.method.decision)
    )
