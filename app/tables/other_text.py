"""Texts that are no tables of samples, with their format: frames of a CAN bus, JSON."""

import json
import re
from collections.abc import Sequence
from pathlib import Path

from softcal.core.errors import InputError

HEAD_LINES = 40
"""Lines that show what a text is."""

CAN_FRAME = re.compile(
    r"\s*(?:\(\d+\.\d+\)\s+)?[A-Za-z]\w*\s+[0-9A-Fa-f]{3,8}"
    r"(?:##?[0-9A-Fa-fR]*|\s+\[\d{1,2}\](?:\s+[0-9A-Fa-f]{2})*.*)(?:\s[RT])?\s*"
)
"""A line of candump: of its log, `can0 123#0F`, or of its screen, `can0 123 [1] 0F`; a time may stand before it."""

VECTOR_HEADER = re.compile(r"base\s+(?:hex|dec)\s+timestamps\s+(?:absolute|relative)\s*")
"""A line above the frames of Vector's .asc."""

CAN_CURE = (
    "frames of a CAN bus, whose bytes are no samples; decode it with the DBC file of the bus into a CSV with a column "
    "for each signal (asammdf, cantools, CANalyzer)"
)


def refuse_other_text(lines: Sequence[str], path: Path) -> None:
    """Refuse a text that is no table, with its format and a way to convert it."""
    head = [line for line in lines if line.strip()][:HEAD_LINES]
    if sum(CAN_FRAME.fullmatch(line) is not None for line in head) > len(head) / 2:
        raise InputError(f"{path}: a log of candump: {CAN_CURE}")
    if any(VECTOR_HEADER.fullmatch(line) for line in head):
        raise InputError(f"{path}: a log of Vector's tools: {CAN_CURE}")
    if sum(map(_is_json, head)) > len(head) / 2:
        format_name, option = ("JSON lines, an object a sample", ", lines=True") if len(head) > 1 else ("JSON", "")
    elif head and re.match(r"\s*[\[{]\s*(?:[\"\[{]|$)", head[0]) and not _is_json(head[0]):
        format_name, option = "JSON", ""
    else:
        return
    raise InputError(
        f"{path}: {format_name}, no table; write one of it, with a column a quantity, as "
        f"pandas.read_json({path.name!r}{option}).to_csv({f'{path.stem}.csv'!r}, index=False)"
    )


def _is_json(line: str) -> bool:
    if not line.lstrip().startswith(("{", "[")):
        return False
    try:
        json.loads(line.rstrip().rstrip(","))
    except ValueError:
        return False
    return True
