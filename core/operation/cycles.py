"""Segmentation of a stream into cycles of use, each described by a few features; constant memory.

A cycle ends where the output rises through an upper threshold after it was below a lower one (hysteresis thresholding,
as a Schmitt trigger does). Nothing here knows of drift.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from softcal.core.operation.method import CycleConfig
from softcal.core.operation.stored_state import array_field, from_state, to_state
from softcal.core.recording import Array
from softcal.core.windows import TAPS

MAX_SAMPLES = 512
"""Samples kept of the cycle under way; of a longer one every second, fourth, ..."""


@dataclass(frozen=True, eq=False)
class Cycle:
    """One cycle of use, described by features of the output alone.

    Args:
        level: mean of the output, in its unit.
        scale: standard deviation, in the same unit.
        low, high: mean of the lowest and highest sixteenth of the samples: the turning points.
        shape: (q,) standardised quantiles, (quantile - level) / scale.
        course: (q,) standardised means of as many parts of its time, first to last.
        speed: RMS change over one window, in units of `scale`.
        duration_s: how long it took.
        end_s: time of its last sample.
        is_complete: False where the output did not turn within the longest time a cycle may take.
    """

    level: float
    scale: float
    low: float
    high: float
    shape: Array = field(metadata=array_field("q"))
    course: Array = field(metadata=array_field("q"))
    speed: float
    duration_s: float
    end_s: float
    is_complete: bool

    def rest(self, is_low: bool) -> float:
        """Return the unloaded turning point."""
        return self.low if is_low else self.high

    def standardised(self, mean: float, scale: float) -> "Cycle":
        """Return the cycle of the output (output - mean) / scale, scale > 0."""
        levels = {name: (getattr(self, name) - mean) / scale for name in ("level", "low", "high")}
        return replace(self, scale=self.scale / scale, **levels)


def end_spread(shape: Array, is_low: bool) -> float:
    """Return how far standardised quantiles spread at the lower or the upper end: a rest of one level spreads least."""
    return float(np.ptp(shape[:2] if is_low else shape[-2:]))


@dataclass
class SegmenterState:
    """What a restart needs.

    Args:
        low, high: turning points that cycles are cut with, in the unit of the output.
        cycle_samples: samples of a usual cycle.
        min_samples: fewest samples of a cycle; shorter ones are joined until they have so many.
        silent: samples since the output last turned, or since the swing was last taken anew.
        waits: how often the swing was taken anew since the last cycle.
        was_low: whether the output was below the lower threshold since the last cycle began.
        has_start: whether the cycle under way was seen from its start.
        samples: samples of the cycle under way, every `stride`th.
        tail: last TAPS - 1 samples, for changes over a window.
        stride, count: decimation of `samples`, and samples of the cycle so far.
        start_s, end_s: times of its first and newest sample.
        changes, squared_changes: number and sum of squares of its changes over a window.
    """

    low: float
    high: float
    cycle_samples: float
    min_samples: float
    silent: int = 0
    waits: int = 0
    was_low: bool = False
    has_start: bool = False
    samples: list[float] = field(default_factory=list)
    tail: list[float] = field(default_factory=list)
    stride: int = 1
    count: int = 0
    start_s: float = 0.0
    end_s: float = 0.0
    changes: int = 0
    squared_changes: float = 0.0


class CycleSegmenter:
    """Cuts gap-free samples into cycles.

    Args:
        low, high: where the output turned in the calibration recording, in its unit: the first swing to cut with.
        max_samples: most samples of a cycle; after that many the output counts as not cycling.
        config: thresholds and lengths.
    """

    def __init__(self, low: float, high: float, typical_samples: float, max_samples: int, config: CycleConfig) -> None:
        self._max_samples, self._config = max_samples, config
        # Shorter cycles are joined until a change over a window means something.
        min_samples = 2 * TAPS
        self._overdue_samples = config.overdue * max(typical_samples, min_samples)
        self._min_swing = config.band[0] * (high - low)
        self._levels = (np.arange(config.quantiles) + 0.5) / config.quantiles
        self._now = SegmenterState(low, high, typical_samples, min_samples)

    def restart(self) -> None:
        """Forget the cycle under way, after a gap or a fault: it ends in no `Cycle`."""
        self._now = SegmenterState(self._now.low, self._now.high, self._now.cycle_samples, self._now.min_samples)

    def join(self, samples: float) -> None:
        """Join cycles until they have so many samples from now on: single ones of an irregular use are not alike.

        By samples and not by number: joined cycles of one length have nearly equal durations.
        """
        # Never back to fewer: activities learnt of long cycles would all be strange to short ones.
        if samples > self._now.min_samples:
            self._now.min_samples = self._now.cycle_samples = samples
            self.restart()

    def advance(self, t_s: Array, output: Array) -> list[Cycle]:
        """Take (n,) further samples that follow the last ones without a gap; return the cycles that ended in them."""
        now, ended, start = self._now, [], 0
        for end in self._turns(output):
            self._collect(t_s[start:end], output[start:end])
            start = end
            if now.has_start and now.count >= now.min_samples:
                ended.append(self._finish(is_complete=True))
            elif not now.has_start:
                self._begin()
        self._collect(t_s[start:], output[start:])
        now.silent = len(output) - start + (0 if start else now.silent)
        overdue = max(self._overdue_samples, self._config.overdue * now.cycle_samples)
        # Twice as long each time until a cycle is found: one that lasts longer than the wait is never seen whole.
        max_silent = min(overdue * 2.0**now.waits, max(overdue, self._max_samples))
        if now.count >= max(self._max_samples, 2 * now.min_samples):
            ended.append(self._finish(is_complete=False))
        elif now.silent > max_silent:
            # The turning points of the samples since the last turn.
            recent = now.samples[-max(1, now.silent // now.stride) :]
            low, high = (float(v) for v in np.quantile(recent, self._config.swing))
            now.silent = 0
            # Noise at rest also has a swing. Cut with it, a pause would give cycles of its own.
            if high - low >= self._min_swing:
                now.low, now.high = low, high
                now.was_low, now.has_start = False, False
                now.waits += 1
        return ended

    def _turns(self, output: Array) -> list[int]:
        """Return the positions where a new cycle begins."""
        now, (lower, upper) = self._now, self._config.band
        turns, position = [], 0
        swing = now.high - now.low
        # Two thresholds (hysteresis): noise at a single one would cut one cycle into many.
        below = output < now.low + lower * swing
        above = output > now.low + upper * swing
        while position < len(output):
            is_beyond = above if now.was_low else below
            step = int(np.argmax(is_beyond[position:]))
            if not is_beyond[position + step]:
                break
            position += step
            if now.was_low:
                turns.append(position)
            now.was_low = not now.was_low
        return turns

    def _begin(self) -> None:
        now = self._now
        now.samples = []
        now.stride, now.count = 1, 0
        now.changes, now.squared_changes = 0, 0.0
        now.has_start = True

    def _collect(self, t_s: Array, output: Array) -> None:
        if not len(output):
            return
        now = self._now
        if now.count == 0:
            now.start_s = float(t_s[0])
        now.end_s = float(t_s[-1])
        first = -now.count % now.stride
        now.samples.extend(output[first :: now.stride].tolist())
        # Halving keeps the samples evenly spaced however long the cycle becomes; a reservoir would need random numbers.
        while len(now.samples) > MAX_SAMPLES:
            now.samples, now.stride = now.samples[::2], 2 * now.stride
        now.count += len(output)
        joined = np.concatenate([now.tail, output])
        changes = joined[TAPS - 1 :] - joined[: -TAPS + 1]
        now.changes += len(changes)
        now.squared_changes += float(changes @ changes)
        now.tail = joined[-TAPS + 1 :].tolist()

    def _finish(self, is_complete: bool) -> Cycle:
        now, config = self._now, self._config
        parts = np.array_split(now.samples, config.quantiles)
        course = np.array([part.mean() if len(part) else now.samples[-1] for part in parts])
        values = np.sort(now.samples)
        level, scale = float(values.mean()), float(values.std())
        # Means of many samples: single extremes would follow the noise.
        part = max(1, len(values) // config.quantiles)
        low, high = float(values[:part].mean()), float(values[-part:].mean())
        quantiles = np.interp(self._levels, (np.arange(len(values)) + 0.5) / len(values), values)
        speed = np.sqrt(now.squared_changes / max(1, now.changes)) / max(scale, 1e-300)
        cycle = Cycle(
            level=level,
            scale=scale,
            low=low,
            high=high,
            shape=(quantiles - level) / max(scale, 1e-300),
            course=(course - course.mean()) / max(float(course.std()), 1e-300),
            speed=float(speed),
            duration_s=now.end_s - now.start_s,
            end_s=now.end_s,
            is_complete=is_complete,
        )
        # The swing follows the use slowly: a single deep press must not make the next ones too small to be seen.
        now.low += config.memory * (low - now.low)
        now.high += config.memory * (high - now.high)
        if is_complete:
            now.cycle_samples += config.memory * (now.count - now.cycle_samples)
            now.waits = 0
        self._begin()
        return cycle

    def state(self) -> dict[str, object]:
        return to_state(self._now)

    def restore(self, state: Mapping[str, Any]) -> None:
        self._now = from_state(SegmenterState, state)
