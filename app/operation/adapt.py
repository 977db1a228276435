"""Long-term use of one unit: estimates while its map follows the drift, all in the registry."""

import hashlib
from collections import Counter
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, Future
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from softcal.app.files.recording_file import PLAIN, ColumnNames
from softcal.app.files.stream_file import Stream, estimate_writer
from softcal.app.registry.lot_recordings import source_recording
from softcal.app.registry.unit import UnitInUse, unit_in_use
from softcal.app.views.long_term import Trace
from softcal.core.errors import InputError
from softcal.core.identity import content_sha256
from softcal.core.lot import Lot, UnitKey
from softcal.core.operation.adapter import QUEUES, AdaptConfig, Adapter
from softcal.core.operation.method import DriftTracking
from softcal.core.operation.queued_transport import QueuedTransport
from softcal.core.operation.stream_estimator import FLAG_SEPARATOR, MapUpdate, StreamEstimator
from softcal.core.recording import Array
from softcal.core.unit.estimate import Estimate
from softcal.core.windows import TAPS
from softcal.db.registry import Registry

MAPS_S = 2.0
"""Most seconds of a live stream whose maps a crash can lose."""

STATE_S = 60.0
"""Seconds of a live stream between two states to resume from."""

FILE_MAPS_ROWS = 100_000
"""Rows of a file between two writes of its maps; its state is kept at its end only."""


@dataclass(frozen=True)
class AdaptOptions:
    """How a stream is followed.

    Args:
        revision: calibration to start from; None for the one in use.
        stream: name under which the registry keeps the course; None makes one from the file's content.
    """

    config: AdaptConfig = AdaptConfig()
    revision: int | None = None
    stream: str | None = None
    resume: bool = False
    lot_id: str | None = None


@dataclass
class AdaptReport:
    """What became of a stream so far.

    Args:
        flags: rows by each word of their flags.
        verdicts: how often the map was followed, held or jumped.
        changed: numbers of the method that differ from those the stream was followed with before.
        trace: the course of output, estimate and predicted error, thinned.
        layout, remarks: how the file was read.
    """

    serial: str
    revision: int
    stream: str
    mode: str
    current: MapUpdate
    lot: Lot
    method: DriftTracking
    changed: list[str] = field(default_factory=list)
    rows: int = 0
    flags: Counter[str] = field(default_factory=Counter)
    verdicts: Counter[str] = field(default_factory=Counter)
    trace: Trace = field(default_factory=Trace)
    layout: str = ""
    remarks: list[str] = field(default_factory=list)

    @property
    def unit(self) -> UnitKey:
        return UnitKey(self.lot.id, self.serial)


class Follower:
    """Follows one stream of one unit and keeps maps and state in the registry.

    Args:
        writer: writes to the registry while estimates go on; None writes at once.
        is_repeatable: the same rows will come again after a crash, from the first on, as those of a file do.

    Raises:
        InputError: the stream has begun already and is not to be gone on with, or cannot be by this version.
    """

    def __init__(
        self,
        registry: Registry,
        unit: UnitInUse,
        stream: str,
        options: AdaptOptions,
        writer: Executor | None = None,
        is_repeatable: bool = False,
    ) -> None:
        registry.database.check_writable()
        key = UnitKey(unit.lot.id, unit.state.serial)
        self._registry, self._writer = registry, writer
        self._writing: Future[int] | None = None
        stored = (unit.network, unit.state, unit.recording)
        self._adapter: StreamEstimator = (
            QueuedTransport(*stored, source_recording(registry, unit.network.id), options.config, writer)
            if options.config.mode in QUEUES
            else Adapter(*stored, options.config)
        )
        newest = registry.adaptations.last(key, unit.revision, stream)
        # The same rows again give the same steps; those that are kept already stay as they are.
        self._stored_until = -1 if newest is None else int(newest["sample"])
        self._began: int | None = 0
        self._state_until = -1
        self._method_id = options.config.method.id
        changed: list[str] = []
        last = registry.adaptations.last_checkpoint(key, unit.revision, stream)
        # A file that was broken off is begun again, and so is one whose content names its stream.
        has_content_name = is_repeatable and options.stream is None
        has_begun = last is not None and not has_content_name if is_repeatable else newest is not None
        if options.resume and last is not None and not has_content_name:
            try:
                changed = self._adapter.restore(last["state"])
            except InputError as error:
                begin = "begin again from the calibration with another --stream NAME"
                raise InputError(f"stream {stream!r} cannot be gone on with: {error}; {begin}") from error
            self._began = last.get("began")
        elif not options.resume and has_begun:
            raise InputError(f"stream {stream!r} has begun already; go on with --resume, or give --stream another name")
        if last is not None:
            self._state_until = int(last["sample"])
        self._pending: list[MapUpdate] = []
        rate_Hz = unit.recording.sample_rate_Hz
        self._maps_rows, self._state_rows = (max(1, round(s * rate_Hz)) for s in (MAPS_S, STATE_S))
        self._since_maps = self._since_state = 0
        config = options.config
        identity = (key.serial, unit.revision, stream, config.mode, self._adapter.current, unit.lot, config.method)
        self.report = AdaptReport(*identity, changed)
        # Written once: from then on the newest step of the stream names the new method.
        self._note_change = bool(changed) and newest is not None and newest.get("method") != self._method_id

    @property
    def rows_since_begin(self) -> int | None:
        """Rows of the input now open in the state to go on from; None where it has others."""
        return None if self._began is None else self._adapter.row - self._began

    def reconnect(self) -> None:
        """Go on with rows that do not follow the last ones taken."""
        self._began = None
        self._adapter.reconnect(self._stored_until + 1)

    def begin_file(self) -> None:
        """Go on with the first row of another file; one broken off gives the same steps again."""
        self._adapter.reconnect()

    def advance(self, t_s: Array, output: Array) -> Estimate:
        rows = self._adapter.advance(t_s, output)
        updates = self._adapter.take_updates()
        self._pending += updates
        report = self.report
        report.rows += len(output)
        report.flags.update(word for flag in rows.flag.tolist() for word in flag.split(FLAG_SEPARATOR))
        report.verdicts.update(update.verdict for update in updates)
        report.current = self._adapter.current
        report.trace.add(rows, output)
        self._since_maps += len(output)
        self._since_state += len(output)
        return rows

    def store(self) -> None:
        """Keep maps, and now and then the state, of rows that are written; never waits."""
        if self._writing is not None and not self._writing.done():
            return
        if self._since_state >= self._state_rows:
            self.checkpoint()
        elif self._pending and self._since_maps >= self._maps_rows:
            self.store_maps()

    def store_maps(self) -> None:
        """Keep every map since the last time."""
        self._write(None)

    def checkpoint(self) -> None:
        """Keep every map since the last time and the state now, in one transaction."""
        state = {"event": "checkpoint", "state": self._adapter.state(), "began": self._began}
        identity = {"stream": self.report.stream, "sample": self._adapter.row, "method": self._method_id}
        self._write({**identity, **state})
        self._since_state = 0

    def _write(self, state: dict[str, Any] | None) -> None:
        report = self.report
        maps = [self._entry(update) for update in self._pending]
        new = [entry for entry in maps if int(entry["sample"]) > self._stored_until]
        if self._note_change:
            reason = f"the method has changed: {'; '.join(report.changed)}"
            new.insert(0, self._entry(replace(report.current, verdict="method", reason=reason)))
            self._note_change = False
        self._stored_until = max([self._stored_until, *(int(entry["sample"]) for entry in new)])
        if state is not None and self._adapter.row > self._state_until:
            self._state_until = self._adapter.row
            new.append(state)
        self.settle()
        if new and self._writer is None:
            self._registry.adaptations.add(report.unit, report.revision, new)
        elif new and self._writer is not None:
            self._writing = self._writer.submit(self._registry.adaptations.add, report.unit, report.revision, new)
        self._pending, self._since_maps = [], 0

    def _entry(self, update: MapUpdate) -> dict[str, Any]:
        identity = {"stream": self.report.stream, "sample": update.row, "event": update.verdict}
        return {**identity, **asdict(update), "method": self._method_id}

    def settle(self) -> None:
        """Wait until all that was to be kept is in the registry.

        Raises:
            RegistryError: it could not be written.
        """
        if self._writing is not None:
            self._writing.result()
            self._writing = None


