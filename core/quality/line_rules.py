"""What a line decides about a lot: how its serials look, how many units are planned, and who may be pressed again."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from softcal.core.errors import InputError
from softcal.core.lot import Lot
from softcal.core.messages.reason import reason
from softcal.core.quality.known_loads import MAX_LOADS, KnownLoad

LETTERS = ("as scanned", "upper", "lower")
RETESTS: Mapping[str, int] = {"pass": 1, "conditional": 1, "fail": 1, "retest": 3}
"""After which verdict a unit may be pressed again how often, until somebody decides otherwise."""


@dataclass(frozen=True)
class LineRules:
    """Rules of one lot, kept in versions in the registry.

    Args:
        serial_pattern: regular expression that a whole serial of this lot matches; "" takes any serial.
        letters: `upper` or `lower` turn what was scanned; scanners turn it round when caps lock is on.
        target: units that are planned; None: nobody said.
        retests: verdict → how often a unit may be pressed again after it, over its whole life in this lot.
        loads: known loads that are read on each unit after its run, in this order; given as kept, pairs of numbers.
        is_badge_needed: whether nothing is pressed until somebody has scanned a badge or signed in.
    """

    serial_pattern: str = ""
    letters: str = "as scanned"
    target: int | None = None
    retests: Mapping[str, int] = field(default_factory=lambda: dict(RETESTS))
    loads: tuple[KnownLoad, ...] = ()
    is_badge_needed: bool = False

    def __post_init__(self) -> None:
        loads = tuple(load if isinstance(load, KnownLoad) else KnownLoad(*load) for load in self.loads)
        object.__setattr__(self, "loads", loads)
        if len(loads) > MAX_LOADS:
            raise InputError(reason("load.too_many", count=len(loads), most=MAX_LOADS))
        if len({load.value for load in loads}) < len(loads):
            raise InputError(reason("load.twice", value=loads[0].value))
        try:
            re.compile(self.serial_pattern)
        except re.error as error:
            raise InputError(f"serial pattern {self.serial_pattern!r} is no regular expression: {error}") from error
        if self.letters not in LETTERS:
            raise InputError(f"letters {self.letters!r} is none of {', '.join(LETTERS)}")
        if self.target is not None and self.target < 1:
            raise InputError(f"target {self.target}; at least one unit was expected")
        for verdict, times in self.retests.items():
            if verdict not in RETESTS or not 0 <= times <= 99:
                raise InputError(f"retests {verdict}={times}; 0 to 99 after one of {', '.join(RETESTS)} was expected")

    def spell(self, scanned: str) -> str:
        return {"upper": scanned.upper(), "lower": scanned.lower()}.get(self.letters, scanned)

    def fits(self, serial: str) -> bool:
        """Whether a serial may belong to this lot."""
        return not self.serial_pattern or re.fullmatch(self.serial_pattern, serial) is not None

    def remaining_retests(self, verdict: str, tests: int) -> int:
        """Return how often a unit may still be pressed again after so many tests and its newest verdict."""
        return max(0, self.retests.get(verdict, 0) - max(0, tests - 1))

    def settings(self) -> dict[str, object]:
        loads = [[load.value, load.expanded] for load in self.loads]
        return {**vars(self), "retests": dict(self.retests), "loads": loads}


def rules_for(lot: Lot) -> LineRules:
    """Return the rules of a lot for which nobody has set any: its serials are spelled as its source's is."""
    source = lot.source
    letters = "upper" if source == source.upper() else "lower" if source == source.lower() else "as scanned"
    return LineRules(letters=letters)
