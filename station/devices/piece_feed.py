"""Feeding of a move to a controller: length of each piece and its earliest time. No I/O."""

import math
from collections import deque

import numpy as np

from softcal.station.interfaces import Move
from softcal.station.trajectory import Trapezoid

PIECE_S, AHEAD_S, PIECES_AHEAD, MIN_PIECE_MM = 0.1, 0.3, 3, 0.001
"""A move is fed in pieces of PIECE_S, at most AHEAD_S and the time of braking ahead: when the host dies, the stage soon
stops by itself. A planner that sees less than its braking distance would never get up to speed. Where the way ahead is
bounded, so many pieces fit into it; none is shorter than MIN_PIECE_MM, which is less than a step of most drives."""


class PieceFeed:
    """The pieces of one move that were not sent yet.

    Args:
        ahead_mm: how far beyond the present position the controller may have commands.
    """

    def __init__(self, path: Trapezoid, ahead_mm: float, now_s: float) -> None:
        self._began_s = now_s
        peak_mm_s = max(path.peak_mm_s, 1e-9)
        piece_s = min(PIECE_S, max(MIN_PIECE_MM, ahead_mm / PIECES_AHEAD) / peak_mm_s)
        self._ahead_s = min(_ahead_s(path.peak_mm_s, path.acceleration_mm_s2), ahead_mm / peak_mm_s - piece_s)
        edges_s = np.linspace(0.0, path.duration_s, 1 + max(1, math.ceil(path.duration_s / piece_s)))
        ends_mm = [*path.position_mm(edges_s[1:-1]), path.end_mm]
        self._pieces = deque((float(s), float(mm)) for s, mm in zip(edges_s, ends_mm, strict=False))

    def __bool__(self) -> bool:
        return bool(self._pieces)

    def due_mm(self, now_s: float) -> float | None:
        """Return the end of the next piece in mm if it is due; None if it is too early, or no piece is left."""
        if not self._pieces:
            return None
        starts_s, ends_mm = self._pieces[0]
        return ends_mm if now_s - self._began_s - starts_s >= -self._ahead_s else None

    def mark_sent(self, now_s: float) -> None:
        starts_s, _ = self._pieces.popleft()
        # After a stall of the host the stage has paused; what follows must not run ahead of it.
        self._began_s += max(0.0, now_s - self._began_s - starts_s)


def runs_on_mm(move: Move, acceleration_mm_s2: float) -> float:
    """Return the longest way in mm that a stage fed in pieces continues after a loss of the host."""
    fed_s = _ahead_s(move.speed_mm_s, acceleration_mm_s2) + PIECE_S
    return min(move.ahead_mm, move.speed_mm_s * fed_s)


def runs_on_s(speed_mm_s: float, acceleration_mm_s2: float) -> float:
    """Return the longest time to rest, in s: the fed pieces and the braking time."""
    return _ahead_s(speed_mm_s, acceleration_mm_s2) + PIECE_S + speed_mm_s / acceleration_mm_s2


def _ahead_s(speed_mm_s: float, acceleration_mm_s2: float) -> float:
    return AHEAD_S + 0.5 * speed_mm_s / acceleration_mm_s2
