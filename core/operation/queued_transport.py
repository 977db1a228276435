"""The paper's online method for long use: queues of windows mapped anew by an exact plan (Kim et al. 2020, Fig. 5).

A queue fills with the unlabelled windows of the stream. When it is full, the exact plan between its windows and those
of the source is solved, while the next queue fills. The rule for the swap: the map fitted on queue k is in force from
the first batch after queue k + 1 is full. So the same rows always give the same estimates. Only where a plan takes
longer than a queue takes to fill does the swap come later: estimates never wait.
"""

from collections.abc import Mapping
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softcal.core.errors import InputError
from softcal.core.maps.anchors import AnchoredMap
from softcal.core.maps.interface import UnitMap
from softcal.core.maps.plan import EXACT, TransportMap, exact_map
from softcal.core.metrics import rms, rmse
from softcal.core.network.network import Network
from softcal.core.operation.adapter import QUEUES, AdaptConfig
from softcal.core.operation.method import DriftTracking
from softcal.core.operation.observation import FOLLOWED, QUEUE_DIFFERS, UNWATCHED
from softcal.core.operation.stream_estimator import START, MapUpdate, StreamEstimator
from softcal.core.operation.stream_windows import BatchWindows
from softcal.core.operation.uncertainty import QUEUE, with_remedy
from softcal.core.recording import Array, LabelledRecording, Mask, OutputRecording
from softcal.core.unit.estimate import check_fits
from softcal.core.unit.state import UnitState
from softcal.core.windows import TAPS

FORMAT = "queues 3"
"""Of what `QueuedTransport.state` returns; another name whenever a state kept before could not be gone on from."""


@dataclass(frozen=True, eq=False)
class MappedSource:
    """(n, TAPS) windows that queues are mapped onto, as a sensor gave them, and where they stand in the space of f."""

    windows: Array
    mapped: Array


@dataclass(frozen=True, eq=False)
class _QueueFit:
    """The map of a queue, and by how much it moves the estimates (RMS), and maps of queues without drift by chance."""

    map: TransportMap
    rms_shift: float
    rms_chance: float


