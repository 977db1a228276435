"""Work of a batch worker: from the bytes of a unit's file to its calibration."""

import time
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

from softcal.app.calibration.unit_calibration import LotContext, Refusal, Result, UnitInputs, calibrate_unit
from softcal.app.files.measured_at import measured_at
from softcal.app.files.recording_file import PLAIN, ColumnNames, FileRecording, inspect_recording
from softcal.app.tables.timestamps import Start
from softcal.core.errors import InputError
from softcal.core.inspection.comparison import compare_recordings
from softcal.core.lot import Lot
from softcal.core.messages.reason import reason
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.unit.verdict import Verdict


@dataclass(frozen=True, eq=False)
class FileContent:
    """Bytes of a recording's file, for parsing elsewhere."""

    path: Path
    content: bytes


@dataclass(frozen=True, eq=False)
class UnitTask:
    """One unit on its way to a worker: its file, or its error.

    A file of its audit has precedence over the audit among `inputs`; `declared_at` is the time of the audit, UTC.
    Calibrations of `existing` inputs are not computed again.
    """

    item_id: int
    serial: str
    recording: FileContent | None
    audit: FileContent | None = None
    inputs: UnitInputs = UnitInputs()
    existing: frozenset[str] = frozenset()
    problem: str = ""
    declared_at: datetime | None = None


@dataclass(frozen=True, eq=False)
class SharedWork:
    """Data that every worker loads once: layout of the lot's files, settings of the fit."""

    lot: Lot
    inputs: LotContext
    names: ColumnNames = PLAIN


@dataclass(frozen=True)
class ReadFile:
    """Layout of a read file in one line, "" for the plain form, and remarks."""

    path: Path
    layout: str
    remarks: tuple[str, ...]
    start: Start | None = None

    @classmethod
    def from_recording(
        cls, file: FileRecording, remarks: tuple[str, ...] | None = None, start: Start | None = None
    ) -> "ReadFile":
        """Return how a recording was read, with an audit's start; remarks on a unit's samples are in its reasons."""
        return cls(file.table.path, file.table.layout, file.reading_remarks if remarks is None else remarks, start)


@dataclass(frozen=True, eq=False)
class UnitOutcome:
    """Result of one unit, with recordings to store, time of its audit, and layout of its files."""

    task_id: int
    serial: str
    result: Result
    recording: OutputRecording | None = None
    audit: LabelledRecording | None = None
    files: tuple[ReadFile, ...] = ()
    measured_at: datetime | None = None


@dataclass(frozen=True, eq=False)
class Chunk:
    """Units that go to a worker together."""

    tasks: tuple[UnitTask, ...]

    def split(self) -> "tuple[Chunk, ...]":
        return tuple(Chunk((task,)) for task in self.tasks)


@dataclass(frozen=True, eq=False)
class ChunkOutcome:
    """Result of a chunk, and its CPU time in s."""

    units: tuple[UnitOutcome, ...]
    work_s: float


def work_on(shared: SharedWork, chunk: Chunk) -> ChunkOutcome:
    """Calibrate the units of a chunk; a unit that cannot be read or mapped gets its reason."""
    # CPU time: on a busy machine the clock would make chunks of one unit, which cost most.
    start_s = time.process_time()
    units = tuple(_work_on_unit(shared, task) for task in chunk.tasks)
    return ChunkOutcome(units, time.process_time() - start_s)


def _work_on_unit(shared: SharedWork, task: UnitTask) -> UnitOutcome:
    lot, names, file, audit = shared.lot, shared.names, task.recording, task.audit
    recording_options = (task.serial, lot.sample_rate_Hz, lot.output_unit)
    config = shared.inputs.source.method.inspection
    try:
        if file is None:
            raise InputError(task.problem)
        unit = inspect_recording(file.path, *recording_options, file.content, names, config=config)
    except InputError as error:
        refusal = Refusal(Verdict.RETEST, reason("unreadable", error=str(error)))
        return UnitOutcome(task.item_id, task.serial, refusal)
    inputs, recording, files, at = task.inputs, unit.recording, [ReadFile.from_recording(unit)], None
    if audit is not None:
        try:
            read = inspect_recording(
                audit.path, *recording_options, audit.content, names, with_reference=True, config=config
            )
            at = measured_at(read, task.declared_at)
            inputs = replace(inputs, audit=read.labelled(lot.reference_unit))
            comparisons = compare_recordings(shared.inputs.source.source, read.labelled(lot.reference_unit))
            files.append(ReadFile.from_recording(read, (*read.reading_remarks, *map(str, comparisons)), read.start))
        except InputError as error:
            inputs = replace(inputs, unread_audit=str(error))
    result = calibrate_unit(shared.inputs, recording, inputs, task.existing)
    # Only what came as a file is new to the registry.
    new_audit = None if audit is None or inputs.unread_audit else inputs.audit
    return UnitOutcome(task.item_id, task.serial, result, recording, new_audit, tuple(files), at)
