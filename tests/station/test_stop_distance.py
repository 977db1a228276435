"""What the speeds of a stage promise: a stop ends below the ceiling, however late it is noticed."""

from types import SimpleNamespace

import numpy as np
import pytest

from softcal.station.devices.config import LATEST_S
from softcal.station.devices.piece_feed import PieceFeed, runs_on_mm, runs_on_s
from softcal.station.interfaces import Move
from softcal.station.motion.bounds import FULL, REACTION_S, RISE, ForceBounds, Reaction
from softcal.station.motion.monitored_bench import bounds_of
from softcal.station.trajectory import Trapezoid

REACTION = Reaction(delay_s=0.25, acceleration_mm_s2=40.0)
BOUNDS = ForceBounds(REACTION, limit_N=8.0, touch_N=0.2, ceiling_N=FULL * 20.0, stiffest_N_mm=60.0)


def gone_mm(speed_mm_s: float, delay_s: float, acceleration_mm_s2: float) -> float:
    """How far a stage goes that keeps its speed for a while and then brakes, in steps of 10 us."""
    t_s = np.arange(0.0, delay_s + speed_mm_s / acceleration_mm_s2 + 0.1, 1e-5)
    speeds = np.clip(speed_mm_s - acceleration_mm_s2 * np.maximum(0.0, t_s - delay_s), 0.0, speed_mm_s)
    return float(np.trapezoid(speeds, t_s))


@pytest.mark.parametrize("speed_mm_s", [0.05, 1.0, 12.0])
def test_a_stage_goes_on_as_far_as_its_motion_adds_up_to(speed_mm_s):
    assert REACTION.overrun_mm(speed_mm_s) == pytest.approx(gone_mm(speed_mm_s, 0.25, 40.0), rel=1e-4)


@pytest.mark.parametrize("distance_mm", [1e-6, 0.01, 0.3, 5.0])
def test_the_fastest_speed_uses_the_whole_stopping_distance_and_no_more(distance_mm):
    assert REACTION.overrun_mm(REACTION.fastest_mm_s(distance_mm)) == pytest.approx(distance_mm, rel=1e-9)


def test_without_room_a_stage_does_not_move():
    assert REACTION.fastest_mm_s(0.0) == REACTION.fastest_mm_s(-1.0) == 0.0


@pytest.mark.parametrize(
    ("speed_mm_s", "detected_N", "stiffness_N_mm"),
    [
        (BOUNDS.free_mm_s, BOUNDS.touch_N, 60.0),
        (BOUNDS.unknown_mm_s, BOUNDS.limit_N, 60.0),
        (BOUNDS.probed_mm_s(3.0, 2.0), 3.0, 2.0),
    ],
    ids=["nothing there", "not pressed yet", "known stiffness"],
)
def test_a_spring_that_stops_the_stage_ends_at_the_ceiling(speed_mm_s, detected_N, stiffness_N_mm):
    ends_N = detected_N + stiffness_N_mm * gone_mm(speed_mm_s, 0.25, 40.0)
    assert ends_N == pytest.approx(18.0, rel=1e-3)
    assert BOUNDS.worst_N(speed_mm_s, detected_N, stiffness_N_mm) == pytest.approx(ends_N, rel=1e-3)


def test_a_spring_of_one_stiffness_is_pressed_and_a_hard_thing_beneath_it_is_not():
    rises_N = np.diff(2.0 * np.linspace(0.0, 3.0, 40))
    assert all(after <= BOUNDS.rise_N(before) for before, after in zip(rises_N[:-1], rises_N[1:], strict=True))
    grown_N = 2.0 * 1.2  # twice what the last step grew by passes, where that is more than the share of the limit
    assert BOUNDS.rise_N(1.2) == pytest.approx(grown_N)
    assert BOUNDS.rise_N(0.0) == pytest.approx(RISE * 8.0)