class QueuedTransport(StreamEstimator):
    """Estimates a stream as f∘γ and finds γ anew on every full queue; same interface as `adapter.Adapter`.

    It assumes that each queue was used under the source's distribution of loads: a change of use is taken for drift.
    Rows that are stuck, saturated, at a wrong rate or without a full window enter no queue. What the method gets wrong
    by itself is measured on the calibration recording, cut into queues: they differ from the whole by chance alone.
    That, and all that a swap has moved the estimates by, is in the interval.

    A unit that was anchored by known loads keeps them. Its first queue, as it is read by the anchored map, is the
    source of the later ones.

    Args:
        calibration: of the unit, from the registry: f∘γ₀, which holds until the first swap, and its interval.
        recording: the unit's own output at calibration; what a drift is stated against.
        config: mode `ot` or `ot-improved`; improved, the source becomes each queue with its best estimates.

    Raises:
        InputError: the calibration belongs to another network, a recording has another physical unit, or the queue is
            smaller than a window.
        ValueError: the mode is one of `adapter.Adapter`.
    """

    def __init__(
        self,
        network: Network,
        calibration: UnitState,
        recording: OutputRecording,
        source: LabelledRecording,
        config: AdaptConfig,
        pool: Executor | None = None,
    ) -> None:
        if config.mode not in QUEUES:
            raise ValueError(f"mode {config.mode!r} is none of {', '.join(QUEUES)}")
        super().__init__(network, calibration, recording, config.method, f"{FORMAT} {config.mode}")
        check_fits(network, calibration, source.unlabelled.output_unit)
        self._queue = config.method.online.queue
        if self._queue < TAPS:
            raise InputError(f"a queue of {self._queue} is smaller than a window; give {TAPS} or more")
        self._mode, self._pool = config.mode, pool
        self._map: UnitMap = calibration.unit_map
        is_anchored = isinstance(self._map, AnchoredMap)
        self._fixed_source = None if is_anchored else MappedSource(source.windows, source.windows)
        self._source = self._fixed_source
        self._filling, self._full = np.empty((0, TAPS)), np.empty((0, TAPS))
        self._fit: Future[_QueueFit] | None = None
        self._calibration_windows, self._alarm_reason = recording.windows, ""
        error = self._calibrated_rmse
        self._begin(MapUpdate(0, None, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, error, START, "no queue is mapped yet", ""))

    @cached_property
    def _chance(self) -> float:
        """How far maps of single queues of the calibration recording are off the calibrated one (RMS)."""
        last = max(0, len(self._calibration_windows) - self._queue)
        # The first, a middle and the last one.
        starts = sorted({0, last // 2, last})
        pieces = [self._calibration_windows[start : start + self._queue] for start in starts]
        source = self._fixed_source or self._as_calibrated(pieces[0])
        shifts = [self._rms_shift(self._mapped_onto(source, piece), piece) for piece in pieces]
        return rms(np.array(shifts))

    def _rms_shift(self, fitted: UnitMap, windows: Array) -> float:
        """Return by how much a map moves the estimates of windows from those of the calibration (RMS)."""
        return rmse(*(self._network.evaluate(one.apply(windows)) for one in (fitted, self._calibration.unit_map)))

    def _as_calibrated(self, windows: Array) -> MappedSource:
        return MappedSource(windows, self._calibration.unit_map.apply(windows))

    @property
    def unit_map(self) -> UnitMap:
        return self._map

    @property
    def source(self) -> MappedSource | None:
        """What the next queue is mapped onto; None where that is the first queue, which is not full yet."""
        return self._source

    def _mapped(self, windows: Array) -> Array:
        return self._map.apply(windows)

    def _gather(self, t_s: Array, output: Array, windows: BatchWindows, rows: slice, is_evidence: Mask) -> None:
        self._filling = np.concatenate([self._filling, windows.windows[rows][windows.is_full[rows] & is_evidence]])

    def _close_batch(self) -> None:
        # A plan takes a fraction of the time in which a queue fills: live, it is there by now. Where it is not, the
        # windows of the queue that has filled meanwhile make room for newer ones.
        if self._fit is not None and not self._fit.done():
            self._filling = self._filling[-self._queue :]
        else:
            while len(self._filling) >= self._queue:
                full, self._filling = self._filling[: self._queue], self._filling[self._queue :]
                if self._source is None:
                    self._source = self._as_calibrated(full)
                    continue
                if len(self._full):
                    self._swap(self._fitted(self._full, self._source) if self._fit is None else self._fit.result())
                self._full = full
                self._fit = None if self._pool is None else self._pool.submit(self._fitted, full, self._source)
        self._set_current(replace(self._current, row=self._row, alarm=self._alarm() or self._alarm_reason))

    def _mapped_onto(self, source: MappedSource, queue: Array) -> TransportMap:
        return exact_map(queue, source.windows, source.mapped)

    def _fitted(self, queue: Array, source: MappedSource) -> _QueueFit:
        mapped = self._mapped_onto(source, queue)
        return _QueueFit(mapped, self._rms_shift(mapped, queue), self._chance)

    def _swap(self, fitted: _QueueFit) -> None:
        """Put the map of the queue that waits in force."""
        self._set_map(fitted.map)
        now, then, uncertainty = self._full[:, -1], self._calibration_windows[:, -1], self._method.uncertainty
        gain = float(then.std() / max(now.std(), 1e-12))
        shift, log_gain = float((now.mean() - then.mean()) / then.std()), -float(np.log(gain))
        # All of it may be another use: nothing in a queue tells it from drift.
        self._uncertainty = max(fitted.rms_chance, fitted.rms_shift)
        predicted = float(np.hypot(self._calibrated_rmse, self._uncertainty))
        is_significant = fitted.rms_shift**2 > uncertainty.certain * fitted.rms_chance**2
        is_due = is_significant and predicted > uncertainty.alarm_ratio * self._calibrated_rmse
        self._alarm_reason = with_remedy(QUEUE) if is_due else ""
        estimates = self._network.evaluate(self._calibration.unit_map.apply(self._calibration_windows))
        is_blind = fitted.rms_chance > self._method.online.blind * float(estimates.std())
        self._set_current(
            replace(
                self._current,
                row=self._row,
                t_s=self._window_buffer.last_s,
                gain=gain,
                offset=float(then.mean() - gain * now.mean()),
                shift=shift,
                log_gain=log_gain,
                predicted_rmse=predicted,
                verdict=UNWATCHED if is_blind else FOLLOWED,
                reason=QUEUE_DIFFERS if is_blind else "",
                alarm=self._alarm_reason,
            )
        )

    def _set_map(self, fitted: TransportMap) -> None:
        self._map = fitted
        if self._mode == "ot-improved":
            self._source = MappedSource(fitted.stored, fitted.stored + fitted.displacement)

    def _subclass_state(self) -> dict[str, object]:
        # A queue of 512 windows makes up to 0.6 MB.
        arrays: dict[str, NDArray[Any]] = {"filling": self._filling, "full": self._full}
        if isinstance(self._calibration.unit_map, AnchoredMap) and self._source is not None:
            arrays |= {"windows": self._source.windows, "mapped": self._source.mapped}
        if isinstance(self._map, TransportMap) and self._map is not self._calibration.unit_map:
            arrays |= self._map.arrays()
        return {"alarm": self._alarm_reason, "arrays": {name: values.tolist() for name, values in arrays.items()}}

    def _restore_subclass(self, state: Mapping[str, Any]) -> None:
        if (queue := DriftTracking.from_json(state["method"]).online.queue) != self._queue:
            raise InputError(f"its queues have {queue} windows, this one {self._queue}; {queue} was expected")
        arrays: dict[str, Array] = {}
        for name, rows in state["arrays"].items():
            try:
                arrays[name] = np.array(rows, np.float64).reshape(-1, TAPS)
            except (TypeError, ValueError) as error:
                raise InputError(f"its state does not fit this version: {name} holds no windows") from error
        self._filling, self._full, self._fit = arrays["filling"], arrays["full"], None
        self._alarm_reason = str(state["alarm"])
        if "mapped" in arrays:
            self._source = MappedSource(arrays["windows"], arrays["mapped"])
        if "stored" in arrays:
            self._set_map(TransportMap(arrays["stored"], arrays["displacement"], EXACT))
