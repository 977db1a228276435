"""Time of measurement of a recording: from its absolute stamps, else as stated."""

from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path

from softcal.app.files.recording_file import FileRecording
from softcal.app.tables.timestamps import Start
from softcal.core.errors import InputError
from softcal.db.entries import INSTANTS_AGREE

EARLIEST_YEAR = 1970


def parse_instant(name: str, text: str) -> datetime:
    """Return a date, or a date and time, as UTC; without a zone it is local time, and a date is midnight.

    Args:
        name: what states it, for the message.
        text: ISO 8601.

    Raises:
        InputError: invalid, or in the future.
    """
    expected = "an ISO date or date and time was expected, such as 2026-01-31 or 2026-01-31T14:30+01:00"
    try:
        at = datetime.fromisoformat(text).astimezone(UTC)
    except (ValueError, OverflowError) as error:
        raise InputError(f"{name} is {text!r}; {expected}") from error
    if at.year < EARLIEST_YEAR:
        raise InputError(f"{name} is {text!r}, before any recording; {expected}")
    if at > datetime.now(UTC):
        raise InputError(f"{name} is {text!r}, in the future; state when the recording was measured")
    return at


def measured_at(file: FileRecording, declared: datetime | None = None) -> datetime | None:
    """Return the time of measurement, UTC: by the recording's stamps, else as stated, else None.

    Raises:
        InputError: its stamps lie in the future, or contradict the stated time, by more than a day.
    """
    if file.start is None:
        return declared
    at, cure = file.start.at, "correct the one that is wrong, or leave out the column of time and state the sample rate"
    description = f"{file.table.path}: the stamps begin at {at:%Y-%m-%d %H:%M:%S} UTC"
    if at > datetime.now(UTC) + INSTANTS_AGREE:
        raise InputError(f"{description}, in the future; {cure}")
    if declared is not None and abs(at - declared) > INSTANTS_AGREE:
        raise InputError(f"{description}, stated was {declared:%Y-%m-%d %H:%M:%S} UTC; {cure}")
    return at


def measured_at_row(file: FileRecording, row: int) -> datetime | None:
    """Return the time of a table's row by its stamps, UTC; None for stamps that are not absolute."""
    if (at := measured_at(file)) is None:
        return None
    t_s = file.t_s[file.rows]
    later = t_s[file.rows >= row]
    return at + timedelta(seconds=float(later[0] - t_s[0])) if len(later) else at


def local_time_remarks(starts: Mapping[Path, Start | None]) -> tuple[str, ...]:
    """Return one remark on the files whose stamps state no zone, or an empty list."""
    names = [path.name for path, start in starts.items() if start is not None and start.is_local]
    if not names:
        return ()
    listed = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
    zone = f"{datetime.now().astimezone():%z}"
    return (f"{listed}: stamps without a zone are taken as local time of this computer (UTC{zone[:3]}:{zone[3:]})",)
