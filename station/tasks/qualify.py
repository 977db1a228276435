"""Qualification of a station on one unit: cell response, lost motion, frame compliance, repeatability, noise.

A stiff spring shows the rig alone; any other unit adds its own effects, so that every figure is an upper bound.
"""

import math
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from softcal.core.errors import BadReply, CommandRefused
from softcal.core.messages.reason import Reason, root_of
from softcal.core.profiles import Profile, moves
from softcal.core.recording import Array
from softcal.station.bench.bench import Bench
from softcal.station.devices.config import UNKNOWN_S
from softcal.station.record.method import METHOD, ProofMethod
from softcal.station.record.recording import Raw, RunMetadata, device_times_s, track_of
from softcal.station.record.response import fit_response
from softcal.station.record.spool import Spool, read_spool
from softcal.station.tasks.acquisition import OnProgress, record

SLOW_MM_S, FAST_MM_S = 0.5, 4.0
SLOW, FAST, HOLD_S, REST_S = 2, 5, 1.0, 0.8
"""So many slow presses before and after so many fast ones, all equally deep; holds and rests of the fast ones."""

EDGE_S, END_S = 0.3, 2.0
"""The end of a hold is read over so long; the rest at the end of the profile is noise."""

MAX_DELAY_S, MAX_BACKLASH_MM, MAX_LOST_MM, MAX_COMPLIANCE_MM_N = 0.5, 0.05, 0.03, 0.05
"""The largest figures with which a station passes: delay of the cell where the station file states none; way at a turn
of the stage; way lost from the first press to the last; of the frame, where the stiffness of the spring is stated."""

MAX_REPEATABILITY = MAX_NOISE = 0.01
"""Of equal presses, and of the resting cell: standard deviation, share of the largest force."""

MIDDLE, STEEP = 0.5, (0.5, 0.9)
"""Paths are compared at this share of the largest force, slopes between these."""


@dataclass(frozen=True)
class Figure:
    """One figure of a qualification with its limit.

    Args:
        value, limit: in `unit`; NaN if the run does not tell it. A limit of infinity is none, and holds either way.
    """

    name: str
    value: float
    unit: str
    limit: float = math.inf

    @property
    def is_good(self) -> bool:
        return math.isfinite(self.value) and abs(self.value) <= self.limit


@dataclass(frozen=True)
class Qualification:
    """The figures of a station.

    Args:
        figures: each with its limit.
        refusal: why a recording of this run would have been refused; None where it would not.
        seconds: of station time.
    """

    figures: tuple[Figure, ...]
    refusal: Reason | None
    seconds: float

    @property
    def is_passed(self) -> bool:
        return self.refusal is None and all(figure.is_good for figure in self.figures)


def qualification_profile(depth_mm: float, fastest_mm_s: float) -> Profile:
    """Return equal presses: slow ones, fast ones with holds, slow ones again, a rest."""
    speeds_mm_s = [SLOW_MM_S] * SLOW + [min(FAST_MM_S, fastest_mm_s)] * FAST + [SLOW_MM_S] * SLOW
    targets_mm, speeds, holds_s = [0.0], [1.0], [END_S]
    for speed_mm_s in speeds_mm_s:
        hold_s = HOLD_S if speed_mm_s > SLOW_MM_S else 0.0
        targets_mm, speeds = [*targets_mm, depth_mm, 0.0], [*speeds, speed_mm_s, speed_mm_s]
        holds_s = [*holds_s, hold_s, REST_S]
    holds_s[-1] = END_S
    return moves("qualification", targets_mm, speeds, holds_s)


