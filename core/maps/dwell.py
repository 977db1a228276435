"""Time without dwell: a wait shows the programme, how a passage paces from level to level shows the unit."""

import numpy as np

from softcal.core.maps.config import MapConfig
from softcal.core.maps.crossing import averaging_length, level_path, smoothed
from softcal.core.recording import Array, OutputRecording
from softcal.core.windows import TAPS


def paced_time(recording: OutputRecording, config: MapConfig) -> Array:
    """Return the weight of each sample of a bridged recording: time beyond the usual pace of a passage does not count.

    A passage lies between two turning points, or between one and a gap. Its usual pace is the median of the times that
    it spends in equal bands of the output. A unit that is bent goes through its bands at different paces, alike in
    every passage; a programme that waits stays in one of them.
    """
    bands, average = config.curve.bands, averaging_length(recording, config.crossing)
    path = level_path(recording, average, config.crossing)
    ends = [row for part in recording.segments for row in (part.start, part.stop)]
    bounds = np.unique(np.concatenate([ends] if path is None else [ends, path.start, path.stop]))
    passage = np.repeat(np.arange(len(bounds) - 1), np.diff(bounds))
    low, high = np.quantile(recording.output, config.ends.quantile_range)
    # Averaged over a window: noise at a border would show a dwell in neither of two bands.
    level = smoothed(recording, TAPS)
    band = np.searchsorted(np.linspace(low, high, bands + 1)[1:-1], level)
    time = np.bincount(bands * passage + band, minlength=bands * (len(bounds) - 1)).reshape(-1, bands)
    is_passed = (np.cumsum(time, axis=1) > 0) & (np.cumsum(time[:, ::-1], axis=1)[:, ::-1] > 0)
    # np.nanmedian gives the same and takes ten times as long.
    count, ordered = is_passed.sum(axis=1), np.sort(np.where(is_passed, time, len(recording)), axis=1)
    usual = np.take_along_axis(ordered, np.stack([(count - 1) // 2, count // 2], axis=1), axis=1).mean(axis=1)
    # A passage through few bands shows no pace of its own: it has that of the recording.
    usual[count < bands / 2] = np.median(time[time > 0])
    weights = np.minimum(1.0, np.maximum(usual, 1.0)[:, None] / np.maximum(time, 1))
    return np.asarray(weights[passage, band])