def adapt_file(
    registry: Registry,
    serial: str,
    source: Path,
    target: Path,
    options: AdaptOptions,
    on_rows: Callable[[int], None] = lambda rows: None,
    names: ColumnNames = PLAIN,
) -> AdaptReport:
    """Follow a recorded stream: `t_s, output` of `source` in, estimates to `target`.

    A row of the result depends on no later row of `source`; `target` appears whole or not at all.

    Raises:
        InputError: `source` cannot be read or fills no queue, the registry does not know the serial, or a stream is to
            go on without a identity of time.
    """
    unit = unit_in_use(registry, serial, options.revision, options.lot_id)
    stream = options.stream or _stream_of(source, options.config.name, names)
    follower = Follower(registry, unit, stream, options, is_repeatable=True)
    if options.resume:
        follower.begin_file()
    stored_rows = 0
    with estimate_writer(target) as write:
        read = Stream(source, names, is_resumed=options.resume)
        for t_s, output in read.pieces():
            write(follower.advance(t_s, output))
            on_rows(follower.report.rows)
            if follower.report.rows - stored_rows >= FILE_MAPS_ROWS:
                follower.store_maps()
                stored_rows = follower.report.rows
        if options.config.mode in QUEUES and not options.resume:
            rows, queue = follower.report.rows, options.config.method.online.queue
            # A queue that a whole recording cannot fill would never find its map.
            if rows < (needed := queue + TAPS - 1):
                raise InputError(
                    f"{source}: a queue of {queue} windows needs {needed} rows, the recording has {rows}; "
                    "give a shorter --queue, or another --mode"
                )
    follower.checkpoint()
    follower.report.layout, follower.report.remarks = read.layout, read.remarks
    return follower.report


def _stream_of(source: Path, mode: str, names: ColumnNames) -> str:
    """Return a name that the same content, read the same way, always has."""
    if not source.is_file():
        raise InputError(f"{source}: there is no such file")
    with source.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    suffix = "" if names == PLAIN else f" {content_sha256({}, {'names': repr(names)})[:8]}"
    return f"{source.name[:40]} {digest[:16]} {mode}{suffix}"


def report_json(report: AdaptReport, course: list[Mapping[str, Any]]) -> dict[str, object]:
    """Return the report as the JSON of `softcal adapt --json` (schema `softcal.adapt/1`)."""
    return {
        "schema": "softcal.adapt/1",
        "serial": report.serial,
        "revision": report.revision,
        "stream": report.stream,
        "mode": report.mode,
        "rows": report.rows,
        "layout": report.layout,
        "remarks": report.remarks,
        "flags": {flag: count for flag, count in sorted(report.flags.items()) if flag},
        "verdicts": dict(report.verdicts),
        "method": {"id": report.method.id, "changed": report.changed, "numbers": report.method.to_json()},
        "predicted_rmse": report.current.predicted_rmse,
        "alarm": report.current.alarm or None,
        "maps": [{name: value for name, value in step.items() if name != "state"} for step in map_changes(course)],
    }


def map_changes(course: list[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return the steps of a course that changed something, without the checkpoints."""
    return [step for step in course if step["event"] != "checkpoint"]