def qualify(
    bench: Bench,
    depth_mm: float,
    stiffness_N_mm: float | None = None,
    on_progress: OnProgress | None = None,
    method: ProofMethod = METHOD,
) -> Qualification:
    """Press a unit and return the figures of the station. All monitors of a run are active.

    Args:
        stiffness_N_mm: of the spring, if stated; the frame's compliance is then computed from it.

    Raises:
        CommandRefused: no load cell.
        DeviceError: the run was stopped before its end.
    """
    if bench.force is None or bench.config.force is None:
        raise CommandRefused(Reason("rig.needs_cell"))
    # What the file states of the cell's delay is to be measured, so the run does not rely on it.
    config = replace(bench.config, force=replace(bench.config.force, latency_s=UNKNOWN_S))
    profile, refusal = qualification_profile(depth_mm, config.safety.speed_mm_s), None
    began_s = bench.clock.now_s()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "qualification.spool"
        try:
            with Spool(path, {"serial": "qualification", "profile": profile.name}) as spool:
                record(
                    replace(bench, config=config), "qualification", profile, False, on_progress, spool, method=method
                )
        except BadReply as error:
            refusal = root_of(error.reason)
            if not read_spool(path).metadata:
                raise
        run = read_spool(path)
    metadata = RunMetadata(**run.metadata)
    raw = Raw(run.output, run.force, run.polls)
    figures = _figures(raw, metadata, bench.config.force.latency_s, stiffness_N_mm, method)
    return Qualification(figures, refusal, bench.clock.now_s() - began_s)


def _figures(
    raw: Raw,
    metadata: RunMetadata,
    latency_s: float,
    stiffness_N_mm: float | None,
    method: ProofMethod,
) -> tuple[Figure, ...]:
    track, host_s = track_of(raw, metadata), device_times_s(raw.force)
    force_N = np.array([sample.values[0] for sample in raw.force]) - metadata.zero_N
    inside = (host_s >= metadata.span_s[0]) & (host_s <= metadata.span_s[1])
    host_s, force_N, backlash_mm = host_s[inside], force_N[inside], 0.0
    for _ in range(2):  # Backlash makes a prompt cell seem late, and a late cell makes backlash.
        tip_mm_at = behind_backlash(host_s, track.at(host_s), backlash_mm)
        response = fit_response(host_s, force_N, tip_mm_at, metadata.contact_mm, method)
        lag_s = response.lag_s if response.is_identifiable else 0.0
        presses = _Presses(host_s - lag_s, track.at(host_s - lag_s) - metadata.zero_mm, force_N)
        backlash_mm = float(np.nan_to_num(presses.backlash_mm))
    largest_N = presses.largest_N
    declared_s = latency_s if latency_s != UNKNOWN_S else 0.0
    off_s = method.lag.late_s + method.lag.period_share * presses.period_s
    off_s = MAX_DELAY_S if latency_s == UNKNOWN_S else off_s
    first, last = presses.slow[SLOW - 1], presses.slow[-1]
    slope = float(np.median([press.slope_N_mm(*STEEP) for press in presses.slow]))
    has_stiffness = stiffness_N_mm is not None
    compliance = 1.0 / slope - (1.0 / stiffness_N_mm if stiffness_N_mm is not None else 0.0)
    output = np.array([sample.values[0] for sample in raw.output if sample.host_s > metadata.span_s[1] - END_S])
    return (
        Figure("lag of the load cell beyond what is stated", abs(response.lag_s - declared_s), "s", off_s),
        Figure("pure delay of the load cell", float(np.maximum(0.0, response.delay_s)), "s"),
        Figure("time constant of the load cell", response.time_constant_s, "s"),
        Figure("bandwidth of the load cell", _bandwidth_Hz(response.time_constant_s, presses.period_s), "Hz"),
        Figure(
            "error of labels by the low pass (RMS)", response.error_N(lag_s), "N", method.response.share * largest_N
        ),
        Figure("backlash at a turn", presses.backlash_mm, "mm", MAX_BACKLASH_MM),
        Figure(
            "lost motion from first to last press", abs(last.at_mm(MIDDLE) - first.at_mm(MIDDLE)), "mm", MAX_LOST_MM
        ),
        Figure(
            "compliance of the frame" if has_stiffness else "compliance of frame and unit, in series",
            compliance,
            "mm/N",
            MAX_COMPLIANCE_MM_N if has_stiffness else math.inf,
        ),
        Figure(
            f"repeatability of {FAST} equal presses (s)",
            float(np.std(presses.hold_N, ddof=1)),
            "N",
            MAX_REPEATABILITY * largest_N,
        ),
        Figure("noise of the load cell (s)", _noise(presses.resting_N), "N", MAX_NOISE * largest_N),
        Figure("noise of the output (s)", _noise(output), metadata.output_unit),
        Figure("zero return of the load cell", abs(metadata.zero_return_N), "N"),
        Figure("largest force", largest_N, "N"),
    )


