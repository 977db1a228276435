"""The paper's online method for long use: queues of windows mapped anew by optimal transport (Kim et al. 2020, Fig. 5).

A queue fills with the unlabelled windows of the stream. When it is full, the exact plan between its windows and those
of the source is solved, while the next queue fills. The rule for the swap: the map fitted on queue k is in force from
the first batch after queue k + 1 is full. So the same rows always give the same estimates, however fast a machine is.
"""

from collections.abc import Mapping
from concurrent.futures import Executor, Future
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from softcal.core.errors import InputError
from softcal.core.maps.exact import NAME, exact_map
from softcal.core.maps.interface import UnitMap
from softcal.core.maps.plan import TransportMap
from softcal.core.network.network import Network
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.unit.calibration import Calibration
from softcal.core.unit.estimate import Flags, check_fits, judge
from softcal.core.unit.method import Method
from softcal.core.use.adapter import QUEUES, AdaptConfig
from softcal.core.use.batches import NOT_EVIDENCE, START, Batches, MapUpdate
from softcal.core.use.intake import Intake
from softcal.core.use.kept import restored
from softcal.core.use.method import UseMethod
from softcal.core.use.observation import FOLLOWED
from softcal.core.use.sensitivity import calibrated_rmse
from softcal.core.windows import TAPS

FORMAT = "queues 1"
"""Of what `QueuedTransport.state` returns; another name whenever a state kept before could not be gone on from."""


@dataclass(frozen=True, eq=False)
class SourcePairs:
    """What queues are mapped onto.

    Args:
        windows: (n, TAPS) as they came from a sensor, in the unit of the output.
        placed: (n, TAPS) where they stand in the space that f reads; f of them are the labels.
    """

    windows: Array
    placed: Array


