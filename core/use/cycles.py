"""Cut a stream into its cycles of use and describe each by a few numbers; constant memory, no knowledge of drift."""

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from softcal.core.recording import Array
from softcal.core.windows import TAPS

LEVELS = (np.arange(16) + 0.5) / 16
"""Probabilities at which the distribution of a cycle is described."""

KEPT = 512
"""Samples of a cycle kept for its quantiles; a longer cycle is thinned evenly."""

MIN_SAMPLES = 32
"""Shorter cycles are taken together until they have this many samples."""

BAND = (0.3, 0.7)
"""A cycle ends where the output rises through the upper of these shares of its swing after being below the lower."""

SWING_MEMORY = 0.2
"""Weight of the newest cycle in the swing the next one is cut with."""

OVERDUE = 1.5
"""A cycle that takes so many times the usual turns elsewhere: the swing is taken anew from the latest samples."""

LEAST_SWING = 0.3
"""Unless that is smaller than this share of the calibrated swing: then it is a pause."""


@dataclass(frozen=True, eq=False)
class Cycle:
    """One cycle of use as unlabelled data show it.

    Args:
        level: mean of the output, in its unit.
        scale: standard deviation, in the same unit.
        low, high: mean of the lowest and highest sixteenth: the turning points.
        shape: (16,) standardised quantiles, (quantile - level) / scale.
        speed: RMS change over one window, in units of `scale`.
        duration_s: how long it took.
        end_s: time of its last sample.
        is_complete: False where the output did not turn within the longest time a cycle may take.
    """

    level: float
    scale: float
    low: float
    high: float
    shape: Array
    speed: float
    duration_s: float
    end_s: float
    is_complete: bool

    def rest(self, is_low: bool) -> float:
        """Return the unloaded turning point."""
        return self.low if is_low else self.high

    def standardised(self, mean: float, scale: float) -> "Cycle":
        """Return the cycle of the output (output - mean) / scale, scale > 0."""
        moved = {name: (getattr(self, name) - mean) / scale for name in ("level", "low", "high")}
        return replace(self, scale=self.scale / scale, **moved)

    def state(self) -> dict[str, object]:
        """Return the cycle as JSON values."""
        return vars(self) | {"shape": self.shape.tolist()}

    @classmethod
    def from_state(cls, state: Mapping[str, Any]) -> "Cycle":
        """Rebuild from `state()`."""
        return cls(**{**state, "shape": np.array(state["shape"])})


class CycleCutter:
    """Cuts gap-free samples into cycles.

    Args:
        low, high: where the output turned in the calibration recording, in its unit: the first swing to cut with.
        usual: samples of a cycle there.
        longest: most samples of a cycle; after that many the output counts as not cycling.
    """

    def __init__(self, low: float, high: float, usual: float, longest: int) -> None:
        self._low, self._high, self._usual, self._longest = low, high, usual, longest
        self._patience = OVERDUE * max(usual, MIN_SAMPLES)
        self._least_swing = LEAST_SWING * (high - low)
        self._silent = 0
        self.restart()

    def restart(self) -> None:
        """Forget the cycle under way, after a gap or a fault: it ends in no `Cycle`."""
        self._was_low, self._has_start = False, False
        self._silent = 0
        self._kept: list[float] = []
        self._tail: list[float] = []
        self._stride, self._count, self._start_s, self._end_s = 1, 0, 0.0, 0.0
        self._changes, self._squared_changes = 0, 0.0

    def advance(self, t_s: Array, output: Array) -> list[Cycle]:
        """Take (n,) further samples that follow the last ones without a gap; return the cycles that ended in them."""
        found, start = [], 0
        for end in self._turns(output):
            self._collect(t_s[start:end], output[start:end])
            start = end
            if self._has_start and self._count >= MIN_SAMPLES:
                found.append(self._finish(is_complete=True))
            elif not self._has_start:
                self._begin()
        self._collect(t_s[start:], output[start:])
        self._silent = len(output) - start + (0 if start else self._silent)
        if self._count >= self._longest:
            found.append(self._finish(is_complete=False))
        elif self._silent > max(self._patience, OVERDUE * self._usual):
            self._take_swing()
        return found

    def _take_swing(self) -> None:
        """Look for cycles in the swing of what was seen lately."""
        recent = self._kept[-max(1, self._silent // self._stride) :]
        self._silent = 0
        low, high = (float(v) for v in np.quantile(recent, (0.02, 0.98)))
        if high - low >= self._least_swing:
            self._low, self._high = low, high
            self._was_low, self._has_start = False, False

    def _turns(self, output: Array) -> list[int]:
        """Return the positions where a new cycle begins."""
        turns, position = [], 0
        swing = self._high - self._low
        below = output < self._low + BAND[0] * swing
        above = output > self._low + BAND[1] * swing
        while position < len(output):
            wanted = above if self._was_low else below
            step = int(np.argmax(wanted[position:]))
            if not wanted[position + step]:
                break
            position += step
            if self._was_low:
                turns.append(position)
            self._was_low = not self._was_low
        return turns

    def _begin(self) -> None:
        self._kept.clear()
        self._stride, self._count = 1, 0
        self._changes, self._squared_changes = 0, 0.0
        self._has_start = True

    def _collect(self, t_s: Array, output: Array) -> None:
        if not len(output):
            return
        if self._count == 0:
            self._start_s = float(t_s[0])
        self._end_s = float(t_s[-1])
        first = -self._count % self._stride
        self._kept.extend(output[first :: self._stride].tolist())
        while len(self._kept) > KEPT:
            self._kept, self._stride = self._kept[::2], 2 * self._stride
        self._count += len(output)
        joined = np.concatenate([self._tail, output])
        changes = joined[TAPS - 1 :] - joined[: -TAPS + 1]
        self._changes += len(changes)
        self._squared_changes += float(changes @ changes)
        self._tail = joined[-TAPS + 1 :].tolist()

    def _finish(self, is_complete: bool) -> Cycle:
        values = np.sort(self._kept)
        level, scale = float(values.mean()), float(values.std())
        part = max(1, len(values) // 16)
        low, high = float(values[:part].mean()), float(values[-part:].mean())
        shape = (np.interp(LEVELS, (np.arange(len(values)) + 0.5) / len(values), values) - level) / max(scale, 1e-300)
        speed = np.sqrt(self._squared_changes / max(1, self._changes)) / max(scale, 1e-300)
        cycle = Cycle(
            level, scale, low, high, shape, float(speed), self._end_s - self._start_s, self._end_s, is_complete
        )
        self._low += SWING_MEMORY * (low - self._low)
        self._high += SWING_MEMORY * (high - self._high)
        if is_complete:
            self._usual += SWING_MEMORY * (self._count - self._usual)
        self._begin()
        return cycle

    def state(self) -> dict[str, object]:
        """Return all that a restart needs, as JSON values."""
        return {name.removeprefix("_"): copy(value) for name, value in vars(self).items()}

    def restore(self, state: Mapping[str, object]) -> None:
        """Go on from a `state()` taken earlier."""
        for name in vars(self):
            setattr(self, name, copy(state[name.removeprefix("_")]))
