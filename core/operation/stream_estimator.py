"""A stream worked through in batches of fixed size, counted from its first row: what all who follow a unit share.

Each row is estimated with the map of its batch; what a batch shows changes the map of later ones only. So a row depends
on no later row (the estimate is causal). Single samples and whole arrays give the same rows, and memory does not grow.
"""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from softcal.core.errors import InputError
from softcal.core.metrics import rms
from softcal.core.network.network import Network
from softcal.core.operation.method import DriftTracking
from softcal.core.operation.observation import FOLLOWED, ON_HOLD, UNWATCHED
from softcal.core.operation.stored_state import from_state
from softcal.core.operation.stream_windows import WRONG_RATE, BatchWindows, WindowBuffer
from softcal.core.recording import Array, Mask, OutputRecording
from softcal.core.unit.estimate import SATURATED, STUCK, Estimate, EstimateRow, check_fits, evaluate_windows
from softcal.core.unit.state import UnitState
from softcal.core.unit.uncertainty import NORMAL_90

START = "start"
NOT_EVIDENCE = (STUCK, SATURATED, WRONG_RATE)
"""Rows with these flags say nothing about drift or use."""

RECALIBRATE = "recalibrate"
"""Flag of rows that would be trusted, were the unit not due for a calibration with a reference."""

UNSETTLED = "unsettled"
"""Flag of rows that would be trusted, were it not for a sudden change that more cycles must explain."""

FLAG_SEPARATOR = "; "
"""Between the words of a flag: why a row is not to be trusted, and the state of its map."""

FLAGS_TYPE = "<U24"
STATES = (UNWATCHED, ON_HOLD, FOLLOWED)
"""The state of the map, in the flag of every row of a stream that is followed."""

MAX_UPDATES = 4096
"""Changes kept for a caller that does not take them."""


