"""Stage profiles: what they press, how long, and what is refused."""

import numpy as np
import pytest

from softcal.core import profiles
from softcal.core.errors import InputError
from softcal.core.profiles import Profile, Segment


def test_a_ramp_rises_and_falls_at_its_speed():
    t_s, stage_mm = profiles.ramps([3.0], 1.5, rest_s=1.0).sample(100.0)
    assert stage_mm.max() == pytest.approx(3.0, abs=0.02)
    moving = (t_s > 1.1) & (t_s < 2.9)
    np.testing.assert_allclose(np.gradient(stage_mm, t_s)[moving], 1.5, rtol=1e-9)


def test_a_profile_begins_and_ends_at_rest():
    rng = np.random.default_rng(1)
    for profile in (profiles.rate_sweep(3.0), profiles.source_profile(rng), profiles.unit_profile(rng)):
        t_s, stage_mm = profile.sample(50.0)
        assert stage_mm[0] == 0.0 and profile.position_mm(np.array([profile.duration_s]))[0] == 0.0
        assert t_s[-1] <= profile.duration_s


def test_depth_and_speed_are_known_before_the_run():
    profile = profiles.moves("two moves", [2.0, 0.5], [4.0, 0.5], [1.0, 0.0])
    assert (profile.deepest_mm, profile.fastest_mm_s, profile.duration_s) == (2.0, 4.0, 0.5 + 1.0 + 3.0)


def test_random_presses_repeat_with_their_seed_and_stay_within_depth():
    first = profiles.random_presses(np.random.default_rng(3), 30.0, 3.2)
    second = profiles.random_presses(np.random.default_rng(3), 30.0, 3.2)
    assert first == second
    assert first.duration_s >= 30.0 and first.deepest_mm <= 3.2


@pytest.mark.parametrize("segments", [(), (Segment(1.0, 0.0),), (Segment(float("nan"), 1.0),)])
def test_a_profile_without_meaning_is_refused(segments):
    with pytest.raises(InputError, match="'broken'"):
        Profile("broken", segments)


def test_a_move_without_speed_is_refused():
    with pytest.raises(InputError):
        profiles.moves("still", [1.0], [0.0], [0.0])
