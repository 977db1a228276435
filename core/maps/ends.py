"""Rest and peak, the two levels that recordings of one kind share, and what a stretch of some length shows of them."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from softcal.core.errors import UnitRefused
from softcal.core.maps.config import MapConfig
from softcal.core.maps.crossing import CACHED, LevelPath, averaging_length, level_path, smoothed
from softcal.core.messages.reason import reason
from softcal.core.metrics import quantile
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.windows import TAPS


@dataclass(frozen=True, eq=False)
class Ends:
    """Levels at rest and at the hardest presses of (k,) stretches; output times the direction of loading."""

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


def match_ends(source: LabelledRecording, target: OutputRecording, config: MapConfig) -> EndMatch:
    """Match rest and peak of a unit to those of source stretches as long as the unit's recording.

    A short recording has seen few presses, so it is set beside each of several source stretches of its own length. A
    stretch counts by how likely the gain it asks for is among units of one kind, w_k ~ exp(-(log g_k)^2 / 2 s^2): a
    unit recorded at rest is compared with rests. Where swings hardly stand out of the noise, the gain is drawn to 1.

    Raises:
        UnitRefused: the unit's output makes no swing that stands out of its noise.
    """
    # A sensor may fall under load: every level is taken in the direction of loading.
    # Samples lost here and there end no press: bridged, a recording in pieces is one that was cut on purpose.
    bridged, sign, noise, target = source.unlabelled.bridged, source.direction, output_noise(target), target.bridged
    # Pieces shorter than ten windows show levels but no presses.
    ends, lengths = config.ends, [segment.stop - segment.start for segment in target.segments]
    is_patchy = len(lengths) > 1 and float(np.median(lengths)) < 10 * TAPS
    if is_patchy:
        average = TAPS // 3
        unit_ends = _patch_ends([sign * smoothed(target, average)], config)
    else:
        # The same average on both: it lowers peaks, and must lower them alike.
        average = max(averaging_length(recording, config.crossing) for recording in (bridged, target))
        unit_ends = _stretch_ends(target, average, sign, [(0, len(target))], config)
    # Averages of one and the same value differ by rounding.
    if not unit_ends.span[0] > max(ends.clear_of_noise * noise, 1e-9 * float(np.abs(target.output).max())):
        raise UnitRefused(reason("no_swing"))
    if is_patchy:
        stretches = others = _patches(bridged, target, average, sign, config)
    else:
        stretches, others = _stretches(bridged, len(target), average, sign, config)
    return _matched(stretches, others, unit_ends, sign, float(2 * noise / unit_ends.span[0]), config.curve.gain_prior)


def _matched(
    stretches: Ends, others: Ends, unit_ends: Ends, sign: float, noise_share: float, gain_prior: float
) -> EndMatch:
    # Logarithms: a unit twice as sensitive and one half as sensitive are equally far from the source.
    log_gain = np.log(np.maximum(stretches.span, 1e-6 * stretches.span.max()) / unit_ends.span[0])
    prior = gain_prior**2
    shrinkage = prior / (prior + noise_share**2)
    # The smallest exponent is taken out first: all weights would underflow where every stretch is far.
    weight = np.exp(-0.5 * (log_gain**2 - np.min(log_gain**2)) / prior)
    weight /= weight.sum()
    gain = float(np.exp(shrinkage * (weight @ log_gain)))
    rest, peak = float(weight @ stretches.rest), float(weight @ stretches.peak)
    rest_variance, peak_variance = (float(np.var(levels)) for levels in (others.rest, others.peak))
    # The better known of both levels holds the map; for long recordings that is the level at rest.
    towards_peak = rest_variance / max(rest_variance + peak_variance, 1e-300)
    level = (1 - towards_peak) * rest + towards_peak * peak
    offset = level - gain * float(unit_ends.rest[0] + towards_peak * unit_ends.span[0])
    spread = np.log(np.maximum(others.span, 1e-6 * others.span.max()))
    return EndMatch(
        gain=gain,
        offset=sign * offset,
        gain_error=float(np.hypot(np.std(spread), (1 - shrinkage) * gain_prior)),
        # Taken at the level of rest: an offset at output 0 means nothing on a sensor that rests at 2 V.
        rest_shift=sign * (offset + (gain - 1) * float(unit_ends.rest[0])),
        rest_error=float(np.sqrt(rest_variance)),
    )


@lru_cache(maxsize=CACHED)
def output_noise(recording: OutputRecording) -> float:
    """Return the standard deviation of the noise from second differences, at least that of the readout's steps."""
    second_differences = np.concatenate([np.diff(recording.output[part], 2) for part in recording.segments])
    # 0.6745 makes a standard deviation of a median; a second difference has six times the variance of one sample.
    noise = float(np.median(np.abs(second_differences))) / 0.6745 / np.sqrt(6) if len(second_differences) else 0.0
    # A coarse converter hides its noise: what is left is the rounding, uniform over one step.
    return max(noise, recording.step / np.sqrt(12) if np.isfinite(recording.step) else 0.0)


