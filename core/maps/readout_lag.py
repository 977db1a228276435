"""Does a unit's readout follow slower than its source's, beside one load and one clock? From both outputs alone.

A clock that is ahead moves the output as it is. A slow readout rounds it as well: a first-order low-pass on the
source's output then explains the unit's better than any delay does.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from softcal.core.maps.config import MapConfig
from softcal.core.maps.crossing import CACHED, moving_mean
from softcal.core.maps.synchrony import Synchrony, common_time, find_synchrony, ranks
from softcal.core.recording import Array, OutputRecording

MEAN_SAMPLES = 50
"""Samples of the means that are compared: a low-pass takes noise of the source away as well, and that is no lag."""


@dataclass(frozen=True)
class ReadoutLag:
    """A readout that follows slower than the source's.

    Args:
        time_constant_s: of the low-pass that carries the source's output to the unit's, in seconds.
        explained: how many times less of the unit's ranks it leaves unexplained than the best delay, or none.
        is_paired: whether the outputs were seen to share their load without it.
    """

    time_constant_s: float
    explained: float
    is_paired: bool


def find_readout_lag(
    source: OutputRecording, target: OutputRecording, synchrony: Synchrony, maps: MapConfig
) -> ReadoutLag | None:
    """Return how much slower a unit's readout is than its source's; None where nothing shows it.

    Only loads that both were pressed by at once can show it. A strong lag hides them, so they are looked for behind a
    slowed source as well. Loads that change slowly show no lag, and suffer from none.
    """
    config = maps.lag
    shared = synchrony if synchrony.is_synchronous else find_synchrony(_low_pass(source, 0.5), target, maps)
    if not shared.is_synchronous:
        return None
    time_s = common_time(source, target, until_s=shared.until_s)
    # Ten means that share no sample: fewer show no lag.
    if len(time_s) < 10 * MEAN_SAMPLES:
        return None
    unit = _ranks(_at(target, time_s))
    prompt = _unexplained(_at(source, time_s), unit)
    if _unexplained(_at(_low_pass(source, config.min_lag_s), time_s), unit) >= prompt:
        return None  # Nearly every unit ends here: what follows slower is met at least a little by the shortest lag.
    # A lag below the least is looked for, too, so that it is not taken for a longer one.
    lags_s = config.min_lag_s * 2.0 ** (np.arange(-4, 8) / 2)
    slow = [_unexplained(_at(_low_pass(source, lag_s), time_s), unit) for lag_s in lags_s]
    best = int(np.argmin(slow))
    late = min(prompt, *(_unexplained(_at(source, time_s - lag_s), unit) for lag_s in lags_s))
    explained = late / max(slow[best], 1e-12)
    is_alike = slow[best] <= 1 - maps.synchrony.min_rank_correlation
    is_lag = is_alike and explained >= config.explained and lags_s[best] >= config.min_lag_s
    return ReadoutLag(float(lags_s[best]), float(explained), synchrony.is_synchronous) if is_lag else None


@lru_cache(maxsize=CACHED)
def _low_pass(recording: OutputRecording, lag_s: float) -> OutputRecording:
    """Return the recording behind a first-order low-pass that stood at its first value before.

    Every unit of a lot is compared with one and the same source.
    """
    decay = np.exp(-1 / (recording.sample_rate_Hz * lag_s))
    # Beyond seven time constants a sample counts by less than a thousandth.
    kernel = (1 - decay) * decay ** np.arange(int(np.ceil(7 * lag_s * recording.sample_rate_Hz)) + 1)
    first = float(recording.output[0])
    moved = np.convolve(recording.output - first, kernel)[: len(recording.output)]
    return replace(recording, output=first + moved)


def _at(recording: OutputRecording, time_s: Array) -> Array:
    return np.asarray(np.interp(time_s, recording.t_s, recording.output))


def _unexplained(source: Array, unit_ranks: Array) -> float:
    """Return the share of the ranks' variation that one output leaves of the other."""
    return 1 - float(np.corrcoef(_ranks(source), unit_ranks)[0, 1])


def _ranks(output: Array) -> Array:
    # Neighbouring means share nearly all their samples: five to a length hold what all do.
    return ranks(moving_mean(output, MEAN_SAMPLES)[:: MEAN_SAMPLES // 5])
