"""Header of a LabVIEW .lvm file: end of its headers, and step of its time."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from softcal.app.tables.numbers import to_numbers
from softcal.app.tables.table import Column
from softcal.core.errors import InputError

HEADER_END = "***End_of_Header***"
TIME = "X_Value"
"""How LabVIEW names each column of time."""

HEADER_TIME = "t_s"
"""Name of the column of the time that the header states."""


@dataclass(frozen=True)
class HeaderClock:
    """Time of the samples that a header states: the first one's and the step, both in s."""

    start_s: float
    step_s: float

    def column(self, rows: int, first: int) -> Column:
        """Return the times of a number of rows, given the number of rows before them."""
        return Column(HEADER_TIME, "s", self.start_s + self.step_s * np.arange(first, first + rows))

    def __str__(self) -> str:
        return f"time from X0 {self.start_s:g} s and Delta_X {self.step_s:g} s"


def header_ends(lines: Sequence[str]) -> list[int]:
    """Return which lines end a header: that of the file, then those of its segments."""
    return [k for k, line in enumerate(lines) if line.rstrip("\t;, ") == HEADER_END]


def find_header_clock(header: Sequence[Sequence[str]], decimal: str, path: Path) -> HeaderClock | None:
    """Return the clock that the cells of a header state, or None.

    Raises:
        InputError: its channels have different steps or starts.
    """
    cells = {row[0]: [cell for cell in row[1:] if cell] for row in header if row}
    if cells.get("X_Dimension", ["Time"])[:1] != ["Time"]:
        return None
    declared = {name: to_numbers(np.array(cells.get(name, []), dtype=object), decimal) for name in ("X0", "Delta_X")}
    starts, steps = (set() if values is None else set(values.tolist()) for values in declared.values())
    if not steps or min(steps) <= 0:
        return None
    for name, values in (("X0", starts), ("Delta_X", steps)):
        if len(values) > 1:
            different = ", ".join(f"{value:g}" for value in sorted(values, reverse=True)[:4])
            raise InputError(
                f"{path}: {name} of its channels is {different} and there is no column {TIME!r}; export channels of "
                "one clock together, or with their X values"
            )
    return HeaderClock(min(starts, default=0.0), min(steps))


def refuse_segments(lines: Sequence[str], path: Path) -> None:
    """Refuse several segments with a stated clock, because the start of the later segments is unknown."""
    if header_ends(lines):
        raise InputError(
            f"{path}: it has several segments and no column {TIME!r}, so their gaps are not stated; save it with X "
            "values (one column), or a file for each segment"
        )
