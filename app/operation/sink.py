"""Where live estimates go, line by line: a file, standard output, or a socket."""

import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TextIO
from urllib.parse import urlsplit

import pandas as pd

from softcal.app.files.stream_file import COLUMNS, HEADER
from softcal.app.output import echo, stream_of_standard_output
from softcal.core.errors import InputError
from softcal.core.unit.estimate import Estimate

RETRY_S = 1.0
"""Seconds between two tries to reach a listener that is gone."""


class Sink(Protocol):
    """Takes whole lines."""

    def write(self, lines: str) -> None: ...


@dataclass(frozen=True)
class ExistingRows:
    """What stands in a target already: so many rows, the first of this time; "" without one."""

    rows: int = 0
    first_t_s: str = ""


def read_existing(target: str) -> ExistingRows:
    """Return what a file to go on with holds, without a line that was left unfinished.

    Raises:
        InputError: the file holds no estimates.
    """
    path = Path(target)
    if target == "-" or target.startswith("tcp://") or not path.exists():
        return ExistingRows()
    with path.open("r+b") as file:
        header = file.readline()
        if header and header.decode("utf-8", "replace") != HEADER:
            raise InputError(f"{path}: holds no estimates of this program; name another file")
        first, rows, end = b"", 0, len(header)
        for line in file:
            if not line.endswith(b"\n"):
                file.truncate(end)
                break
            first = first or line
            rows, end = rows + 1, end + len(line)
    return ExistingRows(rows, first.decode().partition(",")[0])


def lines_of(rows: Estimate) -> str:
    """Return rows as CSV lines; what is not a number stays empty."""
    table = pd.DataFrame({name: getattr(rows, name) for name in COLUMNS})
    return str(table.to_csv(header=False, index=False, lineterminator="\n"))


@contextmanager
def open_sink(target: str, append: bool) -> Iterator[Sink]:
    """Open `-`, `tcp://HOST:PORT`, or a CSV file.

    Args:
        append: go on with an existing file; otherwise it must not exist yet.

    Raises:
        InputError: the file exists or cannot be written, or nobody listens at the address.
    """
    if target == "-":
        output = stream_of_standard_output()
        output.write(HEADER)
        yield _FlushingFile(output)
        return
    if target.startswith("tcp://"):
        with _Listener(target) as listener:
            yield listener
        return
    path = Path(target)
    if path.suffix.lower() != ".csv":
        raise InputError(f"{path}: live estimates go to a .csv file, - or tcp://HOST:PORT")
    is_new = not path.exists() or path.stat().st_size == 0
    if not is_new and not append:
        raise InputError(f"{path}: exists already; name another file, or go on with it by --resume")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a", encoding="utf-8", newline="\n") as file:
            if is_new:
                file.write(HEADER)
            yield _FlushingFile(file)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}; whole lines written so far are kept") from error


class _FlushingFile:
    def __init__(self, file: TextIO) -> None:
        self._file = file

    def write(self, lines: str) -> None:
        self._file.write(lines)
        self._file.flush()


class _Listener:
    """A socket somebody listens at; while nobody does, rows are lost and counted."""

    def __init__(self, target: str) -> None:
        parts = urlsplit(target)
        try:
            self._address = (parts.hostname or "", parts.port or 0)
        except ValueError:
            self._address = ("", 0)
        if not all(self._address):
            raise InputError(f"{target}: tcp://HOST:PORT was expected")
        self._socket = self._connect()
        if self._socket is None:
            raise InputError(f"{target}: nobody listens there; start the listener first")
        self._last_attempt_s, self._dropped_rows = time.monotonic(), 0

    def __enter__(self) -> "_Listener":
        return self

    def __exit__(self, *exception: object) -> None:
        if self._socket is not None:
            self._socket.close()

    def write(self, lines: str) -> None:
        if self._socket is None and time.monotonic() - self._last_attempt_s >= RETRY_S:
            self._socket, self._last_attempt_s = self._connect(), time.monotonic()
            if self._socket is not None:
                echo(f"listener is back; {self._dropped_rows} rows were lost")
                self._dropped_rows = 0
        if self._socket is not None:
            try:
                self._socket.sendall(lines.encode())
                return
            except OSError:
                echo("listener is gone; estimates go on, rows are lost until it is back")
                self._socket.close()
                self._socket = None
        self._dropped_rows += lines.count("\n")

    def _connect(self) -> socket.socket | None:
        try:
            connection = socket.create_connection(self._address, timeout=RETRY_S)
            connection.sendall(HEADER.encode())
        except OSError:
            return None
        return connection
