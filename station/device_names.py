"""How messages call a device, in the language of whoever reads them."""

from softcal.core.messages.reason import Reason, plain, reason

CELL, READOUT = "load cell", "sensor readout"
"""What shipped drivers call themselves."""

_NAMES = {
    "stage": Reason("device.stage"),
    CELL: Reason("device.cell"),
    READOUT: Reason("device.readout"),
    "gauge": Reason("device.gauge"),
    "readers": Reason("device.readers"),
}


def named(name: str, port: str = "") -> Reason:
    """Return the name of a device for a sentence, with its port where two must be told apart."""
    if not name:
        return plain(port)
    device = _NAMES.get(name) or plain(name)
    return reason("device.at", device=device, port=port) if port else device
