"""Trapezoidal motion profile, and the stage position over time from it and status polls. No I/O."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from softcal.core.recording import Array
from softcal.station.interfaces import StagePosition


@dataclass(frozen=True)
class Trapezoid:
    """Move from rest to rest: acceleration, constant speed if the move is long enough, braking."""

    start_mm: float
    end_mm: float
    speed_mm_s: float
    acceleration_mm_s2: float

    @cached_property
    def peak_mm_s(self) -> float:
        return float(min(self.speed_mm_s, np.sqrt(self.acceleration_mm_s2 * abs(self.end_mm - self.start_mm))))

    @cached_property
    def duration_s(self) -> float:
        if self.peak_mm_s == 0.0:
            return 0.0
        return float(abs(self.end_mm - self.start_mm) / self.peak_mm_s + self.peak_mm_s / self.acceleration_mm_s2)

    def position_mm(self, t_s: Array) -> Array:
        """Return positions at times since the start; outside the move those of its ends."""
        ramp_s = self.peak_mm_s / self.acceleration_mm_s2
        t = np.clip(t_s, 0.0, self.duration_s)
        remaining_s = self.duration_s - t
        braking = np.abs(self.end_mm - self.start_mm) - 0.5 * self.acceleration_mm_s2 * remaining_s**2
        travelled_mm = np.where(
            t < ramp_s,
            0.5 * self.acceleration_mm_s2 * t**2,
            np.where(remaining_s < ramp_s, braking, self.peak_mm_s * (t - 0.5 * ramp_s)),
        )
        return np.asarray(self.start_mm + np.sign(self.end_mm - self.start_mm) * travelled_mm)


@dataclass(frozen=True)
class DrivenMove:
    """One move of a run: the command, and the host times of its start and end."""

    path: Trapezoid
    begun_s: float
    confirmed_s: float


@dataclass(frozen=True)
class StageTrack:
    """Stage position against host time.

    Args:
        t_s: (m,) nodes, host clock.
        position_mm: (m,) position at the nodes; between them it is straight.
        residual_mm: root mean square of polls against the track.
    """

    t_s: Array
    position_mm: Array
    residual_mm: float

    def at(self, host_s: Array) -> Array:
        return np.interp(host_s, self.t_s, self.position_mm)


NODE_S = 0.002
"""Distance of the nodes in a move; a straight line between them is off by < a·NODE_S²/8."""


FOLLOWS_MM, OVERTAKEN_S = 0.1, 0.15
"""Polls further from the commanded path than this, for longer than this, say that the move did not go as commanded: a
line that a busy host or cable held back shows the stage behind its path, and the next line shows it there again."""


def reconstruct_track(polls: Sequence[StagePosition], moves: Sequence[DrivenMove]) -> StageTrack:
    """Return where the stage was at any time of a run.

    A controller answers ten polls a second at most, too few to draw a corner. So every move is the trapezoid it was
    commanded as, shifted in time to where its polls say it was. One with too few polls moves with its neighbours. A
    poll whose line came late says nothing. A move that did not go as commanded (the host came late with the next
    piece) is drawn through its polls.

    Raises:
        ValueError: no polls.
    """
    if not polls:
        raise ValueError("no status polls; the stage's position is not known")
    poll_s = np.array([poll.host_s for poll in polls])
    poll_mm = np.array([poll.position_mm for poll in polls])
    delays = [_delay_s(move, poll_s, poll_mm) for move in moves]
    measured = [delay for delay in delays if delay is not None]
    usual_s = float(np.median(measured)) if measured else 0.0
    # The clock of a track starts before its first poll and ends after its last one, at rest.
    t_s, position_mm = [poll_s[:1] - 1.0], [poll_mm[:1] if not moves else np.array([moves[0].path.start_mm])]
    for move, delay in zip(moves, delays, strict=True):
        start_s = max(move.begun_s + (usual_s if delay is None else delay), float(t_s[-1][-1]) + 1e-6)
        since_s = np.arange(0.0, move.path.duration_s + NODE_S, NODE_S)
        inside = (poll_s > move.begun_s) & (poll_s < move.confirmed_s) & (poll_s > t_s[-1][-1])
        if not _follows(move, start_s, poll_s[inside], poll_mm[inside]):
            begun_s = max(move.begun_s, float(t_s[-1][-1]))
            t_s.append(np.append(begun_s, poll_s[inside]))
            position_mm.append(np.append(position_mm[-1][-1], poll_mm[inside]))
            continue
        t_s.append(start_s + since_s)
        position_mm.append(move.path.position_mm(since_s))
    nodes_s, nodes_mm = np.concatenate(t_s), np.concatenate(position_mm)
    residual = poll_mm - np.interp(poll_s, nodes_s, nodes_mm)
    return StageTrack(nodes_s, nodes_mm, float(np.sqrt(np.mean(residual**2))))


def _follows(move: DrivenMove, start_s: float, poll_s: Array, poll_mm: Array) -> bool:
    """Whether the polls of a move are where its path was, but for lines that came late."""
    path = move.path
    behind_mm = (path.position_mm(poll_s - start_s) - poll_mm) * np.sign(path.end_mm - path.start_mm)
    if np.any(behind_mm < -FOLLOWS_MM):
        return False  # No line comes early.
    # The controller's word that the move is over is a line as well: then the stage was at the end.
    is_over = start_s + path.duration_s <= move.confirmed_s
    on_path_s = np.append(poll_s[behind_mm <= FOLLOWS_MM], move.confirmed_s if is_over else np.inf)
    off_s = poll_s[behind_mm > FOLLOWS_MM]
    return bool(np.all(on_path_s[np.searchsorted(on_path_s, off_s)] - off_s <= OVERTAKEN_S))


def _delay_s(move: DrivenMove, poll_s: Array, poll_mm: Array) -> float | None:
    """Return the delay from command to motion in s, from the polls on its flanks."""
    path = move.path
    inside = (poll_s > move.begun_s) & (poll_s < move.confirmed_s)
    travelled_mm = np.abs(poll_mm - path.start_mm)
    length = abs(path.end_mm - path.start_mm)
    ramp_mm = 0.5 * path.peak_mm_s**2 / path.acceleration_mm_s2
    cruising = inside & (travelled_mm > ramp_mm) & (travelled_mm < length - ramp_mm)
    if not cruising.any():
        return None
    ramp_s = path.peak_mm_s / path.acceleration_mm_s2
    planned_s = travelled_mm[cruising] / path.peak_mm_s + 0.5 * ramp_s
    begins_s = poll_s[cruising] - planned_s
    # Lines come late, never early.
    on_time = begins_s <= np.min(begins_s) + FOLLOWS_MM / path.peak_mm_s
    return float(np.median(begins_s[on_time])) - move.begun_s
