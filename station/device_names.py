"""Names of devices in messages, in the language of the reader."""

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


def device_label(name: str, port: str = "") -> Reason:
    """Return the name of a device for a sentence, with its port where two devices have one name."""
    if not name:
        return plain(port)
    device = _NAMES.get(name) or plain(name)
    return reason("device.at", device=device, port=port) if port else device
