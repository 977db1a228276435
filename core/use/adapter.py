"""Estimates of a unit in long use: f∘γ₀∘A_t with an affine correction A_t that follows the drift of the sensor."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from itertools import groupby
from typing import Any

import numpy as np

from softcal.core.maps.affine_map import AffineMap
from softcal.core.metrics import rms
from softcal.core.network.network import Network
from softcal.core.recording import Array, Mask, OutputRecording
from softcal.core.unit.calibration import Calibration
from softcal.core.use.activity import CalibratedUse, RestCurve, learn_use
from softcal.core.use.batches import START, Batches, MapUpdate
from softcal.core.use.cycles import CycleCutter
from softcal.core.use.doubt import Doubt, due
from softcal.core.use.intake import Taken
from softcal.core.use.method import UseMethod
from softcal.core.use.observation import FOLLOWED, HELD, NOT_WATCHED, UNWATCHED, Observation
from softcal.core.use.state_json import restored
from softcal.core.use.tracker import DriftTracker
from softcal.core.windows import resting

FILTERS = ("none", "improved")
QUEUES = ("ot", "ot-improved")
MODES = (*FILTERS, *QUEUES)
STATE_FORMAT = 1
"""Of what `Adapter.state` returns; raised whenever a state kept before could not be gone on from."""


@dataclass(frozen=True)
class Overdue:
    """What has been in doubt for too long."""

    batches: int = 0
    why: str = ""


@dataclass(frozen=True)
class AdaptConfig:
    """How a unit in use is followed.

    Args:
        mode: `none` leaves the map as it is; `improved` compares the use with the calibration recording and with uses
            learnt from the best estimates so far (Kim et al. 2020, Fig. 5). `ot` and `ot-improved` are those of
            `queued.QueuedTransport`.
        method: every number that decides.
    """

    mode: str = "improved"
    method: UseMethod = field(default_factory=UseMethod)

    def __post_init__(self) -> None:
        if self.mode not in MODES:
            raise ValueError(f"mode {self.mode!r} is none of {', '.join(MODES)}")

    @property
    def name(self) -> str:
        """The mode, and the length of its queue where it has one; in the default name of a stream."""
        return f"{self.mode} {self.method.online.queue}" if self.mode in QUEUES else self.mode


class Adapter(Batches):
    """Estimates a stream and keeps the unit's map on its drift.

    Args:
        calibration: of the unit, from the registry: f∘γ₀ and its interval.
        recording: the unit's own output at calibration; what the use is compared with.

    Raises:
        InputError: the calibration belongs to another network, or the recording has another physical unit.
        ValueError: the mode is one of `queued.QueuedTransport`.
    """

    def __init__(
        self,
        network: Network,
        calibration: Calibration,
        recording: OutputRecording,
        config: AdaptConfig = AdaptConfig(),  # noqa: B008 - frozen
    ) -> None:
        if config.mode not in FILTERS:
            raise ValueError(f"mode {config.mode!r} is none of {', '.join(FILTERS)}")
        super().__init__(network, calibration, recording, config.method, STATE_FORMAT, config.mode != "none")
        self._config = config
        self._use, self._error_per_scale = learn_sensitivity(network, calibration, recording, config.method)
        self._cutter, self._tracker = self._parts()
        self._evidence: list[tuple[float, float] | None] = []
        self._of_use = Overdue()
        reason = "" if self._use.lesson.activity else self._use.lesson.reason
        self._last = replace(self._tracker.start(), verdict=START, reason=reason)
        self._begin(MapUpdate(0, None, 1.0, 0.0, *_drift(self._last), self._predicted_rmse(0.0), START, reason, ""))

    def _parts(self) -> tuple[CycleCutter, DriftTracker]:
        use, method = self._use, self._method
        return (
            CycleCutter(use.low, use.high, use.usual, use.longest, method.cycle),
            DriftTracker(use, method),
        )

    @property
    def calibrated_use(self) -> CalibratedUse:
        """What the calibration recording taught about the unit's use."""
        return self._use

    def _mapped(self, windows: Array) -> Array:
        correction = AffineMap(self._current.gain, self._current.offset)
        return self._calibration.unit_map.apply(correction.apply(windows))

    @property
    def _is_doubtful(self) -> bool:
        most = self._method.doubt.alarm_ratio * self._calibrated_rmse
        return self._current.predicted_rmse > most or self._tracker.is_unsettled

    def _gather(self, t_s: Array, output: Array, taken: Taken, rows: slice, is_evidence: Mask) -> None:
        """Keep what this piece says about the use; None marks a break in it."""
        if not self._is_watched:
            return
        is_valid, is_restart = taken.is_valid[rows], taken.is_restart[rows]
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
                self._cutter.restart()
                continue
            stretch = np.array(list(pairs))
            for cycle in self._cutter.advance(stretch[:, 0], stretch[:, 1]):
                last = self._tracker.observe(cycle)
            self._cutter.join(self._tracker.least_s * self._sample_rate_Hz)
        self._evidence = []
        doubt, now_s = Doubt(0.0, 0.0, {}), self._intake.last_s
        if self._is_watched and now_s is not None:
            self._tracker.expire(now_s)
            # After the trial may have ended: its shift is part of the doubt.
            doubt = self._tracker.doubt_at(now_s)
        self._doubt = self._error_per_scale * doubt.widening
        # An open jump makes the predicted error large for two cycles: that alone decides nothing.
        if not self._tracker.is_unsettled:
            self._of_use = self._overdue(doubt.of_use)
        gain, offset = self._tracker.correction()
        ends = np.array([self._use.low, self._use.high])
        moved = (gain - self._current.gain) * ends + offset - self._current.offset
        # Below this size a new correction is not worth a row of the record.
        if np.max(np.abs(moved)) < self._method.doubt.swap * self._use.scale:
            gain, offset = self._current.gain, self._current.offset
        seen = self._last = last or self._last
        verdict, reason = seen.verdict, seen.reason
        if self._of_use.why and verdict == FOLLOWED:
            verdict, reason = HELD, self._of_use.why
        # Not even a cycle was seen: that must not read as if nothing had drifted.
        if verdict == START and self._is_watched and self._tracker.is_learning:
            verdict, reason = UNWATCHED, NOT_WATCHED
        now_s = self._current.t_s if last is None else last.t_s
        predicted, alarm = self._predicted_rmse(doubt.growth), self._alarm() or self._tracker.alarm
        self._put(MapUpdate(self._row, now_s, gain, offset, *_drift(seen), predicted, verdict, reason, alarm))

    def _predicted_rmse(self, doubt: float) -> float:
        return float(np.hypot(self._calibrated_rmse, self._error_per_scale * doubt))

    def _overdue(self, squares: Mapping[str, float]) -> Overdue:
        """Return whether what is in doubt has been too much for long, and why."""
        config, before = self._method.doubt, self._of_use
        ratio = self._predicted_rmse(sum(squares.values()) ** 0.5) / self._calibrated_rmse
        batches = before.batches + 1 if ratio > config.alarm_ratio else 0
        is_due = batches * self._method.intake.batch > self._method.activity.min_cycles * self._use.usual
        # Two thresholds: what hovers about one would call and take back the alarm again and again.
        if not is_due and not (before.why and ratio > (1 + config.alarm_ratio) / 2):
            return Overdue(batches)
        return Overdue(batches, before.why or due(max(squares, key=squares.__getitem__)))

    def reconnect(self, row: int = 0) -> None:
        super().reconnect(row)
        self._evidence = []
        self._cutter.restart()
        self._tracker.reconnect()

    def _own_state(self) -> dict[str, object]:
        return {
            "of_use": asdict(self._of_use),
            "last": asdict(self._last),
            "evidence": [None if pair is None else list(pair) for pair in self._evidence],
            "cutter": self._cutter.state(),
            "tracker": self._tracker.state(),
        }

    def _restore_own(self, state: Mapping[str, Any]) -> None:
        cutter, tracker = self._parts()
        cutter.restore(state["cutter"])
        tracker.restore(state["tracker"])
        of_use = restored(Overdue, state["of_use"])
        self._last = restored(Observation, state["last"])
        self._cutter, self._tracker, self._of_use = cutter, tracker, of_use
        self._evidence = [None if pair is None else (pair[0], pair[1]) for pair in state["evidence"]]


def _drift(seen: Observation) -> tuple[float, float, float, float]:
    return seen.shift, seen.log_gain, seen.shift_sd, seen.log_gain_sd


def learn_sensitivity(
    network: Network, calibration: Calibration, recording: OutputRecording, method: UseMethod
) -> tuple[CalibratedUse, float]:
    """Return the calibrated use, and by how much an estimate moves (RMS) when the output moves by one scale of it."""
    windows = recording.windows

    def estimates(moved: Array) -> Array:
        return network.evaluate(calibration.unit_map.apply(moved))

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
    least = size <= np.quantile(size, 1 - method.cycle.swing[1])
    if np.median(size[least]) <= method.trust.preload * np.std(estimated):
        zero_output = float(np.median(windows[least, -1]))
        loads = loads - np.interp(zero_output, levels, loads)
    curve = RestCurve(levels, loads)
    use = learn_use(recording, bool(is_rising), zero_output, method, curve if zero_output is not None else None)
    # A difference over a finite step, not the derivative: f is piecewise linear with kinks close together.
    step = method.trust.step
    rise = (estimates(windows + step * use.scale) - estimates(windows - step * use.scale)) / (2 * step)
    return use, rms(rise)
