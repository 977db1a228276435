"""A calibrated unit from its two files alone, in pure NumPy, integer for integer.

`DeviceSensor.estimate` works on whole recordings; the firmware takes one sample at a time.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softcal.core.export.blob import FileRefused, NetworkFile, RefusalCause, SelfTest, UnitFile, serial_field
from softcal.core.export.integer_network import ACTIVATION_MAX, DeviceMap, IntegerNetwork, Integers
from softcal.core.windows import TAPS

WARM_UP, CLOSED, STALE, OUT_OF_RANGE, CLAMPED, WRONG_RATE, STUCK = 1, 2, 4, 8, 16, 32, 64
"""Flags of an estimate, as in softsensor.h."""


@dataclass(frozen=True, eq=False)
class DeviceEstimate:
    """Estimates in counts of 10^output_exponent, with 90 % interval and flags; each (n,)."""

    value: Integers
    lower: Integers
    upper: Integers
    flags: Integers


@dataclass(frozen=True, eq=False)
class DeviceSensor:
    """One unit with its shared network, opened and checked by its self-tests."""

    network_file: NetworkFile
    unit_file: UnitFile

    def estimate(self, codes: Integers) -> DeviceEstimate:
        """Estimate for every window (`codes`: (n, TAPS) windows of 16-bit codes, newest last)."""
        return self.estimate_mapped(
            self.unit_file.device_map.on_samples(codes),
            (codes < self.unit_file.code_min) | (codes > self.unit_file.code_max),
        )

    def estimate_mapped(self, ring: Integers, outside: NDArray[np.bool_]) -> DeviceEstimate:
        """Estimate for (n, TAPS) windows of the device's ring, and which samples were outside."""
        unit = self.unit_file
        raw = self.network_file.network.evaluate(unit.device_map.on_windows(ring))
        value = np.clip(raw, unit.out_min, unit.out_max)
        flags = OUT_OF_RANGE * outside.any(axis=1) + CLAMPED * (raw != value)
        minus, plus = self.half_widths(value)
        return DeviceEstimate(
            value,
            np.maximum(value - minus, -ACTIVATION_MAX),
            np.minimum(value + plus, ACTIVATION_MAX),
            flags.astype(np.int64),
        )

    def half_widths(self, value: Integers) -> tuple[Integers, Integers]:
        """Return how far the 90 % interval reaches below and above (n,) counts, each (n,)."""
        bands = self.unit_file.bands
        levels = np.array([band.level for band in bands[:-1]], dtype=np.int64)
        band = np.searchsorted(levels, value, side="left")
        minus = np.array([b.minus for b in bands], dtype=np.int64)[band]
        plus = np.array([b.plus for b in bands], dtype=np.int64)[band]
        return minus, plus


def run_self_test(network: IntegerNetwork, device_map: DeviceMap, test: SelfTest) -> int:
    """Return the estimate of a self-test's window."""
    codes = test.start + test.step * np.arange(TAPS, dtype=np.int64)
    return int(network.evaluate(device_map.apply(codes[None, :]))[0])


def join(network_file: NetworkFile, unit_file: UnitFile, serial: str | None = None) -> DeviceSensor:
    """Open two files that have been read: they belong together, and self-tests hold.

    Raises:
        FileRefused: the first check that fails.
    """
    if unit_file.network_id != network_file.id:
        raise FileRefused(
            RefusalCause.NETWORK,
            f"unit {unit_file.serial} belongs to network {unit_file.network_id.hex()}, this one is "
            f"{network_file.id.hex()}; use the network file exported with it",
        )
    if serial is not None and serial_field(serial) != serial_field(unit_file.serial):
        raise FileRefused(RefusalCause.SERIAL, f"the file is for unit {unit_file.serial}, this is unit {serial}")
    for number, test in enumerate(unit_file.self_tests, 1):
        result = run_self_test(network_file.network, unit_file.device_map, test)
        if result != test.expected:
            raise FileRefused(
                RefusalCause.SELF_TEST,
                f"self-test {number} of unit {unit_file.serial} gives {result}, {test.expected} was expected",
            )
    return DeviceSensor(network_file, unit_file)
