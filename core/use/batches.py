"""A stream worked through in batches of fixed size, counted from its first row: what all who follow a unit share.

Each row is estimated with the map of its batch; what a batch shows changes the map of later ones only. So a row depends
on no later row (the estimate is causal), and single samples and whole arrays give the same rows.
"""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from softcal.core.network.network import Network
from softcal.core.recording import Array
from softcal.core.unit.estimate import FLAG_TYPE, SATURATED, STUCK, Estimate, EstimateRow, Flags
from softcal.core.use.intake import WRONG_RATE
from softcal.core.use.method import UseMethod

START = "start"
NOT_EVIDENCE = (STUCK, SATURATED, WRONG_RATE)
"""Rows with these flags say nothing about drift or use."""

MOST_UPDATES = 4096
"""Changes kept for a caller that does not take them."""


@dataclass(frozen=True)
class MapUpdate:
    """The correction A_t from one row on, and what it rests on. All numbers are JSON values.

    Args:
        row: first row it holds for, counted from 0.
        t_s: time of the evidence.
        gain, offset: calibrated output = offset + gain * output now.
        shift, log_gain: drift of the output in scales of the calibrated use.
        shift_sd, log_gain_sd: their standard deviations.
        predicted_rmse: predicted error of the estimates, in the reference unit.
        verdict: `start`, `followed`, `held`, `tried`, `jumped`, or `unwatched` while the first use is being learnt.
        reason: why it was held, or what was tried or jumped.
        alarm: why a calibration with a reference is due; empty while it is not.
    """

    row: int
    t_s: float | None
    gain: float
    offset: float
    shift: float
    log_gain: float
    shift_sd: float
    log_gain_sd: float
    predicted_rmse: float
    verdict: str
    reason: str
    alarm: str


class Batches(ABC):
    """Takes rows, cuts them into batches and keeps what changed; how a batch is estimated is the subclass's.

    Args:
        network: the shared network f.
        method: every number that decides.
    """

    def __init__(self, network: Network, method: UseMethod) -> None:
        self._network, self._method, self._row = network, method, 0

    def _begin(self, start: MapUpdate) -> None:
        self._current = start
        self._updates = deque([start], maxlen=MOST_UPDATES)

    @property
    def current(self) -> MapUpdate:
        """The correction in force."""
        return self._current

    @property
    def row(self) -> int:
        """How many rows were taken."""
        return self._row

    def take_updates(self) -> list[MapUpdate]:
        """Return every change of map, verdict or alarm since the last call, oldest first, `MOST_UPDATES` at most."""
        taken = list(self._updates)
        self._updates.clear()
        return taken

    def step(self, t_s: float, output: float) -> EstimateRow:
        """Take one sample and return its row."""
        rows = self.advance(np.array([t_s]), np.array([output]))
        value, lower, upper = float(rows.estimate[0]), float(rows.lower[0]), float(rows.upper[0])
        return EstimateRow(t_s, value, lower, upper, str(rows.flag[0]))

    def advance(self, t_s: Array, output: Array) -> Estimate:
        """Take (n,) further samples, one row each; the same rows as `step` one by one.

        Args:
            t_s: time stamps in s; a time that is not finite, repeats or goes backward makes the row `invalid`.
            output: in the unit of the calibration; NaN makes the row `invalid`.
        """
        n = len(output)
        value, lower, upper = np.full(n, np.nan), np.full(n, np.nan), np.full(n, np.nan)
        flag = np.empty(n, dtype=FLAG_TYPE)
        start, batch = 0, self._method.intake.batch
        while start < n:
            stop = min(n, start + batch - self._row % batch)
            piece = slice(start, stop)
            value[piece], lower[piece], upper[piece], flag[piece] = self._estimate(t_s[piece], output[piece])
            self._row += stop - start
            if self._row % batch == 0:
                self._close_batch()
            start = stop
        return Estimate(t_s, value, lower, upper, flag, self._network.reference_unit)

    @abstractmethod
    def _estimate(self, t_s: Array, output: Array) -> tuple[Array, Array, Array, Flags]:
        """Return estimate, lower, upper and flag of rows that lie in one batch."""

    @abstractmethod
    def _close_batch(self) -> None:
        """Learn from the batch that has ended."""

    @abstractmethod
    def reconnect(self, row: int = 0) -> None:
        """Go on after an interruption of unknown length: windows start anew, the map stays.

        Args:
            row: count rows from here at least.
        """

    @abstractmethod
    def state(self) -> dict[str, object]:
        """Return all that a restart needs besides what the constructor is given, as JSON values."""

    @abstractmethod
    def restore(self, state: Mapping[str, Any]) -> list[str]:
        """Go on from a `state()` taken earlier, of the same unit and calibration.

        Returns:
            The numbers of the method that have changed since, as `name: earlier value, now value`.

        Raises:
            InputError: the state was taken by a version or mode that keeps other things in it; nothing was changed.
        """
