"""Were two units pressed by the same load at the same time? Found from their outputs alone."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import rankdata

from softcal.core.maps.crossing import moving_mean
from softcal.core.recording import Array, Indices, OutputRecording

MIN_RANK_CORRELATION = 0.9
MIN_RANK_ALONE = 0.94
"""Outputs this alike at equal time ran one programme even where noise hides its fine structure."""

MIN_DETAIL = 0.1
MIN_SIGMA = 2.5
"""The fine structure must agree this many standard deviations better at one lag than at all others."""

LONGEST_LAG_S = 1.0
CLEAR_GAIN = 0.9
SCALES = (5, 25, 50)
"""Fine structure is what a mean over this many samples keeps and one over ten times as many does not."""


@dataclass(frozen=True)
class Synchrony:
    """What the outputs say about a common load.

    Args:
        lag_s: seconds the target's clock is ahead of the source's.
        rank_correlation: of the two outputs at equal time.
        detail: correlation of their fine structure at that lag, on the scale that shows it best.
        sigma: how far that stands out of the same correlation at unrelated lags, in standard deviations.
    """

    lag_s: float
    rank_correlation: float
    detail: float
    sigma: float

    @property
    def is_synchronous(self) -> bool:
        """Whether pairing windows at equal time is supported."""
        return self.rank_correlation >= MIN_RANK_CORRELATION and self.detail >= MIN_DETAIL and self.sigma >= MIN_SIGMA


NONE = Synchrony(0.0, 0.0, 0.0, 0.0)


def find_synchrony(source: OutputRecording, target: OutputRecording) -> Synchrony:
    """Compare two recordings on their common stretch of time.

    A slow rise and fall alone correlates for any two programmes of one kind; only fine structure that agrees at one
    lag and at no other shows a common load. Ranks make the comparison blind to the static curves of the units.
    """
    rate_Hz = source.sample_rate_Hz
    start, stop = max(source.t_s[0], target.t_s[0]), min(source.t_s[-1], target.t_s[-1])
    time_s = np.arange(start, stop, 1.0 / rate_Hz)
    if len(time_s) < 20 * min(SCALES) or abs(target.sample_rate_Hz / rate_Hz - 1) > 0.02:
        return NONE
    a = rankdata(np.interp(time_s, source.t_s, source.output))
    b = rankdata(np.interp(time_s, target.t_s, target.output))
    if np.ptp(a) == 0 or np.ptp(b) == 0:
        return NONE
    found = [_detail(a, b, scale, rate_Hz) for scale in SCALES if 20 * scale <= len(time_s)]
    detail, sigma, lag = max(found, key=lambda item: item[1])
    shifted = np.roll(b, lag)
    return Synchrony(-lag / rate_Hz, float(np.corrcoef(a, shifted)[0, 1]), detail, sigma)


def paired_rows(source: OutputRecording, target: OutputRecording, lag_s: float) -> tuple[Indices, Indices]:
    """Return the windows of both recordings whose newest samples were taken at the same time.

    Returns:
        Row numbers into `source.windows` and `target.windows`, equal lengths.
    """
    source_s, target_s = source.t_s[source.window_rows], target.t_s[target.window_rows] - lag_s
    right = np.clip(np.searchsorted(source_s, target_s), 1, len(source_s) - 1)
    nearest = right - (target_s - source_s[right - 1] < source_s[right] - target_s)
    close = np.abs(source_s[nearest] - target_s) <= 0.51 / source.sample_rate_Hz
    return nearest[close].astype(np.int64), np.flatnonzero(close).astype(np.int64)


def _detail(a: Array, b: Array, scale: int, rate_Hz: float) -> tuple[float, float, int]:
    x, y = _band(a, scale), _band(b, scale)
    spectrum = np.fft.rfft(x) * np.conj(np.fft.rfft(y))
    every = np.fft.irfft(spectrum, len(x)) / (np.std(x) * np.std(y) * len(x) + 1e-300)
    reach = min(len(x) // 4, round(LONGEST_LAG_S * rate_Hz))
    near = np.concatenate([every[: reach + 1], every[-reach:]])
    # Slow loads leave the peak flat: without a clear gain the clocks are taken as equal.
    best = 0 if near[0] >= CLEAR_GAIN * near.max() else int(np.argmax(near))
    lag = best if best <= reach else best - len(near)
    far = every[10 * scale : -10 * scale] if len(every) > 40 * scale else every
    # Periodic presses agree again one period later; the largest agreement elsewhere counts as much as the usual one.
    spread = max(float(np.std(far)), 1e-12)
    return float(near[best]), float((near[best] - max(0.0, float(far.max()) - 4 * spread)) / spread), lag


def _band(values: Array, scale: int) -> Array:
    slow = moving_mean(values, 10 * scale)
    fast = moving_mean(values, scale)
    offset = (len(fast) - len(slow)) // 2
    band = fast[offset : offset + len(slow)] - slow
    return np.asarray(band - band.mean())
