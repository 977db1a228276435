"""Were two units pressed by the same load at the same time? Found from their outputs alone, by correlation.

Rank correlation says whether the loads agree. The peak of the cross-correlation of the fine structure gives the lag
between the clocks. A recording may also open with the common load and go on with its own.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy
from numpy.typing import NDArray

from softcal.core.maps.config import MapConfig, SynchronyConfig
from softcal.core.maps.crossing import moving_mean, robust_range, turning_points
from softcal.core.metrics import quantile
from softcal.core.recording import RATE_TOLERANCE, Array, Indices, Mask, OutputRecording
from softcal.core.windows import TAPS

LONGEST_LAG_s = 1.0
"""Clocks further apart than this are not looked for."""


STRETCHES = 8
"""Stretches of a source whose ranks are stored: a comparison looks at three, and units of a line share none."""


@dataclass(frozen=True)
class Synchrony:
    """What the outputs say about a common load.

    Args:
        lag_s: seconds the target's clock is ahead of the source's.
        rank_correlation: of the two outputs at equal time, averaged over a few samples.
        detail: correlation of their fine structure at that lag, on the scale that shows it best.
        sigma: how far that stands out of the same correlation at unrelated lags, in standard deviations.
        until_s: on the source's clock, where the common load ends; infinite where it lasts as long as both recordings.
    """

    lag_s: float
    rank_correlation: float
    detail: float
    sigma: float
    until_s: float = np.inf
    is_synchronous: bool = False


NONE = Synchrony(0.0, 0.0, 0.0, 0.0)


def find_synchrony(source: OutputRecording, target: OutputRecording, config: MapConfig) -> Synchrony:
    """Compare two recordings on their common stretch of time.

    Ranks do not depend on the static curves of the units, as long as these are monotone. A lag is believed where the
    fine structure correlates at that lag and at no other. Where the whole recordings do not agree, they may still open
    alike: a line often runs one profile first and other loads after it. A long opening makes even the whole agree;
    then the stretch after the opening decides.
    """
    overall = _compared(source, target, config.synchrony)
    until_s = _opening_end(source, target, config)
    if until_s is None:
        return overall
    opening = _compared(source, target, config.synchrony, until_s=until_s)
    if not overall.is_synchronous:
        return opening if opening.is_synchronous else overall
    if opening.rank_correlation <= overall.rank_correlation:
        return overall
    after = _compared(source, target, config.synchrony, from_s=until_s + 2 * config.synchrony.settled_s)
    # NONE: too little follows to decide.
    if after is NONE or after.is_synchronous:
        return overall
    parts = 1 - after.rank_correlation > config.synchrony.parted * (1 - opening.rank_correlation)
    return opening if parts else overall


def _compared(
    source: OutputRecording,
    target: OutputRecording,
    config: SynchronyConfig,
    from_s: float = -np.inf,
    until_s: float = np.inf,
) -> Synchrony:
    rate_Hz = source.sample_rate_Hz
    is_other_rate = abs(target.sample_rate_Hz / rate_Hz - 1) > RATE_TOLERANCE
    time_s = _both_running(source, target, from_s, until_s)
    if len(time_s) < 2 * config.apart * min(config.scales) or is_other_rate:
        return NONE
    # What one recording missed the other must not show either: both are read at the same instants.
    shared_s = time_s[_covered(source, time_s) & _covered(target, time_s)]
    if len(shared_s) < 2 * min(config.scales):
        return NONE
    # Every unit of a lot is compared with one source, and mostly at the same instants: what was found of it is kept.
    key = (source, time_s.tobytes(), shared_s.tobytes())
    a, b = _stored_ranks(*key), _ranks_at(target, time_s, shared_s)
    if np.ptp(a) == 0 or np.ptp(b) == 0:
        return NONE
    # One scale would miss slow loads or drown in noise.
    scales = [scale for scale in config.scales if 2 * config.apart * scale <= len(time_s)]
    looks = []
    for scale in scales:
        band, other = _stored_band(*key, scale, config.apart), _band_of(b, scale, config.apart)
        looks.append(_detail(band, other, scale, rate_Hz, config))
    detail, sigma, lag = max(looks, key=lambda item: item[1])
    is_significant = detail >= config.min_detail and sigma >= config.min_sigma
    # A lag that does not stand out is chance. A wrong lag pairs foreign loads; no lag at worst pairs none.
    lag = lag if is_significant else 0
    # Noise and spikes of a readout are no load: over a window they average out.
    a, b = (moving_mean(each, TAPS) for each in (a, np.roll(b, lag)))
    correlation = float(np.corrcoef(a, b)[0, 1])
    is_synchronous = correlation >= config.min_rank_correlation
    return Synchrony(-lag / rate_Hz, correlation, detail, sigma, until_s, is_synchronous)


@dataclass(frozen=True, eq=False)
class _Band:
    """Ranks of one output, without what is slower or faster than a scale."""

    spectrum: NDArray[np.complex128]
    length: int
    spread: float


def _ranks_at(recording: OutputRecording, at_s: Array, shared_s: Array) -> Array:
    # Linear between samples: two recordings never share their instants exactly.
    return ranks(np.interp(at_s, shared_s, np.interp(shared_s, recording.t_s, recording.output)))


def _band_of(values: Array, scale: int, apart: int) -> _Band:
    slower, faster = moving_mean(values, apart * scale), moving_mean(values, scale)
    offset = (len(faster) - len(slower)) // 2
    band = faster[offset : offset + len(slower)] - slower
    band = band - band.mean()
    return _Band(np.fft.rfft(band), len(band), float(np.std(band)))


@lru_cache(maxsize=STRETCHES)
def _stored_ranks(source: OutputRecording, time_s: bytes, shared_s: bytes) -> Array:
    return _ranks_at(source, np.frombuffer(time_s), np.frombuffer(shared_s))


@lru_cache(maxsize=4 * STRETCHES)
def _stored_band(source: OutputRecording, time_s: bytes, shared_s: bytes, scale: int, apart: int) -> _Band:
    return _band_of(_stored_ranks(source, time_s, shared_s), scale, apart)


def ranks(values: Array) -> Array:
    """Return the rank of each value, from 1 on; equal values share the mean of theirs."""
    # `scipy.stats` gives the same and takes a second to load.
    _, index, count = np.unique(values, return_inverse=True, return_counts=True)
    last = np.cumsum(count)
    shared: Array = (last - (count - 1) / 2)[index]
    return shared


def _opening_end(source: OutputRecording, target: OutputRecording, maps: MapConfig) -> float | None:
    """Return until when both recordings open with one load, on the common clock; None where they do not.

    A monotone curve carries the target's output onto the source's, from the first few presses on over as much as it
    holds for; where the recordings leave that curve, the opening has ended.
    """
    config, rate_Hz = maps.synchrony, source.sample_rate_Hz
    time_s = _both_running(source, target)
    if len(time_s) <= TAPS or np.ptp(target.output) == 0:
        return None
    a, b = (moving_mean(np.interp(time_s, r.t_s, r.output), TAPS) for r in (source, target))
    span, settled = robust_range(source.output, maps.crossing), round(config.settled_s * rate_Hz)
    # A swing of an opening spans a fifth of the source's range at least; a tenth finds the same openings.
    turns = turning_points(a, 0.2 * span)
    if len(turns) <= config.min_swings:
        return None
    first = length = int(turns[config.min_swings])
    # The curve of a longer opening differs from that of a shorter one, so its end is sought again until it stays.
    for _ in range(20):
        off = np.abs(moving_mean(_off_curve(a, b, length), settled)) / span
        # What the opening itself leaves of the curve (noise, hysteresis) is no sign of its end. Not the maximum: one
        # outlier inside must not let foreign loads in.
        scatter = float(quantile(off[: max(length - settled, 1)], config.opening_quantile))
        allowed = max(config.same_curve, config.off_curve * scatter)
        beyond = np.flatnonzero(off[first:] > allowed)
        end = first + int(beyond[0]) if len(beyond) else len(a)
        if end == length:
            break
        length = end
    # The loads part before the outputs do: averages and hysteresis still hold the old ones.
    end = length - round(2 * config.settled_s * rate_Hz)
    if end < first or robust_range(a[:end], maps.crossing) < config.covered_share * span:
        return None
    return float(time_s[end])


def _off_curve(source: Array, target: Array, count: int) -> Array:
    """Return how far the outputs lie from the monotone curve that is nearest to the first `count` of them.

    Outputs beyond those the curve was fitted to cannot be judged: 0.
    """
    fitted, onto = target[:count], source[:count]
    order = np.argsort(fitted, kind="stable")
    is_rising = bool(np.corrcoef(fitted, onto)[0, 1] >= 0) if np.ptp(fitted) > 0 else True
    curve = scipy.optimize.isotonic_regression(onto[order], increasing=is_rising).x
    is_within = (target >= fitted.min()) & (target <= fitted.max())
    return np.where(is_within, source - np.interp(target, fitted[order], curve), 0.0)


def paired_rows(source: OutputRecording, target: OutputRecording, synchrony: Synchrony) -> tuple[Indices, Indices]:
    """Return the windows of both recordings whose newest samples were taken at the same time.

    Returns:
        Row numbers into `source.windows` and `target.windows`, equal lengths.
    """
    source_s, target_s = source.t_s[source.window_rows], target.t_s[target.window_rows] - synchrony.lag_s
    right = np.clip(np.searchsorted(source_s, target_s), 1, len(source_s) - 1)
    # A boolean as 0 or 1: one place to the left where the earlier sample is the closer one.
    nearest = right - (target_s - source_s[right - 1] < source_s[right] - target_s)
    # Half a sample and a little rounding: no instant is paired across a gap.
    close = np.abs(source_s[nearest] - target_s) <= 0.51 / source.sample_rate_Hz
    close &= target_s <= synchrony.until_s
    return nearest[close].astype(np.int64), np.flatnonzero(close).astype(np.int64)


def _both_running(
    source: OutputRecording, target: OutputRecording, from_s: float = -np.inf, until_s: float = np.inf
) -> Array:
    start, stop = max(source.t_s[0], target.t_s[0], from_s), min(source.t_s[-1], target.t_s[-1], until_s)
    return np.arange(start, stop, 1.0 / source.sample_rate_Hz)


def common_time(source: OutputRecording, target: OutputRecording, until_s: float = np.inf) -> Array:
    """Return the instants, at the source's rate, that both recordings cover, up to `until_s` on the source's clock."""
    time_s = _both_running(source, target, until_s=until_s)
    return np.asarray(time_s[_covered(source, time_s) & _covered(target, time_s)])


def _covered(recording: OutputRecording, time_s: Array) -> Mask:
    """Mark the instants that lie within a segment of the recording."""
    inside = np.zeros(len(time_s), dtype=bool)
    for part in recording.segments:
        first, last = np.searchsorted(time_s, (recording.t_s[part.start], recording.t_s[part.stop - 1]))
        inside[first : last + 1] = True
    return inside


def _detail(x: _Band, y: _Band, scale: int, rate_Hz: float, config: SynchronyConfig) -> tuple[float, float, int]:
    spectrum = x.spectrum * np.conj(y.spectrum)
    # All lags at once by the correlation theorem; its ends wrap around, which is why only a quarter is searched.
    every = np.fft.irfft(spectrum, x.length) / (x.spread * y.spread * x.length + 1e-300)
    max_shift = min(x.length // 4, round(LONGEST_LAG_s * rate_Hz))
    near = np.concatenate([every[: max_shift + 1], every[-max_shift:]])
    # Slow loads leave the peak flat: without a clear gain the clocks are taken as equal.
    best = 0 if near[0] >= 0.9 * near.max() else int(np.argmax(near))
    lag = best if best <= max_shift else best - len(near)
    # Unrelated lags say what chance alone gives on this very recording: no assumption on its noise is needed.
    edge = config.apart * scale
    far = every[edge:-edge] if len(every) > 4 * edge else every
    # Periodic presses agree again one period later; the largest agreement elsewhere counts as much as the usual one.
    spread = max(float(np.std(far)), 1e-12)
    elsewhere = max(0.0, float(far.max()) - config.chance * spread)
    return float(near[best]), float((near[best] - elsewhere) / spread), lag
