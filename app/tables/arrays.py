"""Named arrays of a binary file as a table: choice of the group, size limit, conversion of cells."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softcal.app.tables.headings import IsRequested, refuse_duplicates
from softcal.app.tables.options import TableOptions
from softcal.app.tables.table import Column, Table
from softcal.app.tables.time_column import is_clock_heading
from softcal.core.errors import InputError

MAX_ROUNDING = 0.01
"""Largest error of a whole number as float64, as a share of the column's median step."""


@dataclass(frozen=True, eq=False)
class Channel:
    """Metadata of one array of a file.

    Args:
        name: its heading.
        rows: number of its samples.
        read: returns the samples, (rows,).
        unit: its unit; "" where the file states none.
    """

    name: str
    rows: int
    read: Callable[[], NDArray[Any]]
    unit: str = ""


def unreadable_channel(name: str, refusal: str, rows: int = 0) -> Channel:
    """Return a channel that cannot be read; its error is raised on request."""

    def refuse() -> NDArray[Any]:
        raise InputError(refusal)

    return Channel(name, rows, refuse)


def choose_group(
    path: Path,
    groups: Mapping[str, Sequence[Channel]],
    options: TableOptions,
    is_requested: IsRequested,
    kind: str,
) -> str:
    """Return the requested group: the declared one, the only one, or the one with all requested names.

    Args:
        kind: the format's word for a group, such as "group" or "variable".

    Raises:
        InputError: no such group, none at all, or several and none declared.
    """
    names = ", ".join(repr(name) for name in list(groups)[:8]) + (", ..." if len(groups) > 8 else "")
    if options.sheet is not None:
        if options.sheet not in groups:
            contents = f"it has {names}" if groups else "it has none with samples"
            raise InputError(f"{path}: there is no {kind} {options.sheet!r}; {contents}; name one with --sheet")
        return options.sheet
    if not groups:
        raise InputError(f"{path}: there is no {kind} with columns of numbers in it; export the samples again")
    if is_requested is not None and len(groups) > 1:
        requested = {
            name: {each.name for each in channels if is_requested(each.name) and not is_clock_heading(each.name)}
            for name, channels in groups.items()
        }
        union = set().union(*requested.values())
        matches = [name for name, present in requested.items() if present == union]
        if union and not matches:
            where = ", ".join(
                f"{', '.join(map(repr, sorted(each)))} in {name!r}" for name, each in requested.items() if each
            )
            raise InputError(
                f"{path}: one recording is read from one {kind}, and the columns lie in several: {where}; write them "
                "to one, with one clock"
            )
        if len(matches) == 1:
            return matches[0]
    if len(groups) > 1:
        raise InputError(f"{path}: more than one {kind} holds samples: {names}; name one with --sheet")
    return next(iter(groups))


def read_channels(
    path: Path, channels: Sequence[Channel], options: TableOptions, is_requested: IsRequested, layout: str = ""
) -> Table:
    """Return the requested channels as a table; without a request the channels of the greatest length.

    Raises:
        InputError: a name twice, requested channels of unequal length, too many cells, or cells that are no column.
    """
    names = tuple(channel.name for channel in channels)
    refuse_duplicates(names, path, is_requested)
    requested = [channel for channel in channels if is_requested is None or is_requested(channel.name)]
    rows = max((channel.rows for channel in requested or channels), default=0)
    shorter = [f"{channel.name!r} ({channel.rows})" for channel in requested if channel.rows != rows]
    if shorter and is_requested is not None:
        raise InputError(
            f"{path}: {', '.join(shorter[:5])} samples where the other columns have {rows}; "
            "export channels of one sample rate together"
        )
    requested = [channel for channel in requested if channel.rows == rows]
    refuse_large(path, rows * len(requested), options.max_cells)
    columns = [Column(c.name.strip(), c.unit.strip(), column_cells(path, c.name, c.read())) for c in requested]
    remarks = (f"not read, as the other columns have {rows} samples: {', '.join(shorter[:8])}",) if shorter else ()
    return Table(path, tuple(columns), names, np.arange(1, rows + 1), layout, remarks)


def column_cells(path: Path, name: str, values: NDArray[Any]) -> NDArray[Any]:
    """Return an array (n,) as the cells of a column: float64, datetime64[ns], timedelta64[ns] or object.

    Raises:
        InputError: complex numbers, records, or whole numbers that float64 cannot tell apart.
    """
    kind = values.dtype.kind
    if kind in "fiu":
        return _floats(path, name, values)
    if kind == "M":
        return values.astype("datetime64[ns]")
    if kind == "m":
        return values.astype("timedelta64[ns]")
    if kind in "bOUS":
        return np.array([_text(value) for value in values.tolist()], dtype=object)
    content = "complex numbers" if kind == "c" else "records"
    cure = "export the real part or the magnitude" if kind == "c" else "export its parts as columns"
    raise InputError(f"{path}: column {name!r} holds {content} where numbers were expected; {cure}")


def _text(value: object) -> object:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value


def _floats(path: Path, name: str, values: NDArray[Any]) -> NDArray[np.float64]:
    floats = values.astype(np.float64)
    if values.dtype.kind == "f" or not len(values) or np.max(np.abs(floats)) <= 2.0**53:
        return floats
    steps = np.abs(np.diff(floats))
    step = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 0.0
    rounding = np.array([abs(int(a) - int(b)) for a, b in zip(values.tolist(), floats.tolist(), strict=True)], float)
    if float(np.median(rounding)) > MAX_ROUNDING * step:
        raise InputError(
            f"{path}: column {name!r} holds whole numbers above 2^53 ({values.max()}), whose steps are lost as "
            "floating point; subtract the first value before the export"
        )
    return floats


def refuse_large(path: Path, cells: int, max_cells: int) -> None:
    """Refuse a table with more cells than allowed."""
    if cells > max_cells:
        raise InputError(
            f"{path}: unpacks to about {cells / 1e6:.3g} million cells, more than {max_cells / 1e6:g} million; split "
            "it, or raise the limit of the import (most cells)"
        )
