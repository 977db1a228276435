"""Intel HEX: bytes at an address as text a production programmer merges into its flashing step (Intel, 1988)."""

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
