"""Estimates of a unit in long use: f∘γ₀∘A_t with an affine correction A_t that follows the drift of the sensor."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from itertools import groupby
from typing import Any

import numpy as np

from softcal.core.maps.affine_map import AffineMap
from softcal.core.metrics import rms
from softcal.core.network.network import Network
from softcal.core.operation.activity import CalibratedOperation, RestCurve, learn_operation
from softcal.core.operation.cycles import CycleSegmenter
from softcal.core.operation.method import DriftTracking
from softcal.core.operation.observation import FOLLOWED, LEARNING_OPERATION, ON_HOLD, UNWATCHED, Observation
from softcal.core.operation.stored_state import from_state
from softcal.core.operation.stream_estimator import START, MapUpdate, StreamEstimator
from softcal.core.operation.stream_windows import BatchWindows
from softcal.core.operation.tracker import DriftTracker
from softcal.core.operation.uncertainty import DriftUncertainty, with_remedy
from softcal.core.recording import Array, Mask, OutputRecording
from softcal.core.unit.state import UnitState
from softcal.core.windows import resting

FILTERS = ("none", "improved")
QUEUES = ("ot", "ot-improved")
MODES = (*FILTERS, *QUEUES)
STATE_FORMAT = 2
"""Of what `Adapter.state` returns; raised whenever a state kept before could not be gone on from."""


@dataclass(frozen=True)
class HoldReason:
    """What has been in doubt for too long."""

    batches: int = 0
    reason: str = ""


@dataclass(frozen=True)
class AdaptConfig:
    """How a unit in use is followed.

    Args:
        mode: `none` leaves the map as it is; `improved` compares the use with the calibration recording and with uses
            learnt from the best estimates so far (Kim et al. 2020, Fig. 5). `ot` and `ot-improved` are those of
            `queued_transport.QueuedTransport`.
        method: every number that decides.
    """

    mode: str = "improved"
    method: DriftTracking = field(default_factory=DriftTracking)

    def __post_init__(self) -> None:
        if self.mode not in MODES:
            raise ValueError(f"mode {self.mode!r} is none of {', '.join(MODES)}")

    @property
    def name(self) -> str:
        """The mode, and the length of its queue where it has one; in the default name of a stream."""
        return f"{self.mode} {self.method.online.queue}" if self.mode in QUEUES else self.mode


class Adapter(StreamEstimator):
    """Estimates a stream and keeps the unit's map on its drift.

    Args:
        calibration: of the unit, from the registry: f∘γ₀ and its interval.
        recording: the unit's own output at calibration; what the use is compared with.

    Raises:
        InputError: the calibration belongs to another network, or the recording has another physical unit.
        ValueError: the mode is one of `queued_transport.QueuedTransport`.
    """

    def __init__(
        self,
        network: Network,
        calibration: UnitState,
        recording: OutputRecording,
        config: AdaptConfig = AdaptConfig(),  # noqa: B008 - frozen
    ) -> None:
        if config.mode not in FILTERS:
            raise ValueError(f"mode {config.mode!r} is none of {', '.join(FILTERS)}")
        super().__init__(network, calibration, recording, config.method, STATE_FORMAT, config.mode != "none")
        self._config = config
        self._operation, self._error_per_scale = learn_sensitivity(network, calibration, recording, config.method)
        self._segmenter, self._tracker = self._parts()
        self._evidence: list[tuple[float, float] | None] = []
        self._hold_reason = HoldReason()
        reason = "" if self._operation.learning.activity else self._operation.learning.reason
        self._last = replace(self._tracker.start(), verdict=START, reason=reason)
        self._begin(MapUpdate(0, None, 1.0, 0.0, *_drift(self._last), self._predicted_rmse(0.0), START, reason, ""))

    def _parts(self) -> tuple[CycleSegmenter, DriftTracker]:
        operation, method = self._operation, self._method
        return (
            CycleSegmenter(operation.low, operation.high, operation.cycle_samples, operation.max_samples, method.cycle),
            DriftTracker(operation, method),
        )

    def _mapped(self, windows: Array) -> Array:
        correction = AffineMap(self._current.gain, self._current.offset)
        return self._calibration.unit_map.apply(correction.apply(windows))

    @property
    def _is_doubtful(self) -> bool:
        max_rmse = self._method.uncertainty.alarm_ratio * self._calibrated_rmse
        return self._current.predicted_rmse > max_rmse or self._tracker.is_unsettled

    def _gather(self, t_s: Array, output: Array, windows: BatchWindows, rows: slice, is_evidence: Mask) -> None:
        """Keep what this piece says about the use; None marks a break in it."""
        if not self._is_watched:
            return
        is_valid, is_restart = windows.is_valid[rows], windows.is_restart[rows]
        is_usable = is_valid & is_evidence
        for k in range(len(output)):
            # A gap or a fault inside a cycle would give it a wrong shape and duration: it is dropped whole.
            if is_restart[k] or (is_valid[k] and not is_usable[k]):
                self._evidence.append(None)
            if is_usable[k]:
                self._evidence.append((float(t_s[k]), float(output[k])))

    def _close_batch(self) -> None:
        last = None
        for is_break, pairs in groupby(self._evidence, key=lambda pair: pair is None):
            if is_break:
                self._segmenter.restart()
                continue
            stretch = np.array(list(pairs))
            for cycle in self._segmenter.advance(stretch[:, 0], stretch[:, 1]):
                last = self._tracker.observe(cycle)
            self._segmenter.join(self._tracker.min_cycle_s * self._sample_rate_Hz)
        self._evidence = []
        uncertainty, now_s = DriftUncertainty(0.0, 0.0, {}), self._window_buffer.last_s
        if self._is_watched and now_s is not None:
            self._tracker.expire(now_s)
            # After the trial may have ended: its shift is part of the doubt.
            uncertainty = self._tracker.uncertainty_at(now_s)
        self._uncertainty = self._error_per_scale * uncertainty.interval_inflation
        # An open jump makes the predicted error large for two cycles: that alone decides nothing.
        if not self._tracker.is_unsettled:
            self._hold_reason = self._update_hold_reason(uncertainty.ambiguous)
        gain, offset = self._tracker.correction()
        extremes = np.array([self._operation.low, self._operation.high])
        change = (gain - self._current.gain) * extremes + offset - self._current.offset
        # Below this size a new correction is not worth a row of the record.
        if np.max(np.abs(change)) < self._method.uncertainty.swap * self._operation.scale:
            gain, offset = self._current.gain, self._current.offset
        observation = self._last = last or self._last
        verdict, reason = observation.verdict, observation.reason
        if self._hold_reason.reason and verdict == FOLLOWED:
            verdict, reason = ON_HOLD, self._hold_reason.reason
        # Not even a cycle was seen: that must not read as if nothing had drifted.
        if verdict == START and self._is_watched and self._tracker.is_learning:
            verdict, reason = UNWATCHED, LEARNING_OPERATION
        now_s = self._current.t_s if last is None else last.t_s
        predicted, alarm = self._predicted_rmse(uncertainty.error_inflation), self._alarm() or self._tracker.alarm
        drift = _drift(observation)
        self._set_current(MapUpdate(self._row, now_s, gain, offset, *drift, predicted, verdict, reason, alarm))

    def _predicted_rmse(self, uncertainty: float) -> float:
        return float(np.hypot(self._calibrated_rmse, self._error_per_scale * uncertainty))

    def _update_hold_reason(self, squares: Mapping[str, float]) -> HoldReason:
        """Return whether what is in doubt has been too much for long, and why."""
        config, before = self._method.uncertainty, self._hold_reason
        ratio = self._predicted_rmse(sum(squares.values()) ** 0.5) / self._calibrated_rmse
        batches = before.batches + 1 if ratio > config.alarm_ratio else 0
        is_due = batches * self._method.stream.batch > self._method.activity.min_cycles * self._operation.cycle_samples
        # Two thresholds: what hovers about one would call and take back the alarm again and again.
        if not is_due and not (before.reason and ratio > (1 + config.alarm_ratio) / 2):
            return HoldReason(batches)
        return HoldReason(batches, before.reason or with_remedy(max(squares, key=squares.__getitem__)))

    def reconnect(self, row: int = 0) -> None:
        super().reconnect(row)
        self._evidence = []
        self._segmenter.restart()
        self._tracker.reconnect()

    def _subclass_state(self) -> dict[str, object]:
        return {
            "hold_reason": asdict(self._hold_reason),
            "last": asdict(self._last),
            "evidence": [None if pair is None else list(pair) for pair in self._evidence],
            "cutter": self._segmenter.state(),
            "tracker": self._tracker.state(),
        }

    def _restore_subclass(self, state: Mapping[str, Any]) -> None:
        segmenter, tracker = self._parts()
        segmenter.restore(state["cutter"])
        tracker.restore(state["tracker"])
        hold_reason = from_state(HoldReason, state["hold_reason"])
        self._last = from_state(Observation, state["last"])
        self._segmenter, self._tracker, self._hold_reason = segmenter, tracker, hold_reason
        self._evidence = [None if pair is None else (pair[0], pair[1]) for pair in state["evidence"]]


def _drift(observation: Observation) -> tuple[float, float, float, float]:
    return observation.shift, observation.log_gain, observation.shift_sd, observation.log_gain_sd


def learn_sensitivity(
    network: Network, calibration: UnitState, recording: OutputRecording, method: DriftTracking
) -> tuple[CalibratedOperation, float]:
    """Return the calibrated use, and by how much an estimate moves (RMS) when the output moves by one scale of it."""
    windows = recording.windows

    def estimates(outputs: Array) -> Array:
        return network.evaluate(calibration.unit_map.apply(outputs))

    estimated = estimates(windows)
    is_rising = np.cov(windows[:, -1], estimated)[0, 1] >= 0
    low, high = np.quantile(recording.output, method.cycle.swing)
    # Constant outputs up to a swing beyond the recording.
    levels = np.linspace(2 * low - high, 2 * high - low, 300)
    loads = estimates(resting(levels))
    zero_output = None
    if len(crossings := np.flatnonzero(loads[:-1] * loads[1:] <= 0)):
        # f may cross zero more than once outside what it was trained on: the crossing next to the unloaded end counts.
        unloaded = low if loads[-1] > loads[0] else high
        zero_output = float(levels[crossings[np.argmin(np.abs(levels[crossings] - unloaded))]])
    # A use that turns without a rest comes to zero load only in motion, which f knows and a constant output does not
    # show.
    size = np.abs(estimated)
    is_smallest = size <= np.quantile(size, 1 - method.cycle.swing[1])
    if np.median(size[is_smallest]) <= method.attribution.preload * np.std(estimated):
        zero_output = float(np.median(windows[is_smallest, -1]))
        loads = loads - np.interp(zero_output, levels, loads)
    curve = None if zero_output is None else RestCurve(levels, loads)
    operation = learn_operation(recording, bool(is_rising), zero_output, method, curve)
    # A difference over a finite step, not the derivative: f is piecewise linear with kinks close together.
    step = method.attribution.step
    rise = (estimates(windows + step * operation.scale) - estimates(windows - step * operation.scale)) / (2 * step)
    return operation, rms(rise)
