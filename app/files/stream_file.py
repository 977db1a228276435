"""Long streams on disk in pieces: `t_s, output` as input, estimates as output."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from softcal.app.files.atomic import atomic_file
from softcal.app.files.recording_file import NO_TIME, PLAIN, ColumnNames, check_rate, detect_time_column, find_clock
from softcal.app.tables.read import PARQUET, TEXT, table_pieces
from softcal.app.tables.text_layout import HEAD_LINES
from softcal.app.tables.timestamps import Clock
from softcal.core.errors import InputError
from softcal.core.recording import Array
from softcal.core.unit.estimate import Estimate
from softcal.core.windows import TAPS

if TYPE_CHECKING:
    from pyarrow.parquet import ParquetWriter

COLUMNS = ("t_s", "estimate", "lower", "upper", "flag")
"""Of a file of estimates."""

HEADER = f"{','.join(COLUMNS)}\n"
"""First line of such a file as CSV."""

PIECE = 1024
"""Rows estimated and written at once."""

PIECES_AT_ONCE = 32
"""Pieces of a text file that are read at once."""


class Stream:
    """A long recording, read piece by piece.

    Args:
        path: text files are read a piece at a time, others at once.
        is_resumed: it goes on where another one ended, which takes a column of time.
    """

    def __init__(self, path: Path, names: ColumnNames = PLAIN, *, is_resumed: bool = False) -> None:
        self._path, self._names, self._is_resumed = path, names, is_resumed
        self.layout = ""
        self.remarks: list[str] = []

    def pieces(self) -> Iterator[tuple[Array, Array]]:
        """Yield `t_s` and `output` in pieces, every row of the file; NaN for an empty cell.

        Raises:
            InputError: no such file or columns, a text for a number, time that goes back, or fewer rows than a window.
        """
        rows, path, names = 0, self._path, self._find_names()
        clock: Clock | None = None
        for table in table_pieces(path, names.table, names.is_requested, PIECES_AT_ONCE * PIECE):
            if not rows:
                table.column(names.output)
                clock, self.layout = find_clock(table, names, names.rate_Hz), table.layout
                if clock is None and self._is_resumed:
                    raise InputError(
                        f"{path}: --resume goes on in time; name the column of the time with --time-column"
                    )
                if clock is None and not names.rate_Hz:
                    raise InputError(f"{path}: {NO_TIME}; the file has: {', '.join(table.names[:12])}")
            self.remarks += [remark for remark in table.remarks if remark not in self.remarks]
            output = table.numbers(names.output)
            stamps = (rows + np.arange(len(output))) / (names.rate_Hz or 1.0)
            t_s = stamps if clock is None else clock.seconds(table, ", or give the sample rate")
            rows += len(output)
            # A first piece this short is the whole file.
            if rows < TAPS:
                raise InputError(f"{path}: {rows} rows; at least {TAPS} are needed to fill one window")
            if clock is not None and names.rate_Hz and rows == len(output):
                check_rate(path, t_s, names.rate_Hz)
            for start in range(0, len(output), PIECE):
                yield t_s[start : start + PIECE], output[start : start + PIECE]
        self.remarks += [] if clock is None else clock.remarks

    def _find_names(self) -> ColumnNames:
        """Return the column names with the time column, which the first piece decides without a heading."""
        names = self._names
        if names.time is not None:
            return names
        head = next(table_pieces(self._path, names.table, names.is_requested, HEAD_LINES))
        time, remark = detect_time_column(head, names, names.is_requested)
        self.remarks += [remark] if time else []
        return names if time is None else replace(names, time=time)


def count_rows(path: Path) -> int:
    """Return the approximate number of rows of a file; 0 if only reading it would tell."""
    suffix = path.suffix.lower()
    if suffix in PARQUET:
        from pyarrow.lib import ArrowInvalid
        from pyarrow.parquet import read_metadata

        with suppress(ArrowInvalid, OSError):
            return int(read_metadata(path).num_rows)
    elif suffix in TEXT and path.is_file():
        with path.open("rb") as file:
            return max(0, sum(block.count(b"\n") for block in iter(lambda: file.read(1 << 20), b"")) - 1)
    return 0


@contextmanager
def estimate_writer(path: Path) -> Iterator[Callable[[Estimate], None]]:
    """Yield a writer of estimates in pieces; `path` appears if the block succeeds."""
    import pandas as pd

    is_parquet, is_first = path.suffix.lower() in PARQUET, True
    with atomic_file(path) as part, ExitStack() as stack:
        parquet: ParquetWriter | None = None

        def write(rows: Estimate) -> None:
            nonlocal parquet, is_first
            columns: dict[str, Any] = {name: getattr(rows, name) for name in COLUMNS[:-1]}
            if is_parquet:
                import pyarrow as pa
                from pyarrow.parquet import ParquetWriter

                table = pa.table(columns | {"flag": rows.flag.astype(str)})
                parquet = parquet or stack.enter_context(ParquetWriter(part, table.schema))
                parquet.write_table(table)
                return
            with part.open("a", encoding="utf-8", newline="") as file:
                table = pd.DataFrame(columns | {"flag": rows.flag})
                table.to_csv(file, header=is_first, index=False, lineterminator="\n")
            is_first = False

        yield write
