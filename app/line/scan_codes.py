"""Meaning of a scan, without prefixes of scanners and GS1; and detection of a mistyped serial.

Sources: AIM symbology identifiers (ISO/IEC 15424: `]`, a letter, a modifier); GS1 General Specifications, section 3
(application identifiers 01, 10, 21 and the dates), section 7.8 (FNC1 as ASCII 29 between fields of variable length).
"""

import re
from collections.abc import Set
from dataclasses import dataclass

from softcal.core.errors import InputError
from softcal.core.lot import Lot
from softcal.core.quality.line_rules import LineRules
from softcal.db.registry import Registry
from softcal.db.repositories.lot_pages import UnitFilter

SEPARATOR = "\x1d"
AIM_PREFIX = re.compile(r"^\][A-Za-z][0-9A-Za-z]")
GS1_AIM = ("]C1", "]d2", "]Q3", "]e0", "]J1")
PRINTED_FIELD = re.compile(r"\((\d{2,4})\)([^(]*)")
FIXED_LENGTH = {"00": 18, "01": 14, "02": 14, "11": 6, "12": 6, "13": 6, "15": 6, "16": 6, "17": 6, "20": 2}
SERIAL_FIELD, LOT_FIELD = "21", "10"
COMMANDS = ("START", "STOP", "REPEAT", "OK", "CANCEL")


@dataclass(frozen=True)
class Scan:
    """A parsed scan.

    Args:
        kind: serial, golden (the serial of a golden unit), lot, badge, command, or unreadable.
        value: the serial as scanned, the lot's id, the operator's name, the command.
        lot_id: lot of a GS1 label; "" without one.
    """

    kind: str
    value: str
    lot_id: str = ""


def read_scan(text: str) -> Scan:
    """Return the meaning of a scan."""
    raw = text.strip(" \t\r\n")
    prefix = AIM_PREFIX.match(raw)
    payload = raw[prefix.end() :] if prefix else raw
    is_gs1 = SEPARATOR in payload or bool(PRINTED_FIELD.match(payload)) or bool(prefix and prefix.group() in GS1_AIM)
    if not is_gs1:
        text = "".join(letter for letter in payload if letter.isprintable()).strip()
        head, colon, rest = text.partition(":")
        kind, value = head.strip().upper(), rest.strip()
        if not colon and text:
            return Scan("serial", text)
        if kind == "CMD" and value.upper() in COMMANDS:
            return Scan("command", value.upper())
        if colon and (kind == "BADGE" or (kind in ("LOT", "GOLDEN") and value)):
            return Scan(kind.lower(), value)
        return Scan("unreadable", text)
    fields, rest = dict(PRINTED_FIELD.findall(payload)), payload.lstrip(SEPARATOR)
    if not payload.startswith("("):
        fields = {}
        while rest:
            name, rest = rest[:2], rest[2:]
            length = FIXED_LENGTH.get(name)
            fields[name], rest = (rest[:length], rest[length:]) if length else rest.partition(SEPARATOR)[::2]
            rest = rest.lstrip(SEPARATOR)
    serial, lot_id = fields.get(SERIAL_FIELD, "").strip(), fields.get(LOT_FIELD, "").strip()
    if serial:
        return Scan("serial", serial, lot_id)
    return Scan("lot", lot_id) if lot_id else Scan("unreadable", payload.replace(SEPARATOR, "|"))


def is_unfamiliar(registry: Registry, lot: Lot, rules: LineRules, serial: str, pressed_serials: Set[str]) -> bool:
    """Whether a person should be asked before a serial becomes a unit of a lot.

    Not for a unit that the lot knows. Where the lot's units were registered by name, for every
    other one. Else it must fit the lot's rule or, without one, look like the source or a unit
    pressed of late.
    """
    if lot.id in lots_of(registry, serial):
        return False
    # A unit that was registered and never recorded: the lot is planned by name
    waiting = registry.pages.unit_page(lot.id, UnitFilter(verdicts=("none",)), size=1).units
    if any(not registry.recordings.of_lot(lot.id, unit.serial) for unit in waiting):
        return True
    return not rules.serial_pattern and shape(serial) not in {shape(other) for other in {lot.source, *pressed_serials}}


def shape(serial: str) -> str:
    """Return a serial with every digit as 0: `EG-0017` looks like `EG-0000`."""
    return re.sub(r"\d", "0", serial)


def lots_of(registry: Registry, serial: str) -> set[str]:
    """Return the lots that have a serial."""
    try:
        return {unit.lot_id for unit in registry.lots.units(serial=serial)}
    except InputError:
        return set()


def channel_serial(serial: str, channel: int) -> str:
    """Return the serial of one of several units pressed at once; channels count from 0."""
    return f"{serial}-{channel + 1}"
