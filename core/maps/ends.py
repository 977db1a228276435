"""Rest and peak, the two levels that recordings of one kind share, and what a stretch of some length shows of them."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from softcal.core.errors import UnitRefused
from softcal.core.maps.crossing import KEPT, LevelPath, averaging_length, level_path, moving_mean
from softcal.core.maps.curve import GAIN_PRIOR
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.windows import TAPS

REST_SHARE = 0.005
"""Quantile of the samples that stands for the level at rest: robust to a few outlying samples."""

PEAK_SHARES = np.array([0.99, 0.995, 1.0])
"""Shares of the path whose mean level stands for the hardest presses, however short those were."""

PATCH_PEAK_SHARE = 0.995
PATCH = 10 * TAPS
"""A recording in pieces shorter than this shows levels but no presses."""

STRETCHES = 8
ENOUGH_SWINGS = 10
"""A recording as long as the source takes for this many swings has seen its hardest press."""

CLEAR_OF_NOISE = 6.0
"""A swing below this many standard deviations of the noise is none."""

ROUNDING = 1e-9
"""Averages of one and the same value differ by rounding; a swing below this share of the output is none."""


@dataclass(frozen=True, eq=False)
class Ends:
    """Levels at rest and at the hardest presses, of one stretch or several; output times the direction of loading.

    Args:
        rest, peak: (k,) one entry per stretch.
    """

    rest: Array
    peak: Array

    @property
    def span(self) -> Array:
        return self.peak - self.rest


@dataclass(frozen=True)
class EndMatch:
    """The gain and offset that carry a unit's rest and peak onto the source's, and how well they are known.

    Args:
        gain, offset: source output = offset + gain * target output.
        gain_error: standard error of log gain, from what other stretches of the source would have asked for.
        rest_shift, rest_error: how far the level at rest moves, and its standard error, in the source's output unit.
    """

    gain: float
    offset: float
    gain_error: float
    rest_shift: float
    rest_error: float


def match_ends(source: LabelledRecording, target: OutputRecording) -> EndMatch:
    """Match rest and peak of a unit to those of source stretches as long as the unit's recording.

    A short recording has seen few presses, so it is set beside each of several source stretches of its own length. A
    stretch counts by how likely the gain it asks for is among units of one kind, w_k ~ exp(-(log g_k)^2 / 2 s^2): a
    unit recorded at rest is compared with rests. Where swings hardly stand out of the noise, the gain is drawn to 1.

    Raises:
        UnitRefused: the unit's output makes no swing that stands out of its noise.
    """
    known = source.unlabelled
    sign = 1.0 if np.corrcoef(known.output, source.reference)[0, 1] >= 0 else -1.0
    is_patchy = _is_patchy(target)
    average = 5 if is_patchy else max(averaging_length(known), averaging_length(target))
    shown = _whole(target, average, sign, is_patchy)
    noise = output_noise(target)
    if not shown.span[0] > max(CLEAR_OF_NOISE * noise, ROUNDING * float(np.abs(target.output).max())):
        raise UnitRefused("output makes no swing that stands out of its noise; press the unit and record it again")
    if is_patchy:
        stretches = others = _patches(known, target, average, sign)
    else:
        stretches, others = _stretches(known, len(target), average, sign)
    return _matched(stretches, others, shown, sign, float(2 * noise / shown.span[0]))


def _matched(stretches: Ends, others: Ends, shown: Ends, sign: float, noise_share: float) -> EndMatch:
    log_gain = np.log(np.maximum(stretches.span, 1e-6 * stretches.span.max()) / shown.span[0])
    prior = GAIN_PRIOR**2
    shrink = prior / (prior + noise_share**2)
    weight = np.exp(-0.5 * (log_gain**2 - np.min(log_gain**2)) / prior)
    weight /= weight.sum()
    gain = float(np.exp(shrink * (weight @ log_gain)))
    rest, peak = float(weight @ stretches.rest), float(weight @ stretches.peak)
    rest_variance, peak_variance = (float(np.var(levels)) for levels in (others.rest, others.peak))
    # The better known of both levels holds the map; for long recordings that is the level at rest.
    towards_peak = rest_variance / max(rest_variance + peak_variance, 1e-300)
    held = (1 - towards_peak) * rest + towards_peak * peak
    offset = held - gain * float(shown.rest[0] + towards_peak * shown.span[0])
    spread = np.log(np.maximum(others.span, 1e-6 * others.span.max()))
    return EndMatch(
        gain=gain,
        offset=sign * offset,
        gain_error=float(np.hypot(np.std(spread), (1 - shrink) * GAIN_PRIOR)),
        rest_shift=sign * (offset + (gain - 1) * float(shown.rest[0])),
        rest_error=float(np.sqrt(rest_variance)),
    )


@lru_cache(maxsize=KEPT)
def _smoothed(recording: OutputRecording, average: int) -> Array:
    """Output averaged over neighbours inside each segment, one value per sample."""
    parts = []
    for part in recording.segments:
        mean = moving_mean(recording.output[part], average)
        before = (part.stop - part.start - len(mean)) // 2
        parts.append(np.pad(mean, (before, part.stop - part.start - len(mean) - before), mode="edge"))
    return np.concatenate(parts)


@lru_cache(maxsize=KEPT)
def output_noise(recording: OutputRecording) -> float:
    """Return the standard deviation of the noise from second differences, at least that of the readout's steps."""
    bends = np.concatenate([np.diff(recording.output[part], 2) for part in recording.segments])
    step = float(np.min(np.diff(np.unique(recording.output)), initial=np.inf))
    noise = float(np.median(np.abs(bends))) / 0.6745 / np.sqrt(6) if len(bends) else 0.0
    return max(noise, step / np.sqrt(12) if np.isfinite(step) else 0.0)


