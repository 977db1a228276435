"""Estimates of a unit in long use: f∘γ₀∘A_t with an affine correction A_t that follows the drift of the sensor."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from itertools import groupby
from typing import Any

import numpy as np

from softcal.core.maps.affine_map import AffineMap
from softcal.core.network.network import Network
from softcal.core.recording import Array, Mask, OutputRecording
from softcal.core.unit.calibration import Calibration
from softcal.core.unit.estimate import Flags
from softcal.core.use.activity import CalibratedUse
from softcal.core.use.batches import START, UNSETTLED, Batches, MapUpdate
from softcal.core.use.cycles import CycleCutter
from softcal.core.use.doubt import Doubt, due
from softcal.core.use.intake import Taken
from softcal.core.use.method import UseMethod
from softcal.core.use.observation import FOLLOWED, HELD, NOT_WATCHED, UNWATCHED, Observation
from softcal.core.use.sensitivity import learn_sensitivity
from softcal.core.use.state_json import restored
from softcal.core.use.tracker import DriftTracker

FILTERS = ("none", "basic", "improved")
QUEUES = ("ot", "ot-improved")
MODES = (*FILTERS, *QUEUES)
STATE_FORMAT = 9
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
        mode: `none` leaves the map as it is; `basic` compares the use with the calibration recording alone; `improved`
            also learns other uses from the best estimates so far (Kim et al. 2020, Fig. 5). `ot` and `ot-improved` are
            those of `queued.QueuedTransport`.
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
        super().__init__(network, calibration, recording, config.method, STATE_FORMAT)
        self._config = config
        self._use, self._error_per_scale = learn_sensitivity(network, calibration, recording, config.method)
        self._cutter, self._tracker = self._parts()
        self._evidence: list[tuple[float, float] | None] = []
        self._of_use = Overdue()
        reason = "" if self._use.lesson.activity else self._use.lesson.reason
        self._last = replace(self._tracker.start(), verdict=START, reason=reason)
        drift = (self._last.shift, self._last.log_gain, self._last.shift_sd, self._last.log_gain_sd)
        self._begin(MapUpdate(0, None, 1.0, 0.0, *drift, self._predicted_rmse(0.0), START, reason, ""))

    def _parts(self) -> tuple[CycleCutter, DriftTracker]:
        use, method = self._use, self._method
        return (
            CycleCutter(use.low, use.high, use.usual, use.longest, method.cycle),
            DriftTracker(use, self._config.mode == "improved", method),
        )

    @property
    def calibrated_use(self) -> CalibratedUse:
        """What the calibration recording taught about the unit's use."""
        return self._use

    def _mapped(self, windows: Array) -> Array:
        correction = AffineMap(self._current.gain, self._current.offset)
        return self._calibration.unit_map.apply(correction.apply(windows))

    def _trouble(self) -> str:
        is_doubtful = self._current.predicted_rmse > self._method.doubt.alarm_ratio * self._calibrated_rmse
        return super()._trouble() or (UNSETTLED if is_doubtful or self._tracker.is_unsettled else "")

    def _with_state(self, flag: Flags) -> Flags:
        # Nothing is watched where the map is left as it is.
        return flag if self._config.mode == "none" else super()._with_state(flag)

    def _gather(self, t_s: Array, output: Array, taken: Taken, rows: slice, is_evidence: Mask) -> None:
        """Keep what this piece says about the use; None marks a break in it."""
        is_valid, is_restart = taken.is_valid[rows], taken.is_restart[rows]
        is_usable = is_valid & is_evidence
        for k in range(len(output)):
            # A gap or a fault inside a cycle would give it a wrong shape and duration: it is dropped whole.
            if is_restart[k] or (is_valid[k] and not is_usable[k]):
                self._evidence.append(None)
            if is_usable[k]:
                self._evidence.append((float(t_s[k]), float(output[k])))

    def _close_batch(self) -> None:
        observations = self._observe()
        self._evidence = []
        last = observations[-1] if observations else None
        if self._intake.last_s is not None:
            self._tracker.expire(self._intake.last_s)
        # After the trial may have ended: its shift is part of the doubt.
        now_s = None if self._config.mode == "none" else self._intake.last_s
        doubt = Doubt(0.0, 0.0, {}) if now_s is None else self._tracker.doubt_at(now_s)
        self._doubt = self._error_per_scale * doubt.widening
        self._put(self._proposed(last, doubt))

    def _observe(self) -> list[Observation]:
        observations: list[Observation] = []
        if self._config.mode == "none":
            return observations
        for is_break, pairs in groupby(self._evidence, key=lambda pair: pair is None):
            if is_break:
                self._cutter.restart()
                continue
            stretch = np.array(list(pairs))
            for cycle in self._cutter.advance(stretch[:, 0], stretch[:, 1]):
                observations.append(self._tracker.observe(cycle))
            self._cutter.join(self._tracker.least_s * self._sample_rate_Hz)
        return observations

    def _proposed(self, last: Observation | None, doubt: Doubt) -> MapUpdate:
        """Return what holds from the next row on."""
        gain, offset = self._tracker.correction()
        ends = np.array([self._use.low, self._use.high])
        moved = (gain - self._current.gain) * ends + offset - self._current.offset
        # Below this size a new correction is not worth a row of the record.
        if np.max(np.abs(moved)) < self._method.doubt.swap * self._use.scale:
            gain, offset = self._current.gain, self._current.offset
        # An open jump makes the predicted error large for two cycles: that alone decides nothing.
        if not self._tracker.is_unsettled:
            self._of_use = self._overdue(self._of_use, doubt.of_use)
        seen = self._last = last or self._last
        verdict, reason = seen.verdict, seen.reason
        if self._of_use.why and verdict == FOLLOWED:
            verdict, reason = HELD, self._of_use.why
        # Not even a cycle was seen: that must not read as if nothing had drifted.
        if verdict == START and self._tracker.is_learning:
            verdict, reason = UNWATCHED, NOT_WATCHED
        return MapUpdate(
            row=self._row,
            t_s=self._current.t_s if last is None else last.t_s,
            gain=gain,
            offset=offset,
            shift=seen.shift,
            log_gain=seen.log_gain,
            shift_sd=seen.shift_sd,
            log_gain_sd=seen.log_gain_sd,
            predicted_rmse=self._predicted_rmse(doubt.growth),
            verdict=verdict,
            reason=reason,
            alarm=self._alarm() or self._tracker.alarm,
        )

    def _predicted_rmse(self, doubt: float) -> float:
        return float(np.hypot(self._calibrated_rmse, self._error_per_scale * doubt))

    def _overdue(self, before: Overdue, squares: Mapping[str, float]) -> Overdue:
        """Return whether what is in doubt has been too much for long, and why."""
        config = self._method.doubt
        ratio = self._predicted_rmse(sum(squares.values()) ** 0.5) / self._calibrated_rmse
        batches = before.batches + 1 if ratio > config.alarm_ratio else 0
        is_due = batches * self._method.intake.batch > config.alarm_cycles * self._use.usual
        # Two thresholds: what hovers about one would call and take back the alarm again and again.
        if not is_due and not (before.why and ratio > config.clear_ratio):
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
