"""Admission of moves: one rule for all controllers, checked before a byte is written."""

from softcal.core.errors import CommandRefused
from softcal.core.messages.reason import Reason, reason
from softcal.station.interfaces import Move, Stage

SPEED_ROUNDING = 1e-6
"""Relative; a controller tells its greatest speed in units of its own."""


def admit(stage: Stage, move: Move, slowest_mm_s: float = 0.0) -> None:
    """Raise `CommandRefused` for a move that may not begin; the controller's least speed is `slowest_mm_s`."""
    if not stage.is_position_known:
        raise CommandRefused(Reason("rig.not_homed"))
    if stage.is_moving:
        raise CommandRefused(Reason("rig.moving"))
    if not 0.0 <= move.to_mm <= stage.travel_mm:
        raise CommandRefused(reason("rig.outside.travel", to_mm=move.to_mm, travel_mm=stage.travel_mm))
    fastest_mm_s = stage.max_speed_mm_s
    if not slowest_mm_s <= move.speed_mm_s <= fastest_mm_s * (1 + SPEED_ROUNDING) or move.speed_mm_s == 0.0:
        bounds = f"[{slowest_mm_s:.3g}, {fastest_mm_s:g}]" if slowest_mm_s else f"(0, {fastest_mm_s:g}]"
        raise CommandRefused(reason("rig.outside.speed", speed_mm_s=move.speed_mm_s, bounds=bounds))