def behind_backlash(t_s: Array, stage_mm: Array, backlash_mm: float) -> Callable[[Array], Array]:
    """Return the position of the tip: it follows the stage, (n,), upwards only after the backlash."""
    tip_mm = np.array(stage_mm)
    for k in range(1, len(tip_mm)):
        tip_mm[k] = max(stage_mm[k], min(tip_mm[k - 1], stage_mm[k] + backlash_mm))
    return lambda at_s: np.interp(at_s, t_s, tip_mm)


def _bandwidth_Hz(constant_s: float, period_s: float) -> float:
    """Return where a low pass has taken off 3 dB, or half the rate of the readings."""
    nyquist_Hz = 0.5 / period_s
    return nyquist_Hz if not constant_s else min(nyquist_Hz, 1.0 / (2.0 * math.pi * constant_s))


def _noise(values: Array) -> float:
    """Return the standard deviation from sample to sample, drift left out."""
    return float(np.std(np.diff(values)) / math.sqrt(2.0)) if len(values) > 2 else float("nan")


class _Presses:
    """The presses of the profile, one after the other: times, depth, force, (n,) each."""

    def __init__(self, t_s: Array, stage_mm: Array, force_N: Array) -> None:
        self.period_s = float(np.median(np.diff(t_s)))
        is_deep = np.concatenate([[False], stage_mm > 0.05 * np.max(stage_mm), [False]])
        edges = np.flatnonzero(np.diff(is_deep.astype(int))).reshape(-1, 2)
        self.largest_N = float(np.quantile(force_N, 0.99))
        every = [_Press(t_s[a:b], stage_mm[a:b], force_N[a:b], self.largest_N) for a, b in edges]
        self.slow = [press for k, press in enumerate(every) if not SLOW <= k < SLOW + FAST]
        self.hold_N = [press.hold_N for press in every[SLOW : SLOW + FAST]]
        self.resting_N = force_N[t_s > t_s[-1] - 0.8 * END_S]

    @property
    def backlash_mm(self) -> float:
        """Return the backlash in mm: the difference of stage depth between loading and unloading, at equal force."""
        ways_mm = [press.at_mm(MIDDLE) - press.at_mm(MIDDLE, False) for press in self.slow]
        return float(np.maximum(0.0, np.median(ways_mm)))


class _Press:
    def __init__(self, t_s: Array, stage_mm: Array, force_N: Array, largest_N: float) -> None:
        self._largest_N, self._stage_mm, self._force_N = largest_N, stage_mm, force_N
        depth_mm = float(np.max(stage_mm))
        at_bottom = stage_mm > depth_mm - 0.005
        self._down, self._up = (
            slice(None, int(np.argmax(at_bottom)) + 1),
            slice(len(t_s) - int(np.argmax(at_bottom[::-1])), None),
        )
        is_hold_end = at_bottom & (t_s > t_s[at_bottom][-1] - EDGE_S)
        self.hold_N = float(np.mean(force_N[is_hold_end]))

    def at_mm(self, share: float, is_down: bool = True) -> float:
        """Return the position at this share of the largest force of all, by a line through its neighbourhood."""
        return self._line(share - 0.15, share + 0.15, is_down)(share * self._largest_N)

    def slope_N_mm(self, low: float, high: float) -> float:
        line = self._line(low, high, True)
        return 1.0 / (line(1.0) - line(0.0))

    def _line(self, low: float, high: float, is_down: bool) -> Callable[[float], float]:
        rows = self._down if is_down else self._up
        stage_mm, share = self._stage_mm[rows], self._force_N[rows] / self._largest_N
        near = (share > low) & (share < high)
        if np.count_nonzero(near) < 3:
            return lambda force_N: float("nan")
        slope, level = np.polyfit(self._force_N[rows][near], stage_mm[near], 1)
        return lambda force_N: float(level + slope * force_N)
