"""f∘γ over a recording, each estimate with its 90 % interval and a flag; their only composition."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softcal.core.errors import InputError
from softcal.core.maps.interface import mapped_segments
from softcal.core.network.network import Network
from softcal.core.recording import Array, Indices, OutputRecording
from softcal.core.unit.health import run_lengths
from softcal.core.unit.state import UnitState
from softcal.core.windows import TAPS

Flags = NDArray[np.str_]
FLAG_TYPE = "<U12"
WARM_UP, GAP, INVALID = "warm-up", "gap", "invalid"
STUCK, SATURATED, OUT_OF_RANGE, UNFAMILIAR = "stuck", "saturated", "out of range", "unfamiliar"


@dataclass(frozen=True, eq=False)
class Estimate:
    """What a unit says about the reference, sample by sample.

    Args:
        t_s: (n,) time stamps in s.
        estimate: (n,) in `reference_unit`; NaN where no full window ends.
        lower, upper: (n,) ends of the 90 % interval, lower <= estimate <= upper.
        flag: (n,) empty where the row is trusted, else why not. No full window: `warm-up` after the start, `gap` after
            one. No usable sample or time: `invalid`. The output does not move: `stuck`; is at a rail: `saturated`.
            Beyond the loads of the source: `out of range`. A window unlike any of the source: `unfamiliar`.
    """

    t_s: Array
    estimate: Array
    lower: Array
    upper: Array
    flag: Flags
    reference_unit: str = "N"

    def spread(self, t_s: Array, rows: Indices) -> "Estimate":
        """Return the estimate with a row for each row of its data: those that are no sample of it are `invalid`.

        Args:
            t_s: (m,) time stamps of the data.
            rows: (n,) the row of each sample among them.
        """
        numbers: dict[str, Array] = {}
        for name in ("estimate", "lower", "upper"):
            numbers[name] = np.full(len(t_s), np.nan)
            numbers[name][rows] = getattr(self, name)
        flag = np.full(len(t_s), INVALID, dtype=FLAG_TYPE)
        flag[rows] = self.flag
        return Estimate(t_s, **numbers, flag=flag, reference_unit=self.reference_unit)


@dataclass(frozen=True)
class EstimateRow:
    """One row of an `Estimate`."""

    t_s: float
    estimate: float
    lower: float
    upper: float
    flag: str


def estimate(network: Network, calibration: UnitState, recording: OutputRecording) -> Estimate:
    """Estimate the reference over a whole recording.

    Raises:
        InputError: the calibration belongs to another network, or the output has another physical unit.
    """
    check_fits(network, calibration, recording.output_unit)
    n = len(recording)
    value, lower, upper = (np.full(n, np.nan) for _ in range(3))
    flag = np.full(n, GAP, dtype=FLAG_TYPE)
    flag[recording.segments[0]] = WARM_UP
    for rows, mapped in mapped_segments(calibration.unit_map, recording):
        output = recording.output[rows.start - TAPS + 1 : rows.stop]
        newest = slice(TAPS - 1, None)
        value[rows], lower[rows], upper[rows], flag[rows] = evaluate_windows(
            network, calibration, mapped, output[newest], run_lengths(output)[newest]
        )
    return Estimate(recording.t_s, value, lower, upper, flag, network.reference_unit)


def check_fits(network: Network, calibration: UnitState, output_unit: str) -> None:
    """Refuse a calibration of another network, or an output in another physical unit, with `InputError`."""
    if calibration.fit.network_id != network.id:
        raise InputError(
            f"unit {calibration.serial} was calibrated with network {calibration.fit.network_id[:12]}, "
            f"this one is {network.id[:12]}; use the one it was calibrated with"
        )
    if output_unit != network.output_unit:
        raise InputError(f"output is in {output_unit}, the calibration expects {network.output_unit}")


def evaluate_windows(
    network: Network, calibration: UnitState, mapped: Array, newest: Array, run: Indices
) -> tuple[Array, Array, Array, Flags]:
    """Return estimate, lower, upper and flag of (n, TAPS) mapped windows.

    Args:
        mapped: windows in the space of the source, newest sample last.
        newest: (n,) raw output of the newest sample of each.
        run: (n,) how many samples, it included, have had exactly this value.
    """
    interval, limits = calibration.interval, calibration.fitted.output_limits
    value = network.evaluate(mapped)
    shape = interval.support.shape(mapped)
    distance = interval.support.distance(shape)
    half = interval.half(value, shape, distance)
    flag = np.full(len(value), "", dtype=FLAG_TYPE)
    flag[distance > interval.familiar_distance] = UNFAMILIAR
    margin = calibration.fit.method.range_margin * (interval.high - interval.low)
    flag[(value < interval.low - margin) | (value > interval.high + margin)] = OUT_OF_RANGE
    flag[(newest <= limits.rail_low) | (newest >= limits.rail_high)] = SATURATED
    flag[run >= limits.stuck_samples] = STUCK
    return value, value - half, value + half, flag