@lru_cache(maxsize=CACHED)
def _stretches(source: OutputRecording, length: int, average: int, sign: float, config: MapConfig) -> tuple[Ends, Ends]:
    """Return ends of the source that a recording so long has seen, and of stretches that show their scatter."""
    path = level_path(source, average, config.crossing)
    swings = 0.0 if path is None else path.swings * length / len(source)
    if swings < config.ends.enough_swings:
        shifted_ends = _shifted_ends(source, min(length, len(source)), average, sign, config)
        return shifted_ends, shifted_ends
    full = _stretch_ends(source, average, sign, [(0, len(source))], config)
    return full, _shifted_ends(source, min(length, len(source) // 2), average, sign, config)


def _shifted_ends(source: OutputRecording, length: int, average: int, sign: float, config: MapConfig) -> Ends:
    starts = np.linspace(0, len(source) - length, config.ends.stretches).astype(int)
    return _stretch_ends(source, average, sign, [(start, start + length) for start in starts], config)


def _stretch_ends(
    recording: OutputRecording, average: int, sign: float, stretches: list[tuple[int, int]], config: MapConfig
) -> Ends:
    level, path = sign * smoothed(recording, average), level_path(recording, average, config.crossing)
    rest = [float(quantile(level[start:stop], config.ends.rest_share)) for start, stop in stretches]
    peak = [_peak(path, level[start:stop], sign, (start, stop), config) for start, stop in stretches]
    return Ends(np.array(rest), np.array(peak))


def _peak(path: LevelPath | None, level: Array, sign: float, rows: tuple[int, int], config: MapConfig) -> float:
    part = None if path is None else path.within(*rows)
    if part is None or not part.swings:
        return float(quantile(level, 1 - config.ends.rest_share))
    upper = np.array(config.ends.peak_shares)
    # The path is kept in output units: under load a falling sensor goes towards its low end.
    shares = upper if sign > 0 else 1 - upper
    return sign * float(part.quantiles(shares).mean())


def _patches(source: OutputRecording, target: OutputRecording, average: int, sign: float, config: MapConfig) -> Ends:
    """Return the ends of as many and as long pieces of the source as the unit's recording consists of, drawn anew."""
    # A fixed seed: the same recordings must always give the same map.
    level, rng = sign * smoothed(source, average), np.random.default_rng(0)
    pieces, length = len(target.segments), max(1, len(target) // len(target.segments))
    starts = rng.integers(0, max(1, len(source) - length), (config.ends.stretches, pieces))
    return _patch_ends([level[(row[:, None] + np.arange(length)).ravel()] for row in starts], config)


def _patch_ends(levels: list[Array], config: MapConfig) -> Ends:
    ends = np.array([quantile(level, config.ends.quantile_range) for level in levels])
    return Ends(ends[:, 0], ends[:, 1])
