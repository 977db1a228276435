"""Rows of a live stream into windows: gaps, faults, repeated and backward times, changes of rate; constant memory."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softcal.core.recording import GAP_FACTOR, Array, Indices
from softcal.core.unit.estimate import FLAG_TYPE, GAP, INVALID, WARM_UP, Flags
from softcal.core.windows import TAPS

BATCH = 32
"""Rows worked through together. Every matrix product has this many, so that a row never depends on its neighbours."""

WRONG_RATE = "wrong rate"
RATE_TOLERANCE = 0.10
"""A window whose samples came faster or slower than this is not one the network knows."""

CLOCK_ROWS = TAPS
"""So many rows in a row with times of their own, all before the last one taken, are a restarted clock."""

SHORT_GAP = TAPS
"""A gap of fewer sample periods leaves the cycle of use it falls into usable."""

Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Taken:
    """What became of the rows of one batch; rows of other pieces of it are blank.

    Args:
        windows: (BATCH, TAPS) newest sample last; blank where no full window ends.
        is_full: (BATCH,) whether a full window ends in the row.
        is_valid: (BATCH,) whether the row holds a sample.
        is_restart: (BATCH,) whether what came before it is too far away to belong to the same cycle.
        run: (BATCH,) how many samples, it included, have had exactly this value.
        flag: (BATCH,) why there is no estimate, or none to trust; else empty.
    """

    windows: Array
    is_full: Mask
    is_valid: Mask
    is_restart: Mask
    run: Indices
    flag: Flags


class Intake:
    """Keeps the last window of a stream.

    Args:
        sample_rate_Hz: nominal sample rate.
        blank: fills windows that are not full, in the unit of the output.
    """

    def __init__(self, sample_rate_Hz: float, blank: float) -> None:
        self._period_s, self._blank = 1.0 / sample_rate_Hz, blank
        self._output: deque[float] = deque([blank] * TAPS, maxlen=TAPS)
        self._times: deque[float] = deque([0.0] * TAPS, maxlen=TAPS)
        self._filled, self._run = 0, 0
        self._waiting_for = WARM_UP
        self._late_rows, self._late_s = 0, 0.0
        self.last_s: float | None = None

    def take(self, t_s: Array, output: Array, first: int) -> Taken:
        """Take (n,) rows into the places first ... first + n - 1 of a batch."""
        taken = Taken(
            windows=np.full((BATCH, TAPS), self._blank),
            is_full=np.zeros(BATCH, dtype=bool),
            is_valid=np.zeros(BATCH, dtype=bool),
            is_restart=np.zeros(BATCH, dtype=bool),
            run=np.ones(BATCH, dtype=np.int64),
            flag=np.full(BATCH, "", dtype=FLAG_TYPE),
        )
        for place, (time, value) in enumerate(zip(t_s.tolist(), output.tolist(), strict=True), start=first):
            self._take_row(taken, place, time, value)
        return taken

    def _take_row(self, taken: Taken, place: int, t_s: float, output: float) -> None:
        if not (np.isfinite(t_s) and np.isfinite(output)) or self._is_late(t_s):
            taken.flag[place] = INVALID
            return
        step_s = 0.0 if self.last_s is None else t_s - self.last_s
        taken.is_valid[place] = True
        taken.is_restart[place] = step_s < 0 or step_s > SHORT_GAP * self._period_s
        if step_s < 0 or step_s > GAP_FACTOR * self._period_s:
            self._filled, self._run, self._waiting_for = 0, 0, GAP
        self._run = self._run + 1 if self._run and output == self._output[-1] else 1
        self._output.append(output)
        self._times.append(t_s)
        self._filled = min(self._filled + 1, TAPS)
        self.last_s = t_s
        if self._filled < TAPS:
            taken.flag[place] = self._waiting_for
            return
        taken.windows[place], taken.is_full[place], taken.run[place] = self._output, True, self._run
        seen_s = (t_s - self._times[0]) / (TAPS - 1)
        if abs(seen_s / self._period_s - 1) > RATE_TOLERANCE:
            taken.flag[place] = WRONG_RATE

    def _is_late(self, t_s: float) -> bool:
        """Return whether a time repeats or goes backward, unless a clock that restarted has gone on for long."""
        if self.last_s is None or t_s > self.last_s:
            self._late_rows = 0
            return False
        self._late_rows = self._late_rows + 1 if self._late_rows and t_s > self._late_s else 1
        self._late_s = t_s
        if self._late_rows < CLOCK_ROWS:
            return True
        self._late_rows = 0
        return False

    def state(self) -> dict[str, object]:
        """Return all that a restart needs, as JSON values."""
        lists = {"_output": list(self._output), "_times": list(self._times)}
        return {name.strip("_"): value for name, value in (vars(self) | lists).items()}

    def restore(self, state: Mapping[str, object]) -> None:
        """Go on from a `state()` taken earlier."""
        for name, value in vars(self).items():
            kept = state[name.strip("_")]
            setattr(self, name, deque(kept, maxlen=TAPS) if isinstance(value, deque) else kept)  # type: ignore[call-overload]
