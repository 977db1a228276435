"""Duration of a unit on a rig, phase by phase, and the keys of the station file that would shorten it."""

import math
from collections.abc import Iterator
from dataclasses import replace

from softcal.core.profiles import Profile
from softcal.station.devices.config import LATEST_S, StationConfig
from softcal.station.motion.bounds import ForceBounds

HOMING, READING, SEARCHING = "homing", "reading the unloaded channels", "searching for contact"
PROBING, PRESSING, RETURNING = "feeling the unit", "pressing", "reading the zero return"
"""Phases of a run, in their order."""

HOME_S, READ_S, SETTLE_S, RETURN_S = 5.0, 2.0, 1.0, 3.5
"""Homing, about; reading the unloaded channels; settling before a profile; lifting and the zero return, about."""

FREE_MM, SECOND_APPROACH_WAY_MM = 1.0, 0.3
"""So far below the approach a unit lies, about; a second touch goes so far, four times slower."""

STEP_MM, MIN_PROBING_S = 0.4, 10.0
"""A slow press that would take longer than this goes in steps: how fast the next one may be is known when the force of
the last one is. A shorter one would not tell how late the load cell is."""

SHORTER_N_MM = 100.0
"""A stiffness that may be stated where no rigid thing can come under the stage."""


def phase_seconds(
    config: StationConfig, bounds: ForceBounds, profile: Profile, from_mm: float | None
) -> dict[str, float]:
    """Return how long each phase of a run takes at most, about: for a unit whose force grows evenly to the limit.

    The stage is at `from_mm`; None if it must be homed.
    """
    fixture, fastest_mm_s = config.fixture, config.safety.speed_mm_s
    free_mm_s = fastest_mm_s if config.force is None else min(fastest_mm_s, bounds.free_mm_s)
    search_mm_s = min(fixture.search_mm_s, free_mm_s)
    return {
        HOMING: HOME_S if from_mm is None else 0.0,
        READING: READ_S + max(0.0, fixture.approach_mm - (from_mm or 0.0)) / free_mm_s,
        SEARCHING: FREE_MM / search_mm_s + 4.0 * SECOND_APPROACH_WAY_MM / search_mm_s,
        PROBING: 0.0 if config.force is None else _probing_s(bounds, profile, fastest_mm_s),
        PRESSING: SETTLE_S + profile.duration_s,
        RETURNING: RETURN_S,
    }


def _probing_s(bounds: ForceBounds, profile: Profile, fastest_mm_s: float) -> float:
    slow_mm_s, way_mm = min(fastest_mm_s, bounds.unknown_mm_s), profile.deepest_mm
    if profile.fastest_mm_s <= slow_mm_s:
        return 0.0
    up_s = 2.0 * max(0.3, bounds.reaction.delay_s)
    if way_mm <= MIN_PROBING_S * slow_mm_s:
        return up_s + way_mm / slow_mm_s
    steps = math.ceil(way_mm / STEP_MM)
    grown_N = bounds.limit_N / steps
    detected_N = [min(bounds.limit_N, k * grown_N + bounds.rise_N(grown_N)) for k in range(steps)]
    speeds_mm_s = [min(way_mm / MIN_PROBING_S, bounds.detected_mm_s(newton)) for newton in detected_N]
    return up_s + sum(way_mm / steps / speed_mm_s for speed_mm_s in speeds_mm_s)


def unit_s(config: StationConfig, bounds: ForceBounds, profile: Profile) -> float:
    """Return how long a unit takes at most, about, after the first one."""
    return sum(phase_seconds(config, bounds, profile, config.fixture.approach_mm).values())


def shorter(config: StationConfig, bounds: ForceBounds, profile: Profile) -> Iterator[tuple[str, float, float]]:
    """Yield keys of the station file, a value that would shorten a run, and the seconds of a unit then."""
    if config.force is not None and not config.force.is_latency_declared:
        prompt = replace(bounds.reaction, delay_s=bounds.reaction.delay_s - LATEST_S)
        yield "latency_s", 0.0, unit_s(config, replace(bounds, reaction=prompt), profile)
    if bounds.stiffest_N_mm > SHORTER_N_MM:
        yield "stiffest_N_mm", SHORTER_N_MM, unit_s(config, replace(bounds, stiffest_N_mm=SHORTER_N_MM), profile)
    if (half_N := bounds.limit_N / 2.0) > bounds.touch_N:
        yield "force_N", half_N, unit_s(config, replace(bounds, limit_N=half_N), profile)
