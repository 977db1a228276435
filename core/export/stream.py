"""The firmware's way through a recording in Python: one sample in, the estimate out, with every flag; and the trim."""

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from softcal.core.export.integer_network import ACTIVATION_MAX
from softcal.core.export.loader import STALE, STUCK, WARM_UP, WRONG_RATE, DeviceSensor
from softcal.core.windows import TAPS

STUCK_ms = 60_000
"""A code that stays the same for so long is flagged."""

MOST_TRIM_SAMPLES = 4096

MOST_REACH = 65_535
MOST_LOAD_ERROR = 16_383


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
    least: int
    most: int

    @classmethod
    def of(cls, period_us: int, gap_ms: int) -> "RatePlan":
        """Plan for a sample period in µs."""
        return cls(gap_ms, (period_us - 1) // 2000, 63 * period_us // 5000, 77 * period_us // 5000)

    def is_kept(self, steps_ms: list[int]) -> bool:
        """Whether the steps within a window (all but the one to its oldest sample) keep to the plan."""
        return min(steps_ms) >= self.step and self.least <= sum(steps_ms) + 1 and sum(steps_ms) <= self.most + 1


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
    reach: tuple[int, int] = (0, 0)

    def reach_at(self, value: int) -> int:
        """Return the 90 % half-width of what the trim leaves open at an estimate, in counts.

        The errors at the two loads are independent and run in a straight line between and beyond them.
        """
        apart = abs(self.loads[1] - self.loads[0])
        if not apart:
            return 0
        away = abs(value - self.loads[1]), abs(value - self.loads[0])
        parts = [min(MOST_REACH, -(-reach * far // apart)) for reach, far in zip(self.reach, away, strict=True)]
        return joined(parts[0], parts[1])


def joined(a: int, b: int) -> int:
    """Return the root of a² + b², rounded up, at most `MOST_REACH`; to two counts where one is beyond 15 bits."""
    if not b:
        return a
    step = 2 if max(a, b) > ACTIVATION_MAX else 1
    square = (-(-a // step)) ** 2 + (-(-b // step)) ** 2
    root = math.isqrt(square)
    return min(MOST_REACH, step * (root + (root * root < square)))


class DeviceStream:
    """The firmware's ring buffer: gaps, staleness, rate and a stuck code are flagged alike."""

    def __init__(self, sensor: DeviceSensor, trim: Trim = Trim()) -> None:  # noqa: B008
        self._sensor, self._trim = sensor, trim
        self._plan = RatePlan.of(sensor.network_file.period_us, sensor.network_file.gap_ms)
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
        mapped = self._trim.shift.apply(int(unit.device_map.on_samples(np.array([code]))[0]), unit.adapt.low)
        self._ring = np.append(self._ring[1:], mapped)
        self._outside = np.append(self._outside[1:], not unit.code_min <= code <= unit.code_max)
        self._steps = [*self._steps[1:], step]
        self._filled = min(self._filled + 1, TAPS)
        self._last_ms, self._last_code = t_ms, code

    def read(self, now_ms: int) -> tuple[int, int, int, int]:
        """Return value, lower, upper in counts, and flags; all values 0 where there is no number yet."""
        if self._filled < TAPS:
            return 0, 0, 0, WARM_UP
        found = self._sensor.estimate_mapped(self._ring[None, :], self._outside[None, :])
        flags = int(found.flags[0]) | STUCK * self._is_stuck
        flags |= STALE * ((now_ms - self._last_ms) % 2**32 > self._plan.gap)
        flags |= WRONG_RATE * (not self._plan.is_kept(self._steps[1:]))
        value, reach = int(found.value[0]), self._trim.reach_at(int(found.value[0]))
        minus, plus = (int(side[0]) for side in self._sensor.reach(found.value))
        lower, upper = value - joined(minus, reach), value + joined(plus, reach)
        return value, max(-ACTIVATION_MAX, lower), min(ACTIVATION_MAX, upper), flags


class TrimResult(IntEnum):
    """How a trim ended; the same numbers as `ss_trim_result` in softsensor.h."""

    TRIMMED = 0
    MORE = 1
    MOVING = 2
    OUT_OF_REACH = 3
    TOO_FAR = 4
    TOO_CLOSE = 5


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
    if min(map(len, codes)) < TAPS:
        return TrimResult.MORE, Trim()
    if loads[0] == loads[1] or max(errors) > MOST_LOAD_ERROR:
        return TrimResult.TOO_CLOSE, Trim()
    mapped = [sensor.unit_file.device_map.on_samples(c[:MOST_TRIM_SAMPLES]) for c in codes]
    seen = [_towards_zero(int(y.sum()), len(y)) for y in mapped]
    apart = seen[1] - seen[0]
    if apart == 0 or any(4 * int(np.ptp(y)) > abs(apart) for y in mapped):
        return TrimResult.MOVING, Trim()
    wanted = [_rest_of(sensor, load) for load in loads]
    if wanted[0] is None or wanted[1] is None:
        return TrimResult.OUT_OF_REACH, Trim()
    missing = wanted[1] - wanted[0] - apart
    if abs(missing) > abs(apart) // 2:
        return TrimResult.TOO_FAR, Trim()
    gain = _towards_zero(missing * 2**15, apart)
    offset = wanted[0] - seen[0] - (gain * (seen[0] - sensor.unit_file.adapt.low) >> 15)
    if abs(offset) > ACTIVATION_MAX:
        return TrimResult.TOO_FAR, Trim()
    shift = Shift(gain, offset)
    first, second = (_load_reach(sensor, mapped[k], shift, loads[k], errors[k]) for k in (0, 1))
    return TrimResult.TRIMMED, Trim(shift, loads, (first, second))


def _load_reach(sensor: DeviceSensor, seen: np.ndarray, shift: Shift, load: int, error: int) -> int:
    """The 90 % half-width of what is not known at one load, in counts.

    How well the load itself is known; where within the range of its readings the level lies (rectangular, GUM 4.3.7,
    widened by a count for rounding); and the error of the unit's calibration.
    """
    low = shift.apply(int(seen.min()) - 1, sensor.unit_file.adapt.low)
    high = shift.apply(int(seen.max()) + 1, sensor.unit_file.adapt.low)
    spread = abs(_at_rest(sensor, high) - _at_rest(sensor, low))
    # 122 / 256 is 1.645 / sqrt(12), 422 / 256 is 1.645, both rounded up.
    read = joined(-(-122 * spread // 256), -(-422 * error // 256))
    return joined(read, max(int(side[0]) for side in sensor.reach(np.array([load]))))


def _at_rest(sensor: DeviceSensor, y: int) -> int:
    """The estimate, not clamped, of a window in which every mapped sample is y."""
    window = sensor.unit_file.device_map.on_windows(np.full((1, TAPS), y, dtype=np.int64))
    return int(sensor.network_file.network.evaluate(window)[0])


def _towards_zero(a: int, b: int) -> int:
    return abs(a) // abs(b) * (1 if (a < 0) == (b < 0) else -1)


def _rest_of(sensor: DeviceSensor, known: int) -> int | None:
    """The mapped sample that at rest gives `known`, by bisection between the calibrated codes; None where none does."""
    unit = sensor.unit_file

    def at_rest(y: int) -> int:
        return _at_rest(sensor, y)

    ends = unit.device_map.on_samples(np.array([unit.code_min, unit.code_max]))
    a, b = sorted((int(ends[0]), int(ends[1])), key=at_rest)
    if not at_rest(a) <= known <= at_rest(b):
        return None
    while abs(b - a) > 1:
        middle = a + _towards_zero(b - a, 2)
        a, b = (middle, b) if at_rest(middle) < known else (a, middle)
    return a if known - at_rest(a) <= at_rest(b) - known else b
