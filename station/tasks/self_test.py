"""Is this station fit to press: every device at its rate, the load cell at zero, the stage homed and where it says."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from softcal.core.errors import DeviceError
from softcal.core.profiles import Profile
from softcal.core.words.reason import Reason, plain, reason
from softcal.station.clock import CLOCK_SHARE, fit_clock, seen_rate_Hz
from softcal.station.devices.bench import Bench
from softcal.station.interfaces import Advises, ForceReader, Move, Readout, RunsOn, Sample
from softcal.station.motion.motion import Cancelled
from softcal.station.motion.watched import WatchedBench, bounds_of
from softcal.station.named import named
from softcal.station.tasks.seconds import FEELING, seconds_of, shorter

LISTEN_S = 5.0
LOOK_S = 0.001
"""How often the readers are read: arrival times are no finer than this."""

STEP_MM, STEP_S = 2.0, 10.0
"""The stage goes down by at most so much, and for at most so long: what is in the way is to be met slowly."""

GONE_S, GONE_SHARE = 1.0, 0.25
"""The stage is told nothing for so long, from this share of its way on: longer than all that was sent ahead takes."""

STAGE = named("stage")

POSITION_MM = 0.02
RATE_SHARE = 0.05


@dataclass(frozen=True)
class SelfTestItem:
    """One thing the self-test looked at.

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


