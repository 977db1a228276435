"""A calibrated unit as the registry keeps it: what its estimate f∘γ is made of."""

from softcal.core.lot import Lot
from softcal.core.network.network import Network
from softcal.core.unit.calibration import Calibration
from softcal.db.registry import Registry


def calibrated_unit(
    registry: Registry, serial: str, revision: int | None = None, lot_id: str | None = None
) -> tuple[Lot, Network, Calibration]:
    """Return the lot, the shared network and the calibration of a unit.

    Raises:
        InputError: the registry has no calibration of the serial, or it stands in several lots and none is named.
    """
    stored = registry.calibration(serial, revision, lot_id=lot_id)
    network = registry.network(stored.record.network_id)
    return registry.lot(stored.lot_id), network, Calibration.from_record(stored.record)
