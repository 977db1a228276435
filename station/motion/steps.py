"""A profile as moves from rest to rest and holds, checked before anything moves."""

from softcal.core.errors import CommandRefused
from softcal.core.profiles import Profile
from softcal.core.words.reason import reason
from softcal.station.devices.bench import Bench
from softcal.station.interfaces import Hold, Move, Step


def check_profile(bench: Bench, profile: Profile) -> None:
    """Raise `CommandRefused` when a profile could leave the bounds of stage or station."""
    bounds, fixture = bench.config.safety, bench.config.fixture
    fastest_mm_s = min(bounds.speed_mm_s, bench.stage.max_speed_mm_s)
    deepest_mm = min(bounds.deepest_mm, bench.stage.travel_mm)
    name, most_mm = repr(profile.name), deepest_mm - fixture.approach_mm
    for move in steps_of(profile):
        if not isinstance(move, Move):
            continue
        speed_mm_s, to_mm = move.speed_mm_s, move.to_mm
        if speed_mm_s > fastest_mm_s * (1 + 1e-9):
            speeds = {"speed_mm_s": speed_mm_s, "most_mm_s": fastest_mm_s}
            raise CommandRefused(reason("rig.profile.speed", profile=name, **speeds))
        if not -fixture.clearance_mm <= to_mm <= most_mm:
            raise CommandRefused(reason("rig.profile.depth", profile=name, to_mm=to_mm, most_mm=most_mm))


def steps_of(profile: Profile) -> list[Step]:
    """Return a profile as moves from rest to rest and holds."""
    steps: list[Step] = []
    at_mm = 0.0
    for segment in profile.segments:
        if segment.target_mm == at_mm:
            steps.append(Hold(segment.duration_s))
        else:
            steps.append(Move(segment.target_mm, abs(segment.target_mm - at_mm) / segment.duration_s))
        at_mm = segment.target_mm
    return steps
