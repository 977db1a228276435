"""Text lines of a readout or a load-cell amplifier: `ms,value[,value ...][*checksum]`. No I/O here.

The checksum is optional and follows NMEA 0183: the exclusive-or of all bytes before the star, as two hex digits.
Without it a lost byte can turn 1012 into 112 and nobody can tell; the readout sketch of this project sends it.
"""

import re
from functools import reduce
from operator import xor
from typing import NamedTuple

from softcal.core.errors import BadReply
from softcal.core.messages.reason import reason

_NUMBERS = re.compile(rb"\d+(,-?\d+)+")
"""int() alone would take "1_0", " 7" and "+7"."""


class StreamLine(NamedTuple):
    """One line: the device's milliseconds (0 ... 2**32 - 1) and an integer per channel."""

    device_ms: int
    counts: tuple[int, ...]


def parse(line: bytes) -> StreamLine:
    """Return the content of a line; raise `BadReply` for a truncated line, a banner, noise, or a wrong checksum."""
    content, star, checksum = line.partition(b"*")
    if star and checksum.upper() != _checksum(content):
        raise BadReply(reason("stream.checksum", line=repr(line[:40]), checksum=_checksum(content).decode()))
    if not _NUMBERS.fullmatch(content):
        raise BadReply(reason("stream.line", line=repr(line[:40])))
    device_ms, *counts = map(int, content.split(b","))
    if device_ms >= 2**32:
        raise BadReply(reason("stream.time", device_ms=device_ms))
    return StreamLine(device_ms, tuple(counts))


def format_line(line: StreamLine, has_checksum: bool = True) -> bytes:
    """Return the line in the device's format."""
    content = ",".join(map(str, (line.device_ms, *line.counts))).encode()
    return content + (b"*" + _checksum(content) if has_checksum else b"") + b"\r\n"


def _checksum(content: bytes) -> bytes:
    return b"%02X" % reduce(xor, content, 0)
