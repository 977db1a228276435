"""What a worker does for a batch: from the bytes of a unit's file to its calibration, without registry or folder."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from softcal.app.batch.calibrating import Refusal, calibrated
from softcal.app.files.recording_file import read_labelled, read_recording
from softcal.core.errors import InputError
from softcal.core.lot import Lot
from softcal.core.maps.anchors import check_loads
from softcal.core.maps.interface import Anchors
from softcal.core.network.config import NetworkConfig
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.unit.bridge import Bridge
from softcal.core.unit.budget import Reference
from softcal.core.unit.calibrate import UnitProblem
from softcal.core.unit.calibration import CalibrationRecord
from softcal.core.unit.line_spread import LineSpread
from softcal.core.unit.rules import rules_in_force
from softcal.core.unit.source_model import SourceModel
from softcal.core.unit.sources import nearest
from softcal.core.unit.verdict import Limit, Verdict
from softcal.core.words.reason import reason


@dataclass(frozen=True, eq=False)
class FileContent:
    """A recording's file as it was read, for whoever parses it."""

    path: Path
    content: bytes


@dataclass(frozen=True, eq=False)
class UnitTask:
    """One unit on its way to a worker.

    Args:
        item_id: its item in the work queue.
        serial: the unit.
        recording: its file; None where it could not be read, and `problem` says why.
        audit: file of its labelled recording, which decides and fits nothing.
        kept_audit: its newest audit in the registry, where no file of one can be read.
        anchors: known loads, where someone took them.
        kept: those that the registry has, by the hash of the recording they belong to; asked where `anchors` is None.
        known: input hashes of the calibrations it has already: those are not computed again.
        golden: hash of the golden run by the hash of the recording it belongs to.
    """

    item_id: int
    serial: str
    recording: FileContent | None
    audit: FileContent | None = None
    anchors: Anchors | None = None
    known: frozenset[str] = frozenset()
    problem: str = ""
    kept: Mapping[str, Anchors] = field(default_factory=dict)
    golden: Mapping[str, str] = field(default_factory=dict)
    kept_audit: LabelledRecording | None = None


@dataclass(frozen=True, eq=False)
class SharedWork:
    """What every worker holds once.

    Args:
        lot: facts of the lot.
        sources: each source's recording, its shared network and all that the method in force derives from them; the
            lot's own source first.
        own: how own calibrations are trained on audits, for comparison; None trains none.
        limit: the lot's limit; None derives one from the source's own error.
        line: how differently the line presses units, where it was stated.
        reference: what the source was compared with; None where nobody said.
        bridge: the source pressed again in the units' sitting, where somebody did.
        bridges: golden runs that the registry knows recordings to belong to, by their hash; in place of one that f
            cannot read, why. Asked where there is no `bridge`.
        rules: identities of the rules that may hold units back, as they are installed where the batch was started.
    """

    lot: Lot
    sources: tuple[SourceModel, ...]
    own: NetworkConfig | None
    limit: Limit | None
    line: LineSpread | None = None
    reference: Reference | None = None
    bridge: Bridge | None = None
    bridges: Mapping[str, Bridge | str] = field(default_factory=dict)
    rules: tuple[str, ...] = field(default_factory=rules_in_force)

    @property
    def source(self) -> SourceModel:
        """The lot's own source."""
        return self.sources[0]


@dataclass(frozen=True)
class Known:
    """A unit whose calibration from this very input is there already."""

    input_sha256: str


@dataclass(frozen=True, eq=False)
class UnitOutcome:
    """What became of one unit, with the recordings to keep."""

    task_id: int
    serial: str
    result: CalibrationRecord | Refusal | Known
    recording: OutputRecording | None = None
    audit: LabelledRecording | None = None


@dataclass(frozen=True, eq=False)
class Chunk:
    """Units that go to a worker together."""

    tasks: tuple[UnitTask, ...]

    def split(self) -> "tuple[Chunk, ...]":
        """Return a chunk for each unit."""
        return tuple(Chunk((task,)) for task in self.tasks)


@dataclass(frozen=True, eq=False)
class ChunkOutcome:
    """What became of a chunk, and the seconds of CPU it took a worker."""

    units: tuple[UnitOutcome, ...]
    work_s: float


def work_on(shared: SharedWork, chunk: Chunk) -> ChunkOutcome:
    """Calibrate the units of a chunk; a unit that cannot be read or mapped gets its reason."""
    # CPU time: on a busy machine the clock would make chunks of one unit, which cost most.
    start_s = time.process_time()
    units = tuple(_work_on_unit(shared, task) for task in chunk.tasks)
    return ChunkOutcome(units, time.process_time() - start_s)


def lost(chunk: Chunk) -> ChunkOutcome:
    """Return the outcome of units that killed their worker each time."""
    refusal = Refusal(Verdict.RETEST, reason("worker_died"))
    return ChunkOutcome(tuple(UnitOutcome(task.item_id, task.serial, refusal) for task in chunk.tasks), 0.0)


def _work_on_unit(shared: SharedWork, task: UnitTask) -> UnitOutcome:
    try:
        recording = _read(shared.lot, task)
    except InputError as error:
        refusal = Refusal(Verdict.RETEST, reason("unreadable", error=str(error)))
        return UnitOutcome(task.item_id, task.serial, refusal)
    audit, unread = task.kept_audit, ""
    try:
        audit = _read_audit(shared.lot, task) or audit
    except InputError as error:
        unread = str(error)
    anchors = task.kept.get(recording.sha256) if task.anchors is None else task.anchors
    if anchors is not None:
        try:
            known = shared.source.method.map.anchors
            check_loads(shared.source.source, anchors, "the unit was not calibrated", known)
        except InputError as error:
            refusal = Refusal(Verdict.RETEST, reason("wrong_loads", error=str(error)))
            return UnitOutcome(task.item_id, task.serial, refusal, recording, audit)
    bridge = shared.bridge or shared.bridges.get(task.golden.get(recording.sha256, ""))
    if isinstance(bridge, str):
        refusal = Refusal(Verdict.RETEST, reason("wrong_golden", error=bridge))
        return UnitOutcome(task.item_id, task.serial, refusal, recording, audit)
    shown = recording, shared.limit, anchors, audit, shared.own, shared.line, shared.reference
    networks = {model.network.id for model in shared.sources}
    problems = [
        replace(
            UnitProblem(model, *shown),
            beside=tuple(networks - {model.network.id}),
            rules=shared.rules,
            unread_audit=unread,
        )
        for model in shared.sources
    ]
    # The golden run is one of the lot's own source: it says nothing of the others.
    problems[0] = replace(problems[0], bridge=bridge)
    for problem in problems:
        # Its input names the sources it was chosen among: the choice need not be made again.
        if problem.input_sha256 in task.known:
            return UnitOutcome(task.item_id, task.serial, Known(problem.input_sha256))
    problem = problems[0] if len(problems) == 1 else nearest(problems)
    return UnitOutcome(task.item_id, task.serial, calibrated(problem), recording, audit)


def _read(lot: Lot, task: UnitTask) -> OutputRecording:
    if task.recording is None:
        raise InputError(task.problem)
    file = task.recording
    return read_recording(file.path, task.serial, lot.sample_rate_Hz, lot.output_unit, file.content)


def _read_audit(lot: Lot, task: UnitTask) -> LabelledRecording | None:
    if task.audit is None:
        return None
    units = lot.output_unit, lot.reference_unit
    return read_labelled(task.audit.path, task.serial, lot.sample_rate_Hz, units, task.audit.content)