@pytest.mark.parametrize("detected_N", [0.2, 8.0])
def test_a_host_that_dies_leaves_a_hard_thing_below_the_ceiling(detected_N):
    speed_mm_s = 2.0
    unseen_mm = speed_mm_s * (0.25 - REACTION_S)
    ahead_mm = BOUNDS.ahead_mm(speed_mm_s, detected_N)
    assert detected_N + 60.0 * (unseen_mm + ahead_mm) == pytest.approx(18.0)


def test_the_force_that_a_dead_host_leaves_counts_what_it_had_not_seen_and_what_still_runs():
    assert BOUNDS.host_loss_N(2.0, 0.05) == pytest.approx(8.0 + 60.0 * (2.0 * (0.25 - REACTION_S) + 0.05))


@pytest.mark.parametrize("ahead_mm", [float("inf"), 0.4, 0.03])
@pytest.mark.parametrize("distance_mm", [0.0005, 0.7, 5.0])
@pytest.mark.parametrize("dies_at", [0.0, 0.3, 0.9])
def test_a_stage_that_is_fed_never_runs_on_further_than_is_reported(distance_mm, ahead_mm, dies_at):
    speed_mm_s, acceleration_mm_s2 = 3.0, 40.0
    path = Trapezoid(1.0, 1.0 + distance_mm, speed_mm_s, acceleration_mm_s2)
    feed, reported_mm, ran_mm = PieceFeed(path, ahead_mm, 0.0), 1.0, 0.0
    for now_s in np.arange(0.0, dies_at * path.duration_s + 1e-9, 0.005):
        while (due_mm := feed.due_mm(float(now_s))) is not None:
            reported_mm = due_mm
            feed.mark_sent(float(now_s))
        ran_mm = max(ran_mm, reported_mm - float(path.position_mm(now_s)))
    move = Move(1.0 + distance_mm, speed_mm_s, ahead_mm=ahead_mm)
    assert ran_mm <= runs_on_mm(move, acceleration_mm_s2) + 0.001 + 1e-9
    assert ran_mm <= speed_mm_s * runs_on_s(speed_mm_s, acceleration_mm_s2)


def test_every_piece_is_sent_in_order_and_the_last_one_ends_the_move():
    path = Trapezoid(0.0, 2.0, 4.0, 40.0)
    feed, sent_mm = PieceFeed(path, float("inf"), 10.0), []
    for now_s in np.arange(10.0, 10.0 + path.duration_s, 0.01):
        if (due_mm := feed.due_mm(float(now_s))) is not None:
            sent_mm.append(due_mm)
            feed.mark_sent(float(now_s))
    assert not feed and sent_mm == sorted(sent_mm) and sent_mm[-1] == 2.0
    assert max(np.diff([0.0, *sent_mm])) <= 4.0 * 0.1 + 1e-9  # a tenth of a second each


def test_a_cell_whose_delay_nobody_stated_is_taken_to_be_as_late_as_a_station_file_may_say():
    def delay_s(force: object, reader: object = SimpleNamespace(rate_Hz=50.0, capacity_N=20.0)) -> float:
        safety, fixture = SimpleNamespace(force_N=8.0, stiffest_N_mm=60.0), SimpleNamespace(touch_N=0.2)
        config = SimpleNamespace(force=force, safety=safety, fixture=fixture)
        stage = SimpleNamespace(acceleration_mm_s2=40.0)
        return bounds_of(SimpleNamespace(config=config, force=reader, stage=stage)).reaction.delay_s

    declared, unstated = (
        SimpleNamespace(latency_s=0.03, is_latency_declared=is_declared) for is_declared in (True, False)
    )
    assert delay_s(declared) == pytest.approx(1 / 50.0 + 0.03 + REACTION_S)
    assert delay_s(unstated) == pytest.approx(1 / 50.0 + LATEST_S + REACTION_S)
    assert delay_s(None, None) == pytest.approx(LATEST_S + REACTION_S)
