"""Which moves a stage may be given: the same rule for every controller, asked before a byte is written."""

from softcal.core.errors import CommandRefused
from softcal.station.interfaces import Move, Stage

SPEED_ROUNDING = 1e-6
"""Relative; a controller tells its greatest speed in units of its own."""


def admit(stage: Stage, move: Move, slowest_mm_s: float = 0.0) -> None:
    """Take a move as one that may begin.

    Args:
        stage: at rest, homed.
        move: where to, how fast.
        slowest_mm_s: that the controller can keep.

    Raises:
        CommandRefused: not homed, still moving, or beyond travel or speed; nothing was sent.
    """
    if not stage.is_position_known:
        raise CommandRefused("stage: not homed; nothing was sent, home it first")
    if stage.is_moving:
        raise CommandRefused("stage: the move before is not finished; nothing was sent")
    if not 0.0 <= move.to_mm <= stage.travel_mm:
        raise CommandRefused(f"stage: {move.to_mm:g} mm is outside [0, {stage.travel_mm:g}] mm; nothing was sent")
    fastest_mm_s = stage.max_speed_mm_s
    if not slowest_mm_s <= move.speed_mm_s <= fastest_mm_s * (1 + SPEED_ROUNDING) or move.speed_mm_s == 0.0:
        bounds = f"[{slowest_mm_s:.3g}, {fastest_mm_s:g}]" if slowest_mm_s else f"(0, {fastest_mm_s:g}]"
        raise CommandRefused(f"stage: {move.speed_mm_s:g} mm/s is outside {bounds} mm/s; nothing was sent")
