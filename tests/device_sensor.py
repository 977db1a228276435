"""A unit's device files opened and evaluated in NumPy: the reference that firmware and readers are compared with."""

import numpy as np

from softcal.core.export.blob_reader import read_network, read_unit
from softcal.core.export.integer_network import Integers
from softcal.core.export.loader import DeviceSensor, join
from softcal.core.recording import Array


def open_sensor(network: bytes, unit: bytes, serial: str | None = None) -> DeviceSensor:
    """Return the sensor of the contents of two files (`FileRefused`: the first check that fails)."""
    return join(read_network(network), read_unit(unit), serial)


def estimate_output(sensor: DeviceSensor, windows: Array) -> tuple[Array, Array, Array, Integers]:
    """Return estimate, lower, upper in reference units, and flags, of (n, TAPS) windows in the output unit."""
    estimates = sensor.estimate(sensor.unit_file.scale.codes(windows))
    count = 10.0**sensor.network_file.network.output_exponent
    value, lower, upper = (
        counts.astype(np.float64) * count for counts in (estimates.value, estimates.lower, estimates.upper)
    )
    return value, lower, upper, estimates.flags