def _is_patchy(recording: OutputRecording) -> bool:
    return len(recording.segments) > 1 and float(np.median([s.stop - s.start for s in recording.segments])) < PATCH


def _whole(recording: OutputRecording, average: int, sign: float, is_patchy: bool) -> Ends:
    if is_patchy:
        return _patch_ends([sign * _smoothed(recording, average)])
    return _stretch_ends(recording, average, sign, [(0, len(recording))])


@lru_cache(maxsize=KEPT)
def _stretches(source: OutputRecording, length: int, average: int, sign: float) -> tuple[Ends, Ends]:
    """Return ends of the source that a recording so long has seen, and of stretches that show their scatter."""
    path = level_path(source, average)
    swings = 0.0 if path is None else path.swings * length / len(source)
    if swings < ENOUGH_SWINGS:
        placed = _placed(source, min(length, len(source)), average, sign)
        return placed, placed
    whole = _stretch_ends(source, average, sign, [(0, len(source))])
    return whole, _placed(source, min(length, len(source) // 2), average, sign)


def _placed(source: OutputRecording, length: int, average: int, sign: float) -> Ends:
    starts = np.linspace(0, len(source) - length, STRETCHES).astype(int)
    return _stretch_ends(source, average, sign, [(start, start + length) for start in starts])


def _stretch_ends(recording: OutputRecording, average: int, sign: float, places: list[tuple[int, int]]) -> Ends:
    level, path = sign * _smoothed(recording, average), level_path(recording, average)
    rest = [float(np.quantile(level[start:stop], REST_SHARE)) for start, stop in places]
    peak = [_peak(path, level, sign, start, stop) for start, stop in places]
    return Ends(np.array(rest), np.array(peak))


def _peak(path: LevelPath | None, level: Array, sign: float, start: int, stop: int) -> float:
    part = None if path is None else path.within(start, stop)
    if part is None or not part.swings:
        return float(np.quantile(level[start:stop], PATCH_PEAK_SHARE))
    shares = PEAK_SHARES if sign > 0 else 1 - PEAK_SHARES
    return sign * float(part.quantiles(shares).mean())


def _patches(source: OutputRecording, target: OutputRecording, average: int, sign: float) -> Ends:
    """Return the ends of as many and as long pieces of the source as the unit's recording consists of, drawn anew."""
    level, rng = sign * _smoothed(source, average), np.random.default_rng(0)
    pieces, length = len(target.segments), max(1, len(target) // len(target.segments))
    starts = rng.integers(0, max(1, len(source) - length), (STRETCHES, pieces))
    return _patch_ends([level[(row[:, None] + np.arange(length)).ravel()] for row in starts])


def _patch_ends(levels: list[Array]) -> Ends:
    ends = np.array([np.quantile(level, (REST_SHARE, PATCH_PEAK_SHARE)) for level in levels])
    return Ends(ends[:, 0], ends[:, 1])
