"""Units of force as gauges and indicators print them, in newtons."""

from softcal.core.errors import BadReply
from softcal.core.messages.reason import reason

STANDARD_GRAVITY = 9.80665
"""m/s², exact by definition: what turns a weight indicator's kilograms into newtons."""

NEWTONS = {
    "n": 1.0,
    "mn": 1e-3,
    "kn": 1e3,
    "kg": STANDARD_GRAVITY,
    "kgf": STANDARD_GRAVITY,
    "g": STANDARD_GRAVITY / 1000,
    "gf": STANDARD_GRAVITY / 1000,
    "lb": 0.45359237 * STANDARD_GRAVITY,
    "lbf": 0.45359237 * STANDARD_GRAVITY,
    "oz": 0.45359237 / 16 * STANDARD_GRAVITY,
    "ozf": 0.45359237 / 16 * STANDARD_GRAVITY,
}


def in_newtons(value: float, unit: str) -> float:
    """Return a force in N; `BadReply` where the unit is not one of force or weight."""
    factor = NEWTONS.get(unit.lower())
    if factor is None:
        raise BadReply(reason("rig.force_unit", unit=repr(unit)))
    return value * factor
