"""Loadstar DI-100 and DI-1000 load cell interfaces ("DI-100U / DI-1000U Command Set", loadstarsensors.com). No I/O."""

from softcal.core.errors import BadReply
from softcal.core.words.reason import reason
from softcal.station.wire.frames.force_unit import in_newtons

END = b"\r"
PING, MODEL, UNITS, STREAM = b"\r", b"MODEL\r", b"UNITS\r", b"WC\r"
READY = b"A"
"""The answer to an empty command, which ends a stream as well."""

KNOWN_MODELS = (b"DI-100", b"DI-1000")


def parse_N(line: bytes, unit: str) -> float:
    """Return a streamed value such as `-0.000456` in N; `BadReply`: cut, noise, or `E` for error."""
    try:
        return in_newtons(float(line.decode("ascii").strip()), unit)
    except ValueError as error:
        raise BadReply(reason("loadstar.line", line=repr(line[:40]))) from error


def parse_unit(line: bytes) -> str:
    """Return the unit that `UNITS` reports; `BadReply` where it is not one of force."""
    unit = line.decode("ascii", "replace").strip()
    in_newtons(1.0, unit)
    return unit
