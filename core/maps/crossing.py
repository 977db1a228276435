"""What a recording shows whatever time is spent at each level: its turning points and how often it crosses a level.

Rates and dwell times change the distribution of the samples but not the path between turning points, so the measure of
level crossings is what two recordings under differently timed programmes still share.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from softcal.core.maps.config import CrossingConfig
from softcal.core.metrics import quantile
from softcal.core.recording import Array, Indices, OutputRecording

CACHED = 32
"""Results kept per recording: every unit of a lot is compared with one and the same source."""


@dataclass(frozen=True, eq=False)
class LevelPath:
    """A recording reduced to its (k,) swings between turning points: their ends in the output unit, and in samples."""

    low: Array
    high: Array
    start: Indices
    stop: Indices

    @property
    def swings(self) -> int:
        return len(self.low)

    @cached_property
    def _grid(self) -> Array:
        return np.linspace(float(self.low.min()), float(self.high.max()), 2048)

    @cached_property
    def _cumulative(self) -> Array:
        # At each level, the swings that began below it less those that ended below it.
        began = np.bincount(np.searchsorted(self._grid, self.low, side="left"), minlength=len(self._grid))
        ended = np.bincount(np.searchsorted(self._grid, self.high, side="right"), minlength=len(self._grid))
        crossings = np.cumsum(began - ended[: len(self._grid)]).astype(np.float64)
        total = np.concatenate([[0.0], np.cumsum((crossings[1:] + crossings[:-1]) / 2)])
        return np.asarray(total / total[-1])

    def quantiles(self, shares: Array) -> Array:
        """Return the levels below which the given shares of the path lie, in the output unit."""
        return np.interp(shares, self._cumulative, self._grid)

    def within(self, start: int, stop: int) -> "LevelPath":
        """Return the swings that lie between two samples."""
        inside = (self.start >= start) & (self.stop < stop)
        return LevelPath(self.low[inside], self.high[inside], self.start[inside], self.stop[inside])


@lru_cache(maxsize=CACHED)
def level_path(recording: OutputRecording, average: int, config: CrossingConfig) -> LevelPath | None:
    """Reduce a recording, averaged over so many samples against noise, to its swings; None where it makes none.

    Rows of the swings are those of `recording.bridged`: a swing goes on across a few lost samples.
    """
    recording = recording.bridged
    # A share of the range: no unit, gain or readout changes what counts as a swing.
    threshold = config.threshold * _range(recording, config)
    # Neighbours of an average share most of their samples: a third of its length loses no turning point.
    step, levels, turns = max(1, average // 3), [], []
    for part in recording.segments:
        signal = moving_mean(recording.output[part], average)[::step]
        points = turning_points(signal, threshold)
        levels.append(signal[points])
        turns.append(part.start + points * step)
    path = LevelPath(
        low=np.concatenate([np.minimum(level[1:], level[:-1]) for level in levels]),
        high=np.concatenate([np.maximum(level[1:], level[:-1]) for level in levels]),
        start=np.concatenate([turn[:-1] for turn in turns]),
        stop=np.concatenate([turn[1:] for turn in turns]),
    )
    return path if path.swings and path.high.max() > path.low.min() else None


def turning_points(signal: Array, threshold: float) -> Indices:
    """Return where a signal turns by more than a threshold, ends included (the rainflow filter of ASTM E1049)."""
    # Ends and local extremes; a plateau counts once, where it ends.
    moves = np.flatnonzero(np.diff(signal))
    turns = moves[1:][np.diff(signal[moves + 1] > signal[moves])]
    candidates = np.concatenate([[0], turns, [len(signal) - 1]]).astype(np.int64)
    levels = signal[candidates].tolist()
    turning, extreme, rising = [0], 0, None
    for k, level in enumerate(levels):
        away = level - levels[extreme]
        if rising is None:
            if abs(level - levels[0]) >= threshold:
                rising, extreme = level > levels[0], k
        elif (away > 0) == rising:
            extreme = k if away else extreme
        elif abs(away) >= threshold:
            turning.append(extreme)
            extreme, rising = k, not rising
    if extreme != turning[-1]:
        turning.append(extreme)
    # Indices of the candidates, not of the samples, were collected above.
    return candidates[turning]


@lru_cache(maxsize=CACHED)
def averaging_length(recording: OutputRecording, config: CrossingConfig) -> int:
    """Return the fewest samples to average so that presses, not noise, make the turning points.

    Swings of noise stand just above the threshold; those of presses span a good part of the range.
    """
    spread = _range(recording, config)
    for average in config.averages:
        path = level_path(recording, average, config)
        if path is not None and np.median(path.high - path.low) >= config.press_share * spread:
            return average
    return config.averages[-1]


def swings(recording: OutputRecording, config: CrossingConfig) -> int:
    """Return how many swings a recording makes."""
    path = level_path(recording, averaging_length(recording, config), config)
    return 0 if path is None else path.swings


@lru_cache(maxsize=CACHED)
def _range(recording: OutputRecording, config: CrossingConfig) -> float:
    return robust_range(recording.output, config)


def robust_range(values: Array, config: CrossingConfig) -> float:
    """Return the span between the level at rest and the level of the hardest presses."""
    # Not minimum and maximum: one spike would set the range of a whole recording.
    low, high = quantile(values, config.robust_range)
    return float(high - low)


@lru_cache(maxsize=CACHED)
def smoothed(recording: OutputRecording, average: int) -> Array:
    """Return the output averaged over neighbours inside each segment, one value per sample."""
    parts = []
    for part in recording.segments:
        # Never across a gap: what lies on its two sides was not recorded together.
        mean = moving_mean(recording.output[part], average)
        before = (part.stop - part.start - len(mean)) // 2
        parts.append(np.pad(mean, (before, part.stop - part.start - len(mean) - before), mode="edge"))
    return np.concatenate(parts)


def moving_mean(signal: Array, length: int) -> Array:
    """Return the mean of every `length` neighbouring samples: (n - length + 1,); short signals as one mean."""
    length = min(length, len(signal))
    if length <= 1:
        return signal
    # Running sums cost the same for any length; np.convolve grows with it.
    total = np.concatenate([[0.0], np.cumsum(signal)])
    return np.asarray((total[length:] - total[:-length]) / length)
