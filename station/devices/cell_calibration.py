"""The load cell's scale from dead weights: a line through weight and reading, and its errors."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from softcal.core.errors import BadReply, InputError
from softcal.core.messages.reason import Reason, reason
from softcal.core.recording import Array
from softcal.station.device_names import device_label
from softcal.station.interfaces import Clock, ForceReader
from softcal.station.wire.frames.force_unit import STANDARD_GRAVITY

SETTLE_S, READ_S, TICK_S = 1.0, 2.0, 0.01


@dataclass(frozen=True)
class CellCalibration:
    """The result of a calibration of a load cell with dead weights.

    Args:
        mass_kg: (n,) weights put on, 0 for the unloaded cell.
        reading: (n,) mean reading of each, in the scale the reader had.
        per_N, zero: reading = zero + per_N · force.
    """

    mass_kg: Array
    reading: Array
    noise: Array
    per_N: float
    zero: float
    largest_error_N: float


def read_steady(reader: ForceReader, clock: Clock) -> tuple[float, float]:
    """Return mean and standard deviation of some seconds after the weight has settled."""
    reader.start()
    _collect(reader, clock, SETTLE_S)
    values = _collect(reader, clock, READ_S)
    if len(values) < 5:
        raise BadReply(reason("rig.few_readings", device=device_label(reader.name), count=len(values), read_s=READ_S))
    return float(np.mean(values)), float(np.std(values))


def fit_cell(mass_kg: Sequence[float], reading: Sequence[float], noise: Sequence[float]) -> CellCalibration:
    """Fit the straight line through weights and readings.

    Args:
        mass_kg, reading, noise: (n,) as in `CellCalibration`; at least two different weights.

    Raises:
        InputError: fewer than two different weights.
        BadReply: the reading does not follow the weights.
    """
    masses, readings = np.asarray(mass_kg, dtype=np.float64), np.asarray(reading, dtype=np.float64)
    if len(np.unique(masses)) < 2:
        raise InputError(Reason("rig.one_weight"))
    force_N = masses * STANDARD_GRAVITY  # By place it differs by 0.5 % over the earth.
    per_N, zero = np.polyfit(force_N, readings, 1)
    if abs(per_N) * float(np.ptp(force_N)) < 10 * float(np.max(noise)):
        raise BadReply(Reason("rig.not_following"))
    error_N = np.abs((readings - zero) / per_N - force_N)
    return CellCalibration(masses, readings, np.asarray(noise), float(per_N), float(zero), float(np.max(error_N)))


def _collect(reader: ForceReader, clock: Clock, seconds: float) -> list[float]:
    values, end_s = [], clock.now_s() + seconds
    while clock.now_s() < end_s:
        clock.sleep_s(TICK_S)
        values += [sample.values[0] for sample in reader.poll()]
    return values
