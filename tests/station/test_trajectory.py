"""The path a controller drives, and the position in time that ten polls a second leave over."""

import numpy as np
import pytest

from softcal.station.interfaces import StagePosition
from softcal.station.simulated.motion import Axis, QueuedMove
from softcal.station.trajectory import DrivenMove, Trapezoid, reconstruct_track


@pytest.mark.parametrize(("start", "end", "speed"), [(0.0, 3.0, 2.0), (3.0, 0.5, 10.0), (1.0, 1.02, 8.0)])
def test_trapezoid_agrees_with_the_simulated_drive(start, end, speed):
    """Two implementations: closed form here, event by event in the simulated axis."""
    path, axis = Trapezoid(start, end, speed, 200.0), Axis(200.0)
    axis.position_mm = start
    axis.add(QueuedMove(end, speed))
    for t_s in np.linspace(0.0, path.duration_s * 1.1, 57):
        axis.advance(t_s)
        assert path.position_mm(np.array([t_s]))[0] == pytest.approx(axis.position_mm, abs=1e-9)
    assert not axis.is_moving


def test_collinear_pieces_move_like_one_stroke():
    whole, pieces = Axis(200.0), Axis(200.0)
    whole.add(QueuedMove(4.0, 5.0))
    for k in range(1, 9):
        pieces.add(QueuedMove(0.5 * k, 5.0))
    for t_s in np.linspace(0.0, 0.9, 91):
        whole.advance(t_s)
        pieces.advance(t_s)
        assert pieces.position_mm == pytest.approx(whole.position_mm, abs=1e-6)


def test_feed_hold_brakes_at_the_drives_acceleration():
    axis = Axis(200.0)
    axis.add(QueuedMove(10.0, 10.0))
    axis.advance(0.5)
    at_mm = axis.position_mm
    axis.hold()
    axis.advance(1.0)
    assert axis.position_mm - at_mm == pytest.approx(10.0**2 / (2 * 200.0))
    assert not axis.is_moving


def driven(begun_s, start, end, speed, delay_s=0.012):
    path = Trapezoid(start, end, speed, 200.0)
    return DrivenMove(path, begun_s, begun_s + delay_s + path.duration_s + 0.02)


def test_polls_ten_times_a_second_give_the_corner_back(rng):
    """Truth: two strokes that began 12 ms after they were sent; straight lines between polls would miss by 0.2 mm."""
    moves = [driven(1.0, 0.0, 3.0, 4.0), driven(2.0, 3.0, 0.0, 4.0)]

    def truth(t_s):
        first, second = (move.path.position_mm(t_s - move.begun_s - 0.012) for move in moves)
        return np.where(t_s < 2.0, first, second)

    poll_s = np.arange(0.05, 3.5, 0.1)
    polls = [StagePosition(t, round(p, 3)) for t, p in zip(poll_s, truth(poll_s), strict=True)]
    t_s = np.arange(0.5, 3.4, 0.005)
    track = reconstruct_track(polls, moves)
    assert np.max(np.abs(track.at(t_s) - truth(t_s))) < 0.005
    assert np.max(np.abs(np.interp(t_s, poll_s, [p.position_mm for p in polls]) - truth(t_s))) > 0.05


def test_a_move_that_paused_is_drawn_through_its_polls():
    move = DrivenMove(Trapezoid(0.0, 4.0, 4.0, 200.0), 0.0, 3.1)
    poll_s = np.arange(0.05, 3.5, 0.1)
    paused = np.interp(poll_s, [0.0, 0.5, 2.5, 3.0], [0.0, 2.0, 2.0, 4.0])
    track = reconstruct_track([StagePosition(t, p) for t, p in zip(poll_s, paused, strict=True)], [move])
    assert track.at(np.array([1.5]))[0] == pytest.approx(2.0, abs=0.01)


@pytest.mark.parametrize("late_s", [0.03, 0.06, 0.1])
@pytest.mark.parametrize("poll", range(21, 29))
def test_a_poll_whose_line_came_late_leaves_the_stage_where_it_was(poll, late_s):
    """A fast retract after a rest: any of its eight polls may be the one that a busy line holds back."""
    moves = [driven(1.0, 0.0, 3.0, 4.0), driven(2.15, 3.0, -0.5, 5.0)]

    def truth(t_s):
        first, second = (move.path.position_mm(t_s - move.begun_s - 0.012) for move in moves)
        return np.where(t_s < 2.1, first, second)

    sent_s = np.arange(0.05, 3.5, 0.1)
    # Lines keep their order: what comes behind a late one comes later, too.
    arrived_s = np.maximum.accumulate(sent_s + np.where(np.arange(len(sent_s)) == poll, late_s, 0.0))
    polls = [StagePosition(t, round(p, 3)) for t, p in zip(arrived_s, truth(sent_s), strict=True)]
    t_s = np.arange(0.5, 3.4, 0.005)
    assert np.max(np.abs(reconstruct_track(polls, moves).at(t_s) - truth(t_s))) < 0.005


def test_a_move_that_went_otherwise_begins_where_it_was_sent():
    """Before its first poll the stage rested; a line from the last move's end would have it creep for a second."""
    moves = [driven(0.0, 0.0, 2.0, 4.0), DrivenMove(Trapezoid(2.0, 0.0, 4.0, 200.0), 2.0, 4.0)]
    poll_s = np.arange(0.0, 4.5, 0.1)
    went_mm = np.interp(poll_s, [0.012, 0.53, 2.0, 2.25, 3.0, 3.25], [0.0, 2.0, 2.0, 1.0, 1.0, 0.0])
    track = reconstruct_track([StagePosition(t, p) for t, p in zip(poll_s, went_mm, strict=True)], moves)
    np.testing.assert_allclose(track.at(np.array([0.8, 1.5, 2.0])), 2.0, atol=0.005)
    assert track.at(np.array([2.7]))[0] == pytest.approx(1.0, abs=0.01)


def test_without_polls_there_is_no_position():
    with pytest.raises(ValueError):
        reconstruct_track([], [])
