"""Rows of a live stream into windows: gaps, faults, repeated and backward times, changes of rate; constant memory."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from softcal.core.operation.method import StreamConfig
from softcal.core.operation.stored_state import from_state, to_state
from softcal.core.recording import GAP_FACTOR, Array, Indices, Mask
from softcal.core.unit.estimate import FLAG_TYPE, GAP, INVALID, WARM_UP, Flags
from softcal.core.windows import TAPS

WRONG_RATE = "wrong rate"
"""Flag of rows whose samples come faster or slower than the network knows."""


@dataclass(frozen=True, eq=False)
class BatchWindows:
    """What became of the rows of one batch; rows of other pieces of it are blank.

    Args:
        windows: (batch, TAPS) newest sample last; blank where no full window ends.
        is_restart: (batch,) whether what came before it is too far away to belong to the same cycle.
        run: (batch,) how many samples, it included, have had exactly this value.
        flag: (batch,) why there is no estimate, or none to trust; else empty.
    """

    windows: Array
    is_full: Mask
    is_valid: Mask
    is_restart: Mask
    run: Indices
    flag: Flags


@dataclass
class WindowBufferState:
    """What a restart needs.

    Args:
        output, times_s: the last TAPS samples and their times, newest last.
        filled: how many of them belong to the window under way.
        waiting_for: flag of rows until a window is full.
        late_rows, late_s: rows in a row with increasing times before the last one taken, and the latest of these.
    """

    output: list[float] = field(default_factory=list)
    times_s: list[float] = field(default_factory=lambda: [0.0] * TAPS)
    filled: int = 0
    run: int = 0
    waiting_for: str = WARM_UP
    late_rows: int = 0
    late_s: float = 0.0
    last_s: float | None = None


class WindowBuffer:
    """Keeps the last window of a stream; windows that are not full are filled with `blank`."""

    def __init__(self, sample_rate_Hz: float, blank: float, config: StreamConfig) -> None:
        self._period_s, self._blank, self._config = 1.0 / sample_rate_Hz, blank, config
        self._state = WindowBufferState([blank] * TAPS)

    @property
    def last_s(self) -> float | None:
        """Time of the last sample taken."""
        return self._state.last_s

    def add_rows(self, t_s: Array, output: Array, first: int) -> BatchWindows:
        """Take (n,) rows into the places first ... first + n - 1 of a batch."""
        # Always a whole batch: BLAS may round a product of another size otherwise, and a row must not depend on how
        # many rows were handed over with it.
        batch = self._config.batch
        result = BatchWindows(
            windows=np.full((batch, TAPS), self._blank),
            is_full=np.zeros(batch, dtype=bool),
            is_valid=np.zeros(batch, dtype=bool),
            is_restart=np.zeros(batch, dtype=bool),
            run=np.ones(batch, dtype=np.int64),
            flag=np.full(batch, "", dtype=FLAG_TYPE),
        )
        state = self._state
        for row, (time_s, value) in enumerate(zip(t_s.tolist(), output.tolist(), strict=True), start=first):
            if not (math.isfinite(time_s) and math.isfinite(value)) or self._is_late(time_s):
                result.flag[row] = INVALID
                continue
            step_s = 0.0 if state.last_s is None else time_s - state.last_s
            result.is_valid[row] = True
            # Two thresholds: any gap breaks the window, but one of a window leaves the cycle of use as it is.
            result.is_restart[row] = step_s < 0 or step_s > TAPS * self._period_s
            if step_s < 0 or step_s > GAP_FACTOR * self._period_s:
                state.filled, state.run, state.waiting_for = 0, 0, GAP
            state.run = state.run + 1 if state.run and value == state.output[-1] else 1
            state.output = [*state.output[1:], value]
            state.times_s = [*state.times_s[1:], time_s]
            state.filled = min(state.filled + 1, TAPS)
            state.last_s = time_s
            if state.filled < TAPS:
                result.flag[row] = state.waiting_for
                continue
            result.windows[row], result.is_full[row], result.run[row] = state.output, True, state.run
            # Over a whole window the jitter of single time stamps cancels.
            mean_period_s = (time_s - state.times_s[0]) / (TAPS - 1)
            if abs(mean_period_s / self._period_s - 1) > self._config.rate_tolerance:
                result.flag[row] = WRONG_RATE
        return result

    def _is_late(self, t_s: float) -> bool:
        """Return whether a time repeats or goes backward, unless a clock that restarted has gone on for a window."""
        state = self._state
        if state.last_s is None or t_s > state.last_s:
            state.late_rows = 0
            return False
        state.late_rows = state.late_rows + 1 if state.late_rows and t_s > state.late_s else 1
        state.late_s = t_s
        if state.late_rows < TAPS:
            return True
        state.late_rows = 0
        return False

    def state(self) -> dict[str, object]:
        return to_state(self._state)

    def restore(self, state: Mapping[str, Any]) -> None:
        self._state = from_state(WindowBufferState, state)
