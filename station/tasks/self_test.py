"""Self-test of a station: every device at its rate, the load cell at zero, the stage homed and in position."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from softcal.core.errors import DeviceError
from softcal.core.messages.reason import Reason, Value, plain, reason
from softcal.core.profiles import Profile
from softcal.station.bench.bench import Bench
from softcal.station.clock import CLOCK_SHARE, estimate_rate_Hz
from softcal.station.device_names import device_label
from softcal.station.interfaces import ForceReader, Move, Readout, Sample, SelfStoppingStage, SettingsAudit
from softcal.station.motion.monitored_bench import MonitoredBench, bounds_of
from softcal.station.motion.motion import Cancelled
from softcal.station.record.recording import clock_of
from softcal.station.tasks.durations import PROBING, phase_seconds, shorter

LISTEN_S = 5.0
LOOK_S = 0.001
"""How often the readers are read: arrival times are no finer than this."""

STEP_MM, STEP_S = 2.0, 10.0
"""The stage goes down by so much and for so long at most: what is in the way is met slowly."""

SUSPENDED_S, SUSPENDED_SHARE = 1.0, 0.25
"""The stage is told nothing for so long, from this share of its way on: longer than all that was sent ahead takes."""

POSITION_MM = 0.02
RATE_SHARE = 0.05


@dataclass(frozen=True)
class SelfTestItem:
    """One result of the self-test.

    Args:
        cure: what to do; None when it is good.
    """

    device: Reason
    what: Reason
    value: Reason
    cure: Reason | None = None

    @property
    def is_good(self) -> bool:
        return self.cure is None


def _item(device: str, check: str, finding: str, cure: Reason | None = None, /, **values: Value) -> SelfTestItem:
    return SelfTestItem(device_label(device), Reason(check), reason(finding, **values), cure)


def self_test(
    bench: Bench,
    may_move: bool = True,
    on_wait: Callable[[], None] = lambda: None,
    profile: Profile | None = None,
) -> list[SelfTestItem]:
    """Home the stage and move it by a short way under all monitors, then read every channel for some seconds.

    A device that fails is a finding, so that one self-test reports all faults.

    Args:
        may_move: home the stage and move it by up to 2 mm, never deeper than the approach.
        on_wait: called throughout; an exception stops the stage and ends the self-test.
        profile: of the units; then it is said how long one takes.

    Raises:
        Cancelled: a stop was requested, or Ctrl-C pressed; the stage was made safe.
    """
    findings = _stage_findings(bench, on_wait) if may_move else []
    readers: list[ForceReader | Readout] = [bench.readout, *([bench.force] if bench.force else [])]
    samples: dict[str, list[Sample]] = {reader.name: [] for reader in readers}
    try:
        for reader in readers:
            reader.start()
        end_s = bench.clock.now_s() + LISTEN_S
        while bench.clock.now_s() < end_s:
            bench.clock.sleep_s(LOOK_S)
            on_wait()
            for reader in readers:
                samples[reader.name] += reader.poll()
    except Cancelled:
        raise
    except DeviceError as error:
        findings.append(_item("readers", "check.stream", "found.failed", error.reason))
    for reader in readers:
        findings += _stream_findings(reader, samples[reader.name])
    if bench.force is not None and (weighed := samples[bench.force.name]):
        zero_N, allowed_N = float(np.mean([sample.values[0] for sample in weighed])), bench.config.safety.zero_N
        cure = None if abs(zero_N) <= allowed_N else reason("cure.zero", allowed_N=allowed_N)
        findings.append(_item("load cell", "check.zero", "found.zero", cure, zero_N=zero_N))
    if bench.force is None:
        findings.append(_item("stage", "check.unseen", "found.unseen"))
    if profile is None:
        return findings
    bounds = bounds_of(bench)
    phases = phase_seconds(bench.config, bounds, profile, bench.config.fixture.approach_mm)
    all_s = sum(phases.values())
    about = {"press_s": profile.duration_s, "feel_s": phases[PROBING], "stiffest_N_mm": bounds.stiffest_N_mm}
    findings.append(
        _item("stage", "check.unit_seconds", "found.unit_seconds", all_s=all_s, profile=profile.name, **about)
    )
    for key, value, shorter_s in shorter(bench.config, bounds, profile):
        if shorter_s < all_s - 1.0:
            findings.append(_item("stage", "check.shorter", "found.shorter", key=key, value=value, all_s=shorter_s))
    return findings


def _stream_findings(reader: ForceReader | Readout, samples: Sequence[Sample]) -> Iterator[SelfTestItem]:
    name, unit = reader.name, reader.unit
    if len(samples) < 10:
        yield _item(name, "check.stream", "found.samples", Reason("cure.no_stream"), count=len(samples))
        return
    values = np.array([sample.values for sample in samples])
    noise = float(np.max(np.std(np.diff(values, axis=0), axis=0))) / np.sqrt(2)
    means = ", ".join(f"{value:.4g}" for value in values.mean(axis=0))
    yield _item(name, "check.reading", "found.reading", values=means, unit=unit)
    yield _item(name, "check.noise", "found.noise", noise=noise, unit=unit)
    if samples[0].device_s is None:
        return
    device_s, fit = clock_of(samples)
    rate_Hz = estimate_rate_Hz(device_s)
    is_right = abs(rate_Hz / reader.rate_Hz - 1) < RATE_SHARE
    slow = None if is_right else reason("cure.rate", rate_Hz=reader.rate_Hz)
    yield _item(name, "check.rate", "found.rate", slow, rate_Hz=rate_Hz)
    drift = Reason("cure.clock") if abs(fit.rate - 1) > CLOCK_SHARE else None
    drift_ppm, uncertainty_ppm = (f"{1e6 * share:.0f}" for share in (1 - fit.rate, LOOK_S / LISTEN_S))
    yield _item(name, "check.drift", "found.drift", drift, drift_ppm=drift_ppm, doubt_ppm=uncertainty_ppm)
    yield _item(name, "check.latency", "found.latency", middle_ms=1000.0 * fit.late_s, most_ms=1000.0 * fit.latest_s)


def _stage_findings(bench: Bench, on_wait: Callable[[], None]) -> list[SelfTestItem]:
    stage = bench.stage
    monitored = MonitoredBench(bench, None, on_wait)
    try:
        way = monitored.motion.supervise(lambda: _go_out_and_back(monitored))
    except Cancelled:
        raise
    except DeviceError as error:
        return [_item("stage", "check.homing_moving", "found.failed", error.reason)]
    cure = None if abs(way.error_mm) < POSITION_MM else Reason("cure.return")
    about = {"way_mm": 2 * way.down_mm, "took_s": way.took_s, "error_mm": way.error_mm}
    return [
        _item("stage", "check.homing", "found.switch"),
        _item("stage", "check.travel", "found.travel", travel_mm=stage.travel_mm, speed_mm_s=stage.max_speed_mm_s),
        _item("stage", "check.return", "found.return", cure, **about),
        *(_safety_findings(monitored, way) if bench.force is not None else ()),
    ]


@dataclass(frozen=True)
class _OutAndBack:
    """Speeds and times of one way of the self-test.

    They are the speed of the stage, the times down and up, the depth, the difference of position after the return, and
    the overrun without commands (NaN if not measured).
    """

    speed_mm_s: float
    took_s: float
    down_mm: float
    error_mm: float
    ran_on_mm: float


def _go_out_and_back(monitored: MonitoredBench) -> _OutAndBack:
    bench, stage = monitored.bench, monitored.bench.stage
    monitored.start()
    monitored.home()
    monitored.motion.wait(0.3)
    monitored.expect_nothing()
    began_mm, began_s, speed_mm_s = stage.position_mm, bench.clock.now_s(), min(5.0, monitored.fastest_mm_s)
    free_mm = max(0.0, bench.config.fixture.approach_mm - began_mm)
    down_mm, ran_on_mm = min(STEP_MM, speed_mm_s * STEP_S, free_mm), float("nan")
    if down_mm > 0.0:
        ran_on_mm = _ran_on_mm(monitored, began_mm + down_mm, speed_mm_s)
        monitored.motion.go(began_mm, speed_mm_s)
    took_s, count = bench.clock.now_s() - began_s, len(monitored.readings.polls)
    monitored.motion.wait(0.4)
    if len(monitored.readings.polls) == count:
        raise DeviceError(Reason("rig.no_position.known"))
    suspended_s = SUSPENDED_S if np.isfinite(ran_on_mm) else 0.0
    return _OutAndBack(
        speed_mm_s, took_s - suspended_s, down_mm, monitored.readings.polls[-1].position_mm - began_mm, ran_on_mm
    )


def _ran_on_mm(monitored: MonitoredBench, to_mm: float, speed_mm_s: float) -> float:
    """Move without commands from the way on, as after a loss of the host; return the overrun in mm."""
    stage, clock, polls = monitored.bench.stage, monitored.bench.clock, monitored.readings.polls
    from_mm = stage.position_mm + SUSPENDED_SHARE * (to_mm - stage.position_mm)
    suspended: list[tuple[float, float]] = []  # (from when, until when it was left alone)

    def leave_once() -> bool:
        if not suspended and polls and polls[-1].position_mm > from_mm:
            began_s = clock.now_s()
            monitored.suspend_stage(SUSPENDED_S)
            suspended.append((began_s, clock.now_s()))
        return False

    move = monitored.motion.go(to_mm, speed_mm_s, leave_once if isinstance(stage, SelfStoppingStage) else None)
    later_mm = [poll.position_mm for poll in polls if suspended and poll.host_s > suspended[0][1]]
    if not later_mm:
        return float("nan")
    # By the path it was told: an answer that a stall held back is older than it seems.
    start_mm = float(move.path.position_mm(np.array([suspended[0][0] - move.begun_s]))[0])
    return max(0.0, later_mm[0] - start_mm)


def _safety_findings(monitored: MonitoredBench, way: _OutAndBack) -> Iterator[SelfTestItem]:
    """Return the force that a stop on this rig allows, and after a loss of the host: bound and measurement."""
    bounds, stage = monitored.bounds, monitored.bench.stage
    for setting, mend in stage.unsafe_settings() if isinstance(stage, SettingsAudit) else ():
        yield SelfTestItem(device_label("stage"), Reason("check.setting"), plain(setting), mend)
    free_mm_s, unknown_mm_s = bounds.free_mm_s, bounds.unknown_mm_s
    speeds = {"free_mm_s": free_mm_s, "unknown_mm_s": unknown_mm_s}
    yield _item("stage", "check.safe_speed", "found.safe_speed", ceiling_N=bounds.ceiling_N, **speeds)
    if not isinstance(stage, SelfStoppingStage):
        return
    fast_mm_s = monitored.bench.config.safety.speed_mm_s
    slow_mm_s = min(unknown_mm_s, fast_mm_s)
    slow_mm = stage.runs_on_mm(Move(0.0, slow_mm_s, bounds.ahead_mm(slow_mm_s, bounds.limit_N)))
    fast = {"speed_mm_s": fast_mm_s, "way_mm": stage.runs_on_mm(Move(0.0, fast_mm_s))}
    slow = {"slow_mm_s": slow_mm_s, "slow_mm": slow_mm, "worst_N": bounds.host_loss_N(slow_mm_s, slow_mm)}
    yield _item("stage", "check.runs_on", "found.runs_on", on_s=stage.runs_on_s(fast_mm_s), **fast, **slow)
    if np.isfinite(way.ran_on_mm):
        max_mm = stage.runs_on_mm(Move(0.0, way.speed_mm_s, bounds.ahead_mm(way.speed_mm_s, bounds.touch_N)))
        cure = None if way.ran_on_mm <= max_mm + POSITION_MM else Reason("cure.ran_on")
        about = {"way_mm": way.ran_on_mm, "speed_mm_s": way.speed_mm_s, "most_mm": max_mm}
        yield _item("stage", "check.ran_on", "found.ran_on", cure, **about)
