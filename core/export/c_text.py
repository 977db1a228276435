"""Calibration files as C headers, word arrays for the runtime, and as Intel HEX."""

import struct

from softcal.core.export.blob import NetworkFile, UnitFile, serial_field
from softcal.core.lot import escape_serial

WORDS_PER_LINE = 8
TABLE = """#ifndef SS_TABLE
#if defined(__AVR__) && !defined(SS_IN_RAM)
#include <avr/pgmspace.h>
#define SS_TABLE PROGMEM /* in flash, where softsensor.h reads it on an AVR */
#else
#define SS_TABLE
#endif
#endif
"""


def network_header(file: NetworkFile) -> str:
    """Return `network_<id>.h`: the network file as an array, with macros for one network."""
    name = f"ss_network_{file.id.hex()}"
    sizes = "-".join(map(str, file.network.sizes))
    widest = max(size + -size % 4 for size in file.network.sizes[1:])
    about = f"Shared network {file.id.hex()} ({sizes}), trained on unit {file.source_serial}."
    return _header(
        name,
        about,
        file.to_bytes(),
        f"""
#ifndef SS_WIDTH
#define SS_WIDTH {max(16, widest)} /* the widest layer of this network */
#endif
#define SS_NETWORK {name}
#define SS_NETWORK_BYTES sizeof({name})
""",
    )


def unit_header(file: UnitFile) -> str:
    """Return `unit_<serial>.h`: the unit file as an array, its serial for the runtime, macros."""
    name = f"ss_unit_{c_name(file.serial)}"
    key = serial_field(file.serial).rstrip(b"\0").decode()
    about = f"Calibration of unit {file.serial}, revision {file.revision}, for network {file.network_id.hex()}."
    return _header(
        name,
        about,
        file.to_bytes(),
        f"""
static const char {name}_serial[] = "{key}";
#ifndef SS_UNIT
#define SS_UNIT {name}
#define SS_UNIT_BYTES sizeof({name})
#define SS_UNIT_SERIAL {name}_serial
#endif
""",
    )


IN_NAMES = {"_": "_u", "-": "_h", ".": "_d", "~": "_t"}
"""What a serial may hold beside letters and digits, in a C identifier."""


def c_name(serial: str) -> str:
    """Return a serial as the end of a C identifier; no two serials have the same."""
    return "".join(IN_NAMES.get(character, character) for character in escape_serial(serial))


def _header(name: str, about: str, content: bytes, rest: str) -> str:
    words = [f"0x{word:08x}u" for (word,) in struct.iter_unpack("<I", content)]
    lines = [", ".join(words[i : i + WORDS_PER_LINE]) for i in range(0, len(words), WORDS_PER_LINE)]
    body = ",\n  ".join(lines)
    guard = f"{name.upper()}_H"
    return (
        f"/* {about} Written by softcal export: do not edit. */\n#ifndef {guard}\n#define {guard}\n\n"
        f"#include <stdint.h>\n\n{TABLE}\n"
        f"static const uint32_t SS_TABLE {name}[{len(words)}] = {{\n  {body}}};\n{rest}\n#endif\n"
    )


RECORD_BYTES = 16
DATA, END, EXTENDED_LINEAR_ADDRESS = 0, 1, 4
ADDRESS_MAX = 2**32


def intel_hex(content: bytes, address: int) -> str:
    """Return the records for `content` at a 32-bit address, closed by an end record.

    Raises:
        ValueError: the content does not fit below 2^32, or the address is no multiple of 4.
    """
    if not 0 <= address <= ADDRESS_MAX - len(content) or address % 4:
        raise ValueError(f"{len(content)} bytes at 0x{address:x}: a multiple of 4 below 2^32 was expected")
    lines, upper = [], None
    position = 0
    while position < len(content):
        at = address + position
        if at >> 16 != upper:
            upper = at >> 16
            lines.append(_record(EXTENDED_LINEAR_ADDRESS, 0, upper.to_bytes(2, "big")))
        count = min(RECORD_BYTES, 0x10000 - (at & 0xFFFF), len(content) - position)
        lines.append(_record(DATA, at & 0xFFFF, content[position : position + count]))
        position += count
    return "\n".join([*lines, _record(END, 0, b"")]) + "\n"


def _record(kind: int, address: int, data: bytes) -> str:
    raw = bytes([len(data)]) + address.to_bytes(2, "big") + bytes([kind]) + data
    return f":{(raw + bytes([-sum(raw) & 0xFF])).hex().upper()}"
