"""Spool of a run on disk: append-only lines with checksums, so that a power cut costs a second.

A line is `crc32 json`. The first one is the header, the last one of a finished run says how it ended; a spool without
an end is a run that was cut off, and counts as aborted.
"""

import json
import os
import queue
import threading
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from softcal.core.errors import DeviceError, InputError, reason_of
from softcal.core.json_input import parse_json
from softcal.core.messages.reason import Reason, plain, reason
from softcal.station.interfaces import Sample, StagePosition

SCHEMA = "softcal.spool/1"


@dataclass(frozen=True)
class SpooledRun:
    """Content of a spool file.

    Args:
        header: serial, profile and what else the run wrote first.
        output, force, polls: everything that was read, in order.
        metadata: metadata of the run at its end; empty for an interrupted run.
        end: "done", or why the run ended otherwise; "cut off" where nothing says so.
        damaged: lines whose checksum does not fit; what follows the first of them is not used.
    """

    header: dict[str, str]
    output: tuple[Sample, ...]
    force: tuple[Sample, ...]
    polls: tuple[StagePosition, ...]
    metadata: dict[str, Any]
    end: Reason
    damaged: int

    @property
    def is_complete(self) -> bool:
        return str(self.end) == str(Reason("spool.done")) and not self.damaged


class Spool:
    """Writer of a spool, which writes and syncs in a thread, so that a slow disk never delays the stage.

    Args:
        header: serial, profile, station, time: texts that say what this is.

    Raises:
        DeviceError: the file cannot be made; nothing has moved yet.
    """

    def __init__(self, path: Path, header: dict[str, str]) -> None:
        self.path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("ab")
        except OSError as error:
            raise DeviceError(reason("file.closed", path=str(path), error=reason_of(error))) from error
        self._lines: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._error: OSError | None = None
        self._thread = threading.Thread(target=self._write_lines, name="spool", daemon=True)
        self._write_line({"schema": SCHEMA, **header})
        self._thread.start()

    def __enter__(self) -> "Spool":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        end = Reason("spool.done")
        if error is not None:
            cause = reason_of(error)
            end = reason("spool.aborted", why=cause if str(cause) else plain(type(error).__name__))
        self._write_line({"end": end.to_json()})
        self._lines.put(None)
        self._thread.join()
        try:
            self._file.close()
        except OSError as full:
            self._error = self._error or full
        if error is None:
            self._check()

    def append(self, output: Sequence[Sample], cell: Sequence[Sample], polls: Sequence[StagePosition]) -> None:
        """Append readings; raise `DeviceError` if an earlier line could not be written."""
        self._check()
        if output or cell or polls:
            self._write_line(
                {
                    "output": [(s.host_s, s.device_s, *s.values) for s in output],
                    "force": [(s.host_s, s.device_s, *s.values) for s in cell],
                    "polls": [(p.host_s, p.position_mm) for p in polls],
                }
            )

    def add_metadata(self, metadata: dict[str, Any]) -> None:
        """Add the metadata by which the samples become a recording again."""
        self._write_line({"facts": metadata})

    def _check(self) -> None:
        if self._error is not None:
            raise DeviceError(reason("file.full", path=str(self.path), error=reason_of(self._error))) from self._error

    def _write_line(self, value: dict[str, Any]) -> None:
        text = json.dumps(value, separators=(",", ":")).encode()
        self._lines.put(b"%08x %s\n" % (zlib.crc32(text), text))

    def _write_lines(self) -> None:
        is_open = True
        while is_open:
            waiting = [self._lines.get()]
            while not self._lines.empty():
                waiting.append(self._lines.get())
            is_open = waiting[-1] is not None
            file = self._file  # one file from write to fsync: a trial swaps it for a full one at any moment
            try:
                file.write(b"".join(line for line in waiting if line is not None))
                file.flush()
                os.fsync(file.fileno())
            except OSError as error:
                self._error = self._error or error


def read_spool(path: Path) -> SpooledRun:
    """Return a spool up to its first damaged line; raise `InputError` if the file is no spool."""
    try:
        lines = path.read_bytes().split(b"\n")
    except OSError as error:
        raise InputError(reason("file.unreadable", path=str(path), error=reason_of(error))) from error
    texts, damaged = list[bytes](), 0
    for k, line in enumerate(lines):
        checksum, _, text = line.partition(b" ")
        if not line and k == len(lines) - 1:
            break
        if checksum != b"%08x" % zlib.crc32(text):
            damaged = len([rest for rest in lines[k:] if rest])
            break
        texts.append(text)
    try:
        values: list[dict[str, Any]] = [parse_json(text) for text in texts]
        if values[0].get("schema") != SCHEMA:
            raise ValueError("another schema")
        output, force = (
            tuple(Sample(row[0], row[1], tuple(row[2:])) for value in values[1:] for row in value.get(name, ()))
            for name in ("output", "force")
        )
        polls = tuple(StagePosition(*row) for value in values[1:] for row in value.get("polls", ()))
        # A second header is another run in the same file: what belongs to which cannot be told.
        damaged += sum("schema" in value for value in values[1:])
        end = Reason.parse(values[-1].get("end", Reason("spool.cut_off")))
        header = {key: str(text) for key, text in values[0].items() if key != "schema"}
        metadata: dict[str, Any] = next((value["facts"] for value in values if "facts" in value), {})
        return SpooledRun(header, output, force, polls, metadata, end, damaged)
    except (AttributeError, IndexError, TypeError, ValueError) as error:
        raise InputError(reason("file.no_spool", path=str(path))) from error  # Whole lines of something else.
