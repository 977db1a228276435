"""Print the cells of a workbook as JSON, in a separate process, as a damaged file may crash its reader.

Nothing of softcal is imported here, so that it starts at once.
"""

import json
import sys
from contextlib import suppress
from datetime import date, datetime, time, timedelta
from io import BytesIO
from typing import Any

MAX_BYTES = 4_000_000_000
"""Memory of the process: a damaged file may ask for hundreds of GB."""

KINDS = {kind.__name__: kind for kind in (datetime, date, time)}


def main(max_cells: int) -> None:
    """Read a workbook from standard input; print {sheet: rows}, or the number of cells above the limit."""
    from python_calamine import CalamineWorkbook

    with suppress(ImportError, OSError, ValueError):
        import resource  # noqa: PLC0415

        resource.setrlimit(resource.RLIMIT_AS, (MAX_BYTES, MAX_BYTES))
    workbook = CalamineWorkbook.from_filelike(BytesIO(sys.stdin.buffer.read()))
    sheets = {name: workbook.get_sheet_by_name(name) for name in workbook.sheet_names}
    count = sum(sheet.total_height * sheet.total_width for sheet in sheets.values())
    rows = (
        {name: sheet.to_python(skip_empty_area=False) for name, sheet in sheets.items()} if count <= max_cells else {}
    )
    json.dump(rows or count, sys.stdout, default=_encode)


def _encode(cell: Any) -> dict[str, Any]:
    if isinstance(cell, timedelta):
        return {"timedelta": cell.total_seconds()}
    return {type(cell).__name__: cell.isoformat()}


def decode(stored: dict[str, Any]) -> Any:
    """Return a cell of a type that JSON lacks; other values unchanged (an `object_hook` of json)."""
    if len(stored) == 1:
        kind, value = next(iter(stored.items()))
        if kind in KINDS and isinstance(value, str):
            return KINDS[kind].fromisoformat(value)
        if kind == "timedelta" and isinstance(value, float):
            return timedelta(seconds=value)
    return stored


if __name__ == "__main__":
    main(int(sys.argv[1]))
