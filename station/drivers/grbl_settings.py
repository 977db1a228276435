"""Settings of a GRBL controller: drive, usability, and settings that disable safety functions."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from softcal.core.errors import BadReply, CommandRefused
from softcal.core.messages.reason import Reason, reason, several
from softcal.station.wire.frames import grbl
from softcal.station.wire.link import Link

ANSWER_S = 2.0

SETTLE_S = 0.05
"""A controller that greets in several lines may still be talking."""

INCHES, HOMING = 13, 22
SPEED, ACCELERATION, TRAVEL = 110, 120, 130
"""Numbers of the settings of the first axis; those of the next two follow."""

SLOW_MM_S2 = 50.0
"""A drive that brakes with less than this makes every safe speed small."""

SAFE: tuple[tuple[int, Callable[[float], bool], Reason], ...] = (
    (1, lambda value: value == 255, Reason("grbl.safe.1")),
    (20, lambda value: value == 1, Reason("grbl.safe.20")),
    (21, lambda value: value == 1, Reason("grbl.safe.21")),
    (ACCELERATION, lambda value: value >= SLOW_MM_S2, Reason("grbl.safe.acceleration")),
)
"""Settings of a controller, what is safe, and the command that mends it."""


@dataclass(frozen=True)
class GrblSettings:
    """The settings of a controller, as they concern one axis.

    Args:
        values: by number, as `$$` lists them.
        index: of the axis, 0 for X.
    """

    values: Mapping[int, float]
    index: int

    @property
    def drive(self) -> tuple[float, float, float]:
        """Return the axis's travel in mm, largest speed in mm/s, and acceleration in mm/s²."""
        of_axis = (self.values[first + self.index] for first in (TRAVEL, SPEED, ACCELERATION))
        travel_mm, speed_mm_min, acceleration_mm_s2 = of_axis
        return travel_mm, speed_mm_min / 60.0, acceleration_mm_s2

    def list_unsafe(self) -> list[tuple[str, Reason]]:
        """Return each unsafe setting as `$n=value` with its correction."""
        problems = []
        for number, is_safe, cure in SAFE:
            number_of_axis = number + (self.index if number == ACCELERATION else 0)
            value = self.values.get(number_of_axis)
            if value is not None and not is_safe(value):
                problems.append((f"${number_of_axis}={value:g}", replace(cure, values={"number": number_of_axis})))
        return problems


def read_settings(link: Link, index: int) -> GrblSettings:
    """Ask a controller for its settings.

    Raises:
        BadReply: the settings lack a value of this axis.
        CommandRefused: it cannot be used so; what else takes safety away is said with it.
    """
    link.clock.sleep_s(SETTLE_S)
    link.discard()
    link.write(grbl.SETTINGS)
    values: dict[int, float] = {}
    reply: grbl.Reply = grbl.GrblNote("")
    while not isinstance(reply, grbl.Ok):
        reply = grbl.parse(link.next_line(ANSWER_S).text)
        if isinstance(reply, grbl.Setting):
            values[reply.number] = reply.value
    if missing := [f"${first + index}" for first in (SPEED, ACCELERATION, TRAVEL) if first + index not in values]:
        raise BadReply(reason("grbl.settings", missing=", ".join(missing)))
    settings = GrblSettings(values, index)
    refused = [Reason("grbl.homing_off")] if not values.get(HOMING) else []
    refused += [Reason("grbl.inches")] if values.get(INCHES) else []
    if refused:
        # The settings are sent once: everything that is wrong with them is said at once.
        advice = [reason("grbl.setting", setting=problem, cure=cure) for problem, cure in settings.list_unsafe()]
        raise CommandRefused(several([*refused, *advice]))
    return settings