class QueuedTransport(Batches):
    """Estimates a stream as f∘γ and finds γ anew on every full queue; same interface as `adapter.Adapter`.

    It assumes that each queue was used under the source's distribution of loads: a change of use is taken for drift.
    Rows that are stuck, saturated, at a wrong rate or without a full window enter no queue. The interval and the
    predicted error stay those of the calibration.

    Args:
        network: the shared network f.
        calibration: of the unit, from the registry: f∘γ₀, which holds until the first swap, and its interval.
        recording: the unit's own output at calibration; what a drift is stated against.
        source: labelled recording of the source unit.
        config: mode `ot` or `ot-improved`; improved, the source becomes each queue with its best estimates.
        pool: solves plans while estimates go on; None solves each at its swap.

    Raises:
        InputError: the calibration belongs to another network, a recording has another physical unit, or the queue is
            smaller than a window.
        ValueError: the mode is one of `adapter.Adapter`.
    """

    def __init__(
        self,
        network: Network,
        calibration: Calibration,
        recording: OutputRecording,
        source: LabelledRecording,
        config: AdaptConfig,
        pool: Executor | None = None,
    ) -> None:
        for output in (recording, source.unlabelled):
            check_fits(network, calibration, output.output_unit)
        if config.mode not in QUEUES:
            raise ValueError(f"mode {config.mode!r} is none of {', '.join(QUEUES)}")
        if config.method.online.queue < TAPS:
            raise InputError(f"a queue of {config.method.online.queue} is smaller than a window; give {TAPS} or more")
        super().__init__(network, config.method)
        self._calibration, self._mode, self._pool = calibration, config.mode, pool
        self._plan = (calibration.method or Method()).map.plan
        self._calibrated, self._rate_Hz = recording.output, recording.sample_rate_Hz
        self._source = SourcePairs(source.windows, source.windows)
        self._map: UnitMap = calibration.unit_map
        self._filling, self._waiting = np.empty((0, TAPS)), np.empty((0, TAPS))
        self._fit: Future[TransportMap] | None = None
        self._silent_batches, self._is_silent = 0, True
        self._intake = self._fresh_intake()
        error = calibrated_rmse(calibration)
        self._begin(MapUpdate(0, None, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, error, START, "no queue is mapped yet", ""))

    def _fresh_intake(self) -> Intake:
        return Intake(self._rate_Hz, float(self._calibrated.mean()), self._method.intake)

    @property
    def unit_map(self) -> UnitMap:
        """The map γ in force."""
        return self._map

    @property
    def source(self) -> SourcePairs:
        """What the next queue is mapped onto."""
        return self._source

    def _estimate(self, t_s: Array, output: Array) -> tuple[Array, Array, Array, Flags]:
        first = self._row % self._method.intake.batch
        rows = slice(first, first + len(output))
        taken = self._intake.take(t_s, output, first)
        mapped = self._map.apply(taken.windows)
        value, lower, upper, flag = judge(self._network, self._calibration, mapped, taken.windows[:, -1], taken.run)
        # Rows without a full window went through the network with the others; their numbers mean nothing.
        value, lower, upper = (np.where(taken.is_full, column, np.nan)[rows] for column in (value, lower, upper))
        flag = np.where(taken.flag != "", taken.flag, flag)[rows]
        is_usable = taken.is_full[rows] & ~np.isin(flag, NOT_EVIDENCE)
        self._filling = np.concatenate([self._filling, taken.windows[rows][is_usable]])
        self._is_silent = self._is_silent and not is_usable.any()
        return value, lower, upper, flag

    def _close_batch(self) -> None:
        self._silent_batches = self._silent_batches + 1 if self._is_silent else 0
        self._is_silent = True
        queue = self._method.online.queue
        while len(self._filling) >= queue:
            if len(self._waiting):
                self._swap()
            self._waiting, self._filling = self._filling[:queue], self._filling[queue:]
            self._fit = None if self._pool is None else self._pool.submit(self._fitted, self._waiting, self._source)
        is_out = self._silent_batches >= self._method.intake.silent_batches
        alarm = "the sensor gives no usable samples; check sensor and cable" if is_out else ""
        if alarm != self._current.alarm:
            self._change(alarm=alarm)

    def _fitted(self, queue: Array, source: SourcePairs) -> TransportMap:
        return exact_map(queue, source.windows, source.placed, self._plan)

    def _swap(self) -> None:
        """Put the map of the queue that waits in force."""
        # A plan takes a fraction of the time in which a queue fills: live, it is there by now.
        self._use(self._fitted(self._waiting, self._source) if self._fit is None else self._fit.result())
        now, then = self._waiting[:, -1], self._calibrated
        gain = float(then.std() / max(now.std(), 1e-12))
        shift, log_gain = float((now.mean() - then.mean()) / then.std()), -float(np.log(gain))
        self._change(
            t_s=self._intake.last_s,
            gain=gain,
            offset=float(then.mean() - gain * now.mean()),
            shift=shift,
            log_gain=log_gain,
            verdict=FOLLOWED,
            reason="",
        )

    def _use(self, fitted: TransportMap) -> None:
        self._map = fitted
        if self._mode == "ot-improved":
            self._source = SourcePairs(fitted.stored, fitted.stored + fitted.displacement)

    def _change(self, **changed: Any) -> None:
        self._current = MapUpdate(**{**asdict(self._current), **changed, "row": self._row})
        self._updates.append(self._current)

    def reconnect(self, row: int = 0) -> None:
        """Go on after an interruption of unknown length: windows start anew; map, queue and source stay.

        Args:
            row: count rows from here at least.
        """
        self._row = max(self._row, row)
        # A batch never holds rows from before and after the interruption.
        self._row += -self._row % self._method.intake.batch
        self._intake, self._is_silent = self._fresh_intake(), True

    def state(self) -> dict[str, object]:
        """Return all that a restart needs besides what the constructor is given, as JSON values.

        A queue of 512 windows makes up to 0.6 MB.
        """
        arrays = {"filling": self._filling, "waiting": self._waiting}
        if isinstance(self._map, TransportMap) and self._map is not self._calibration.unit_map:
            arrays |= {"stored": self._map.stored, "displacement": self._map.displacement}
        return {
            "format": f"{FORMAT} {self._mode}",
            "method": self._method.to_json(),
            "row": self._row,
            "silent_batches": self._silent_batches,
            "is_silent": self._is_silent,
            "current": asdict(self._current),
            "intake": self._intake.state(),
            "arrays": {name: values.tolist() for name, values in arrays.items()},
        }

    def restore(self, state: Mapping[str, Any]) -> list[str]:
        """Go on from a `state()` taken earlier, of the same unit, calibration and mode.

        Returns:
            The numbers of the method that have changed since, as `name: earlier value, now value`.

        Raises:
            InputError: the state was taken by a version or mode that keeps other things in it; nothing was changed.
        """
        expected = f"{FORMAT} {self._mode}"
        if (found := state.get("format", 1)) != expected:
            raise InputError(f"its state has format {found}, this mode goes on from format {expected} alone")
        if wrong := set(self.state()) ^ set(state):
            raise InputError(f"its state does not fit this version: {min(wrong)} is missing or unknown")
        current, intake = restored(MapUpdate, state["current"]), self._fresh_intake()
        intake.restore(state["intake"])
        kept = {name: _rows(name, rows) for name, rows in state["arrays"].items()}
        self._current, self._intake = current, intake
        self._row, self._silent_batches = int(state["row"]), int(state["silent_batches"])
        self._is_silent = bool(state["is_silent"])
        self._filling, self._waiting = kept["filling"], kept["waiting"]
        if "stored" in kept:
            self._use(TransportMap(kept["stored"], kept["displacement"], NAME, self._plan.neighbours))
        self._fit = None
        self._updates.clear()
        return self._method.changes(UseMethod.of(state["method"]))


def _rows(name: str, kept: Any) -> Array:
    try:
        return np.array(kept, np.float64).reshape(-1, TAPS)
    except (TypeError, ValueError) as error:
        raise InputError(f"its state does not fit this version: {name} holds no windows") from error