def self_test(
    bench: Bench,
    may_move: bool = True,
    on_wait: Callable[[], None] = lambda: None,
    profile: Profile | None = None,
) -> list[SelfTestItem]:
    """Home the stage and move it a little, watched as any other move, then read every channel for some seconds.

    A device that fails is a finding, so that all faults are seen at once.

    Args:
        may_move: home the stage and move it by up to 2 mm, never deeper than the approach.
        on_wait: called all the time; what it raises stops the stage and ends the self-test.
        profile: of the units; then it is said how long one takes.

    Raises:
        Cancelled: somebody asked for a stop, or pressed Ctrl-C; the stage was made safe.
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
        findings.append(
            SelfTestItem(Reason("device.readers"), Reason("check.stream"), Reason("found.failed"), error.reason)
        )
    for reader in readers:
        findings += _stream_findings(reader, samples[reader.name])
    if bench.force is not None:
        findings += _zero_findings(bench, samples[bench.force.name])
    return findings if profile is None else [*findings, *_seconds_findings(bench, profile)]


def _seconds_findings(bench: Bench, profile: Profile) -> Iterator[SelfTestItem]:
    """How long a unit takes, and what would shorten it."""
    config, bounds = bench.config, bounds_of(bench)
    phases = seconds_of(config, bounds, profile, config.fixture.approach_mm)
    all_s = sum(phases.values())
    found = reason(
        "found.unit_seconds",
        all_s=all_s,
        press_s=profile.duration_s,
        feel_s=phases[FEELING],
        stiffest_N_mm=bounds.stiffest_N_mm,
        profile=profile.name,
    )
    yield SelfTestItem(STAGE, Reason("check.unit_seconds"), found)
    for key, value, shorter_s in shorter(config, bounds, profile):
        if shorter_s < all_s - 1.0:
            found = reason("found.shorter", key=key, value=value, all_s=shorter_s)
            yield SelfTestItem(STAGE, Reason("check.shorter"), found)


def _stream_findings(reader: ForceReader | Readout, samples: Sequence[Sample]) -> list[SelfTestItem]:
    if len(samples) < 10:
        return [
            SelfTestItem(
                named(reader.name),
                Reason("check.stream"),
                reason("found.samples", count=len(samples)),
                Reason("cure.no_stream"),
            )
        ]
    values = np.array([sample.values for sample in samples])
    noise = float(np.max(np.std(np.diff(values, axis=0), axis=0))) / np.sqrt(2)
    findings = [
        SelfTestItem(
            named(reader.name),
            Reason("check.reading"),
            reason("found.reading", values=", ".join(f"{v:.4g}" for v in values.mean(axis=0)), unit=reader.unit),
        ),
        SelfTestItem(named(reader.name), Reason("check.noise"), reason("found.noise", noise=noise, unit=reader.unit)),
    ]
    if samples[0].device_s is None:
        return findings
    device_s = np.array([sample.device_s for sample in samples], dtype=np.float64)
    fit = fit_clock(device_s, np.array([sample.host_s for sample in samples]))
    rate_Hz = seen_rate_Hz(device_s)
    is_right = abs(rate_Hz / reader.rate_Hz - 1) < RATE_SHARE
    slow = reason("cure.rate", rate_Hz=reader.rate_Hz)
    drift = Reason("cure.clock") if abs(fit.rate - 1) > CLOCK_SHARE else None
    return [
        *findings,
        SelfTestItem(
            named(reader.name), Reason("check.rate"), reason("found.rate", rate_Hz=rate_Hz), None if is_right else slow
        ),
        SelfTestItem(
            named(reader.name),
            Reason("check.drift"),
            reason("found.drift", drift_ppm=_ppm(1 - fit.rate), doubt_ppm=_ppm(LOOK_S / LISTEN_S)),
            drift,
        ),
        SelfTestItem(
            named(reader.name),
            Reason("check.latency"),
            reason("found.latency", middle_ms=1000.0 * fit.late_s, most_ms=1000.0 * fit.latest_s),
        ),
    ]


def _ppm(share: float) -> str:
    return f"{1e6 * share:.0f}"


def _zero_findings(bench: Bench, samples: Sequence[Sample]) -> list[SelfTestItem]:
    if not samples:
        return []
    zero_N, allowed_N = float(np.mean([sample.values[0] for sample in samples])), bench.config.safety.zero_N
    cure = None if abs(zero_N) <= allowed_N else reason("cure.zero", allowed_N=allowed_N)
    return [SelfTestItem(named("load cell"), Reason("check.zero"), reason("found.zero", zero_N=zero_N), cure)]


def _stage_findings(bench: Bench, on_wait: Callable[[], None]) -> list[SelfTestItem]:
    stage = bench.stage
    watched = WatchedBench(bench, None, on_wait)
    try:
        way = watched.motion.supervise(lambda: _go_out_and_back(watched))
    except Cancelled:
        raise
    except DeviceError as error:
        return [SelfTestItem(STAGE, Reason("check.homing_moving"), Reason("found.failed"), error.reason)]
    cure = None if abs(way.error_mm) < POSITION_MM else Reason("cure.return")
    return [
        SelfTestItem(STAGE, Reason("check.homing"), Reason("found.switch")),
        SelfTestItem(
            STAGE,
            Reason("check.travel"),
            reason("found.travel", travel_mm=stage.travel_mm, speed_mm_s=stage.max_speed_mm_s),
        ),
        SelfTestItem(
            STAGE,
            Reason("check.return"),
            reason("found.return", way_mm=2 * way.down_mm, took_s=way.took_s, error_mm=way.error_mm),
            cure,
        ),
        *_safety_findings(bench, watched, way),
    ]


@dataclass(frozen=True)
class _Way:
    """How fast the stage went, how long down and up took, how far down it went, by how much it came back elsewhere, and
    how far it ran on when it was left alone (NaN where it was not)."""

    speed_mm_s: float
    took_s: float
    down_mm: float
    error_mm: float
    ran_on_mm: float


def _go_out_and_back(watched: WatchedBench) -> _Way:
    bench, stage = watched.bench, watched.bench.stage
    watched.start()
    watched.home()
    watched.motion.wait(0.3)
    watched.expect_nothing()
    began_mm, began_s, speed_mm_s = stage.position_mm, bench.clock.now_s(), min(5.0, watched.fastest_mm_s)
    room_mm = max(0.0, bench.config.fixture.approach_mm - began_mm)
    down_mm, ran_on_mm = min(STEP_MM, speed_mm_s * STEP_S, room_mm), float("nan")
    if down_mm > 0.0:
        ran_on_mm = _ran_on_mm(watched, began_mm + down_mm, speed_mm_s)
        watched.motion.go(began_mm, speed_mm_s)
    took_s, count = bench.clock.now_s() - began_s, len(watched.readings.polls)
    watched.motion.wait(0.4)
    if len(watched.readings.polls) == count:
        raise DeviceError(Reason("rig.no_position.known"))
    gone_s = GONE_S if np.isfinite(ran_on_mm) else 0.0
    return _Way(speed_mm_s, took_s - gone_s, down_mm, watched.readings.polls[-1].position_mm - began_mm, ran_on_mm)


def _ran_on_mm(watched: WatchedBench, to_mm: float, speed_mm_s: float) -> float:
    """Go there, leave the stage alone on the way as if its host had died, and return how far it went meanwhile."""
    stage, clock, polls = watched.bench.stage, watched.bench.clock, watched.readings.polls
    from_mm = stage.position_mm + GONE_SHARE * (to_mm - stage.position_mm)
    gone: list[tuple[float, float]] = []  # (from when, until when it was left alone)

    def leave_once() -> bool:
        if not gone and polls and polls[-1].position_mm > from_mm:
            began_s = clock.now_s()
            watched.leave_stage_alone(GONE_S)
            gone.append((began_s, clock.now_s()))
        return False

    move = watched.motion.go(to_mm, speed_mm_s, leave_once if isinstance(stage, RunsOn) else None)
    later_mm = [poll.position_mm for poll in polls if gone and poll.host_s > gone[0][1]]
    if not later_mm:
        return float("nan")
    # By the path it was told: an answer that a stall held back is older than it seems.
    here_mm = float(move.path.position_mm(np.array([gone[0][0] - move.begun_s]))[0])
    return max(0.0, later_mm[0] - here_mm)


def _safety_findings(bench: Bench, watched: WatchedBench, way: _Way) -> list[SelfTestItem]:
    """What a stop holds on this rig, in figures."""
    if bench.force is None:
        return []
    bounds, stage = watched.bounds, bench.stage
    settings = stage.unsafe_settings() if isinstance(stage, Advises) else ()
    unsafe = [SelfTestItem(STAGE, Reason("check.setting"), plain(value), cure) for value, cure in settings]
    safe = reason(
        "found.safe_speed", free_mm_s=bounds.free_mm_s, unknown_mm_s=bounds.unknown_mm_s, ceiling_N=bounds.ceiling_N
    )
    findings = [*unsafe, SelfTestItem(STAGE, Reason("check.safe_speed"), safe)]
    return [*findings, *_gone_findings(watched, stage, way)] if isinstance(stage, RunsOn) else findings


def _gone_findings(watched: WatchedBench, stage: RunsOn, way: _Way) -> list[SelfTestItem]:
    """How far the stage runs on when the host dies, at most and as measured, and what that may add to the force."""
    bounds, fastest_mm_s = watched.bounds, watched.bench.config.safety.speed_mm_s
    slow_mm_s = min(bounds.unknown_mm_s, fastest_mm_s)
    slow_mm = stage.runs_on_mm(Move(0.0, slow_mm_s, bounds.ahead_mm(slow_mm_s, bounds.limit_N)))
    findings = [
        SelfTestItem(
            STAGE,
            Reason("check.runs_on"),
            reason(
                "found.runs_on",
                speed_mm_s=fastest_mm_s,
                on_s=stage.runs_on_s(fastest_mm_s),
                way_mm=stage.runs_on_mm(Move(0.0, fastest_mm_s)),
                slow_mm_s=slow_mm_s,
                slow_mm=slow_mm,
                worst_N=bounds.gone_N(slow_mm_s, slow_mm),
            ),
        )
    ]
    if np.isfinite(way.ran_on_mm):
        speed_mm_s = way.speed_mm_s
        most_mm = stage.runs_on_mm(Move(0.0, speed_mm_s, bounds.ahead_mm(speed_mm_s, bounds.touch_N)))
        found = reason("found.ran_on", way_mm=way.ran_on_mm, speed_mm_s=speed_mm_s, most_mm=most_mm)
        is_right = way.ran_on_mm <= most_mm + POSITION_MM
        findings.append(SelfTestItem(STAGE, Reason("check.ran_on"), found, None if is_right else Reason("cure.ran_on")))
    return findings
