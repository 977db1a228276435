"""The firmware's way through a recording in Python: one sample in, the estimate out, with every flag; and the trim."""

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from softcal.core.export.blob import UnitFile
from softcal.core.export.integer_network import ACTIVATION_MAX, Integers
from softcal.core.export.loader import STALE, STUCK, WARM_UP, WRONG_RATE, DeviceSensor
from softcal.core.windows import TAPS

STUCK_ms = 60_000
"""A code that stays the same for so long is flagged."""

MAX_TRIM_SAMPLES = 4096

MAX_HALF_WIDTH = 65_535
MAX_LOAD_ERROR = 16_383


@dataclass(frozen=True)
class RatePlan:
    """When the samples of one window have to come, in ms; whole numbers as the firmware computes them.

    Args:
        gap: a longer step empties the window.
        step: a shorter step is flagged: half a period, less the ms that whole ms may hide.
        least, most: time from the oldest sample of a window to its newest, 14 periods within 10 %.
    """

    gap: int
    step: int
    minimum: int
    maximum: int

    @classmethod
    def from_period(cls, period_us: int, gap_ms: int) -> "RatePlan":
        """Plan for a sample period in µs."""
        return cls(gap_ms, (period_us - 1) // 2000, 63 * period_us // 5000, 77 * period_us // 5000)

    def keeps_rate(self, steps_ms: list[int]) -> bool:
        """Whether the steps within a window (all but the one to its oldest sample) keep to the plan."""
        return min(steps_ms) >= self.step and self.minimum <= sum(steps_ms) + 1 and sum(steps_ms) <= self.maximum + 1


@dataclass(frozen=True)
class Shift:
    """A change of mapped samples: y + offset + (gain (y - low) >> 15), gain in 2^-15, offset in source counts."""

    gain: int = 0
    offset: int = 0

    def apply(self, y: int, low: int) -> int:
        """Move one mapped sample; `low` is the unit's low level."""
        moved = y + self.offset + (self.gain * (y - low) >> 15)
        return max(-ACTIVATION_MAX, min(ACTIVATION_MAX, moved))


@dataclass(frozen=True)
class Trim:
    """What two known loads have shown; all zeros without a trim.

    Args:
        shift: of mapped samples.
        loads: the two loads, in counts as estimates are.
        reach: 90 % half-width of what is not known at each of them, in the same counts.
    """

    shift: Shift = Shift()
    loads: tuple[int, int] = (0, 0)
    half_widths: tuple[int, int] = (0, 0)

    def half_width_at(self, value: int) -> int:
        """Return the 90 % half-width of what the trim leaves open at an estimate, in counts.

        The errors at the two loads are independent and run in a straight line between and beyond them.
        """
        apart = abs(self.loads[1] - self.loads[0])
        if not apart:
            return 0
        away = abs(value - self.loads[1]), abs(value - self.loads[0])
        parts = [
            min(MAX_HALF_WIDTH, -(-half_widths * far // apart))
            for half_widths, far in zip(self.half_widths, away, strict=True)
        ]
        return joined(parts[0], parts[1])


def joined(a: int, b: int) -> int:
    """Return the root of a² + b², rounded up, at most `MOST_REACH`; to two counts where one is beyond 15 bits."""
    if not b:
        return a
    step = 2 if max(a, b) > ACTIVATION_MAX else 1
    square = (-(-a // step)) ** 2 + (-(-b // step)) ** 2
    root = math.isqrt(square)
    return min(MAX_HALF_WIDTH, step * (root + (root * root < square)))


class DeviceStream:
    """The firmware's ring buffer: gaps, staleness, rate and a stuck code are flagged alike."""

    def __init__(self, sensor: DeviceSensor, trim: Trim = Trim()) -> None:  # noqa: B008
        self._sensor, self._trim = sensor, trim
        self._plan = RatePlan.from_period(sensor.network_file.period_us, sensor.network_file.gap_ms)
        self._ring = np.zeros(TAPS, dtype=np.int64)
        self._outside = np.zeros(TAPS, dtype=np.bool_)
        self._steps = [0] * TAPS
        self._filled, self._last_ms, self._moved_ms, self._last_code, self._is_stuck = 0, 0, 0, 0, False

    def push(self, code: int, t_ms: int) -> None:
        """Take one 16-bit code; a step over 1.5 periods empties the window."""
        unit = self._sensor.unit_file
        step = (t_ms - self._last_ms) % 2**32
        if step > self._plan.gap:
            self._filled = 0
        if not self._filled or code != self._last_code:
            self._is_stuck, self._moved_ms = False, t_ms
        self._is_stuck |= (t_ms - self._moved_ms) % 2**32 >= STUCK_ms
        mapped = self._trim.shift.apply(int(unit.device_map.on_samples(np.array([code]))[0]), unit.pivot)
        self._ring = np.append(self._ring[1:], mapped)
        self._outside = np.append(self._outside[1:], self._is_outside(code, mapped))
        self._steps = [*self._steps[1:], step]
        self._filled = min(self._filled + 1, TAPS)
        self._last_ms, self._last_code = t_ms, code

    def _is_outside(self, code: int, mapped: int) -> bool:
        """Whether a sample is out of range: after a trim it is judged where the trim has put it."""
        unit = self._sensor.unit_file
        if self._trim.shift == Shift():
            return not unit.code_min <= code <= unit.code_max
        ends = unit.device_map.on_samples(np.array([unit.code_min, unit.code_max]))
        return not ends.min() <= mapped <= ends.max() or bool(is_beyond(unit, np.array([code]))[0])

    def read(self, now_ms: int) -> tuple[int, int, int, int]:
        """Return value, lower, upper in counts, and flags; all values 0 where there is no number yet."""
        if self._filled < TAPS:
            return 0, 0, 0, WARM_UP
        sensor_estimate = self._sensor.estimate_mapped(self._ring[None, :], self._outside[None, :])
        flags = int(sensor_estimate.flags[0]) | STUCK * self._is_stuck
        flags |= STALE * ((now_ms - self._last_ms) % 2**32 > self._plan.gap)
        flags |= WRONG_RATE * (not self._plan.keeps_rate(self._steps[1:]))
        value, half_width = int(sensor_estimate.value[0]), self._trim.half_width_at(int(sensor_estimate.value[0]))
        minus, plus = (int(side[0]) for side in self._sensor.half_widths(sensor_estimate.value))
        lower, upper = value - joined(minus, half_width), value + joined(plus, half_width)
        return value, max(-ACTIVATION_MAX, lower), min(ACTIVATION_MAX, upper), flags


class TrimResult(IntEnum):
    """How a trim ended; the same numbers as `ss_trim_result` in softsensor.h."""

    TRIMMED = 0
    MORE = 1
    MOVING = 2
    OUT_OF_RANGE = 3
    TOO_FAR = 4
    TOO_CLOSE = 5
    ALIKE = 6
    NEEDLESS = 7
    WORSE = 8


def find_trim(
    sensor: DeviceSensor, codes: tuple[np.ndarray, np.ndarray], loads: tuple[int, int], errors: tuple[int, int]
) -> tuple[TrimResult, Trim]:
    """Find the shift that brings a unit back to two known loads, and how well it is known.

    Args:
        sensor: the unit.
        codes: codes while load 0 and load 1 rested on it, 15 or more of each.
        loads: the two loads in counts, as estimates are.
        errors: their standard uncertainties in the same counts.

    Returns:
        how it ended, and the trim; none unless TRIMMED.
    """
    levels, unit = sensor.network_file.levels, sensor.unit_file
    if min(map(len, codes)) < TAPS:
        return TrimResult.MORE, Trim()
    if loads[0] == loads[1] or max(errors) > MAX_LOAD_ERROR:
        return TrimResult.TOO_CLOSE, Trim()
    codes_used = [c[:MAX_TRIM_SAMPLES] for c in codes]
    targets = [y for load in loads if (y := _rest_of(sensor, levels.at(load))) is not None]
    if len(targets) < len(loads) or any(is_beyond(unit, c).any() for c in codes_used):
        return TrimResult.OUT_OF_RANGE, Trim()
    mapped = [unit.device_map.on_samples(c) for c in codes_used]
    mean_codes = [_towards_zero(int(y.sum()), len(y)) for y in mapped]
    apart, rise, load = mean_codes[1] - mean_codes[0], abs(targets[1] - targets[0]), abs(loads[1] - loads[0])
    if not rise or not apart:
        return TrimResult.ALIKE, Trim()
    if any(4 * int(np.ptp(y)) > abs(apart) for y in mapped):
        return TrimResult.MOVING, Trim()
    bias = [abs(_at_rest(sensor, targets[k]) - loads[k]) for k in (0, 1)]
    spread = [-(-(int(np.ptp(y)) + 2) * load // abs(apart)) for y in mapped]
    half_width = [_load_half_width(sensor, loads[k], spread[k], errors[k], bias[k]) for k in (0, 1)]
    open_ = joined(*half_width)
    if load <= open_ or abs(apart) * load // rise <= open_:
        return TrimResult.ALIKE, Trim()
    missing = targets[1] - targets[0] - apart
    if abs(missing) > abs(apart) // 2:
        return TrimResult.TOO_FAR, Trim()
    off = [min(MAX_HALF_WIDTH, abs(targets[k] - mean_codes[k]) * load // rise) for k in (0, 1)]
    if all(422 * off[k] <= 256 * half_width[k] for k in (0, 1)):
        return TrimResult.NEEDLESS, Trim()
    if joined(*bias) > joined(*(abs(_at_rest(sensor, mean_codes[k]) - loads[k]) for k in (0, 1))):
        return TrimResult.WORSE, Trim()
    gain = _towards_zero(missing * 2**15, apart)
    offset = targets[0] - mean_codes[0] - (gain * (mean_codes[0] - unit.pivot) >> 15)
    if abs(offset) > ACTIVATION_MAX:
        return TrimResult.TOO_FAR, Trim()
    return TrimResult.TRIMMED, Trim(Shift(gain, offset), loads, (half_width[0], half_width[1]))


def _load_half_width(sensor: DeviceSensor, load: int, spread: int, error: int, bias: int) -> int:
    """The 90 % half-width of what is not known at one load, in counts.

    How well the load itself is known; where within the range of its readings the level lies (rectangular, GUM 4.3.7,
    widened by a count for rounding); what f misreads at rest; and the error of the unit's calibration.
    """
    # 122 / 256 is 1.645 / sqrt(12), 422 / 256 is 1.645, both rounded up.
    read = joined(joined(-(-122 * spread // 256), -(-422 * error // 256)), bias)
    return joined(read, max(int(side[0]) for side in sensor.half_widths(np.array([load]))))


def _at_rest(sensor: DeviceSensor, y: int) -> int:
    """The estimate, not clamped, of a window in which every mapped sample is y."""
    window = sensor.unit_file.device_map.on_windows(np.full((1, TAPS), y, dtype=np.int64))
    return int(sensor.network_file.network.evaluate(window)[0])


def _towards_zero(a: int, b: int) -> int:
    return abs(a) // abs(b) * (1 if (a < 0) == (b < 0) else -1)


def _rest_of(sensor: DeviceSensor, level: int | None) -> int | None:
    """The mapped sample that at rest stands at a level of the source, by bisection; None where none does."""

    def at_rest(y: int) -> int:
        return int(sensor.unit_file.device_map.on_windows(np.full((1, TAPS), y, dtype=np.int64)).sum())

    if level is None:
        return None
    target = TAPS * level
    a, b = sorted((-ACTIVATION_MAX, ACTIVATION_MAX), key=at_rest)
    if not at_rest(a) <= target <= at_rest(b):
        return None
    while abs(b - a) > 1:
        middle = a + _towards_zero(b - a, 2)
        a, b = (middle, b) if at_rest(middle) < target else (a, middle)
    return a if target - at_rest(a) <= at_rest(b) - target else b


def is_beyond(unit: UnitFile, codes: Integers) -> NDArray[np.bool_]:
    """Return which codes lie beyond the knots of a unit's curve, where it stays constant and shows nothing."""
    curve = unit.device_map.curve
    if curve is None:
        return np.zeros(len(codes), dtype=np.bool_)
    return np.asarray((codes < curve.codes[0]) | (codes > curve.codes[-1]))
