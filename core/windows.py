"""The window of the time-delay network: the last 15 output samples, newest last."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

TAPS = 15


def windows(signal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return every full window of a gap-free signal as a read-only view.

    Args:
        signal: (n,) output samples in time order, n >= TAPS.

    Returns:
        (n - TAPS + 1, TAPS); row k holds samples k ... k + TAPS - 1, newest sample last.

    Raises:
        ValueError: fewer than TAPS samples.
    """
    if len(signal) < TAPS:
        raise ValueError(f"{len(signal)} samples, at least {TAPS} are needed for one window")
    from numpy.lib.stride_tricks import sliding_window_view

    return sliding_window_view(signal, TAPS)


def evenly(count: int, max_count: int) -> NDArray[np.int64]:
    """Return at most `max_count` row numbers spread evenly over `count`."""
    import numpy as np

    return np.linspace(0, count - 1, min(max_count, count)).astype(np.int64)


def resting(levels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the windows (n, TAPS) of a sensor whose output stands still at each of (n,) levels."""
    import numpy as np

    return np.repeat(levels[:, None], TAPS, axis=1)