@dataclass(frozen=True)
class MapUpdate:
    """The correction A_t from one row on, and what it rests on. All numbers are JSON values.

    Args:
        row: first row it holds for, counted from 0.
        gain, offset: calibrated output = offset + gain * output now.
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


def state_of_map(verdict: str) -> str:
    """Return the state of the map that a verdict leaves."""
    return {START: UNWATCHED, UNWATCHED: UNWATCHED, ON_HOLD: ON_HOLD}.get(verdict, FOLLOWED)


class StreamEstimator(ABC):
    """Takes rows, cuts them into batches and keeps what changed; which map a batch has is the subclass's.

    Args:
        calibration: of the unit, from the registry: f∘γ₀ and its interval.
        recording: the unit's own output at calibration.
        state_format: of what `state` returns; another one whenever a state kept before could not be gone on from.
        is_watched: whether rows say the state of the map: not where it is left as it is.

    Raises:
        InputError: the calibration belongs to another network, or the recording has another physical unit.
    """

    def __init__(
        self,
        network: Network,
        calibration: UnitState,
        recording: OutputRecording,
        method: DriftTracking,
        state_format: int | str,
        is_watched: bool = True,
    ) -> None:
        check_fits(network, calibration, recording.output_unit)
        self._network, self._calibration, self._method, self._format = network, calibration, method, state_format
        self._is_watched = is_watched
        self._sample_rate_Hz, self._blank = recording.sample_rate_Hz, float(recording.output.mean())
        # The error the calibration promises, in the reference unit.
        predicted_rmse, half = calibration.predicted_rmse, calibration.interval.half_width
        self._calibrated_rmse = rms(half) / NORMAL_90 if predicted_rmse is None else predicted_rmse
        self._row, self._silent_batches, self._is_silent, self._uncertainty = 0, 0, True, 0.0
        self._window_buffer = self._new_window_buffer()

    def _new_window_buffer(self) -> WindowBuffer:
        return WindowBuffer(self._sample_rate_Hz, self._blank, self._method.stream)

    def _begin(self, start: MapUpdate) -> None:
        self._current = start
        self._updates = deque([start], maxlen=MAX_UPDATES)

    @property
    def current(self) -> MapUpdate:
        """The correction in force."""
        return self._current

    @property
    def row(self) -> int:
        """How many rows were taken."""
        return self._row

    def take_updates(self) -> list[MapUpdate]:
        """Return every change of map, verdict or alarm since the last call, oldest first, `MAX_UPDATES` at most."""
        windows = list(self._updates)
        self._updates.clear()
        return windows

    def step(self, t_s: float, output: float) -> EstimateRow:
        """Take one sample and return its row."""
        rows = self.advance(np.array([t_s]), np.array([output]))
        value, lower, upper = float(rows.estimate[0]), float(rows.lower[0]), float(rows.upper[0])
        return EstimateRow(t_s, value, lower, upper, str(rows.flag[0]))

    def advance(self, t_s: Array, output: Array) -> Estimate:
        """Take (n,) further samples, one row each; the same rows as `step` one by one.

        A flag holds why a row is not to be trusted, if so, and the state of its map: `unwatched`, `held` or `followed`.

        Args:
            t_s: time stamps in s; a time that is not finite, repeats or goes backward makes the row `invalid`.
            output: in the unit of the calibration; NaN makes the row `invalid`.
        """
        n = len(output)
        value, lower, upper = np.full(n, np.nan), np.full(n, np.nan), np.full(n, np.nan)
        flag = np.empty(n, dtype=FLAGS_TYPE)
        start, batch = 0, self._method.stream.batch
        while start < n:
            first = self._row % batch
            stop = min(n, start + batch - first)
            piece, rows = slice(start, stop), slice(first, first + stop - start)
            windows = self._window_buffer.add_rows(t_s[piece], output[piece], first)
            mapped, newest = self._mapped(windows.windows), windows.windows[:, -1]
            estimate, low, high, value_flag = evaluate_windows(
                self._network, self._calibration, mapped, newest, windows.run
            )
            # Rows without a full window went through the network with the others; their numbers mean nothing.
            value[piece] = np.where(windows.is_full, estimate, np.nan)[rows]
            # Independent errors add in squares: those of the calibration's interval and of the drift.
            half = np.sqrt((0.5 * (high - low)) ** 2 + (NORMAL_90 * self._uncertainty) ** 2)[rows]
            lower[piece], upper[piece] = value[piece] - half, value[piece] + half
            flags = np.where(windows.flag != "", windows.flag, value_flag)[rows].astype(FLAGS_TYPE)
            is_evidence = ~np.isin(flags, NOT_EVIDENCE)
            self._is_silent = self._is_silent and not (windows.is_valid[rows] & is_evidence).any()
            self._gather(t_s[piece], output[piece], windows, rows, is_evidence)
            doubtful = UNSETTLED if self._is_doubtful else ""
            flags[flags == ""] = RECALIBRATE if self._current.alarm else doubtful
            if self._is_watched:
                state = state_of_map(self._current.verdict)
                flags = np.where(flags == "", state, np.char.add(np.char.add(flags, FLAG_SEPARATOR), state))
            flag[piece] = flags
            self._row += stop - start
            if self._row % batch == 0:
                self._silent_batches = self._silent_batches + 1 if self._is_silent else 0
                self._is_silent = True
                self._close_batch()
            start = stop
        return Estimate(t_s, value, lower, upper, flag, self._network.reference_unit)

    @property
    def _is_doubtful(self) -> bool:
        """Whether the map in force may be far off for now, although no alarm stands."""
        return False

    @abstractmethod
    def _gather(self, t_s: Array, output: Array, windows: BatchWindows, rows: slice, is_evidence: Mask) -> None:
        """Keep what rows of a batch say about the use."""

    def _alarm(self) -> str:
        """Return the alarm of a sensor that has been silent for long; empty where it is not."""
        if self._silent_batches * self._method.stream.batch < self._method.stream.settling:
            return ""
        return "the sensor gives no usable samples; check sensor and cable"

    @abstractmethod
    def _mapped(self, windows: Array) -> Array:
        """Return (n, TAPS) windows in the space of the source, by the map in force."""

    @abstractmethod
    def _close_batch(self) -> None:
        """Learn from the batch that has ended."""

    def reconnect(self, row: int = 0) -> None:
        """Go on after an interruption, from row `row` at least: windows start anew, the map stays."""
        self._row = max(self._row, row)
        # A batch never holds rows from before and after the interruption.
        self._row += -self._row % self._method.stream.batch
        self._window_buffer, self._is_silent = self._new_window_buffer(), True

    def state(self) -> dict[str, object]:
        """Return all that a restart needs besides what the constructor is given, as JSON values.

        The method is part of it: `restore` under another method says which numbers changed.
        """
        return {
            "format": self._format,
            "method": self._method.to_json(),
            "row": self._row,
            "uncertainty": self._uncertainty,
            "silent_batches": self._silent_batches,
            "is_silent": self._is_silent,
            "current": asdict(self._current),
            "intake": self._window_buffer.state(),
            **self._subclass_state(),
        }

    def restore(self, state: Mapping[str, Any]) -> list[str]:
        """Go on from a `state()` taken earlier, of the same unit and calibration.

        Returns:
            The numbers of the method that have changed since, as `name: earlier value, now value`.

        Raises:
            InputError: the state was taken by a version or mode that keeps other things in it; nothing was changed.
        """
        if (stored := state.get("format")) != self._format:
            raise InputError(f"its state has format {stored}, what goes on here has format {self._format}")
        if mismatched := set(self.state()) ^ set(state):
            raise InputError(f"its state does not fit this version: {min(mismatched)} is missing or unknown")
        # All of it is read before any of it counts: a state that does not fit changes nothing.
        current, window_buffer = from_state(MapUpdate, state["current"]), self._new_window_buffer()
        window_buffer.restore(state["intake"])
        self._restore_subclass(state)
        self._current, self._window_buffer = current, window_buffer
        self._row, self._uncertainty = int(state["row"]), float(state["uncertainty"])
        self._silent_batches, self._is_silent = int(state["silent_batches"]), bool(state["is_silent"])
        self._updates.clear()
        return self._method.changes(DriftTracking.from_json(state["method"]))

    @abstractmethod
    def _subclass_state(self) -> dict[str, object]:
        """Return what the subclass keeps beside, as JSON values."""

    @abstractmethod
    def _restore_subclass(self, state: Mapping[str, Any]) -> None:
        """Go on from what `_subclass_state` returned; read all of it before any of it counts."""

    def _set_current(self, proposed: MapUpdate) -> None:
        """Put an update in force; it is a step of the record where the map, or what is said of it, changed."""
        names = ("gain", "offset", "verdict", "reason", "alarm")
        if any(getattr(proposed, name) != getattr(self._current, name) for name in names):
            self._updates.append(proposed)
            self._current = proposed
        else:
            # The map stays; only what is said about its error moves on.
            self._current = replace(self._current, predicted_rmse=proposed.predicted_rmse)
