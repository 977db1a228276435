"""Whether a serial may be a slip of the hand: not planned, and like no unit of the lot."""

import re
from collections.abc import Set

from softcal.core.errors import InputError
from softcal.core.lot import Lot
from softcal.core.quality.line_rules import LineRules
from softcal.db.registry import Registry
from softcal.db.truth.lot_pages import UnitFilter


def is_unheard_of(registry: Registry, lot: Lot, rules: LineRules, serial: str, pressed: Set[str]) -> bool:
    """Whether a person should be asked before a serial becomes a unit of a lot.

    A unit that the lot knows is not asked for. Where the lot's units were registered by name, every other one is. Else
    it must fit the lot's rule or, where nobody set one, look like the source or like a unit pressed of late.
    """
    if lot.id in lots_of(registry, serial):
        return False
    # A unit that was registered and never recorded: the lot is planned by name
    waiting = registry.pages.unit_page(lot.id, UnitFilter(verdicts=("none",)), size=1).units
    if any(not registry.recordings.of_lot(lot.id, unit.serial) for unit in waiting):
        return True
    return not rules.serial_pattern and shape(serial) not in {shape(known) for known in {lot.source, *pressed}}


def shape(serial: str) -> str:
    """Return a serial with every digit as 0: `EG-0017` looks like `EG-0000`."""
    return re.sub(r"\d", "0", serial)


def lots_of(registry: Registry, serial: str) -> set[str]:
    """Return the lots that a serial stands in."""
    try:
        return {unit.lot_id for unit in registry.lots.units(serial=serial)}
    except InputError:
        return set()


def numbered(serial: str, channel: int) -> str:
    """Return the serial of one of several units pressed at once; channels count from 0."""
    return f"{serial}-{channel + 1}"
