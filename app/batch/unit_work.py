"""What a worker does for a batch: from the bytes of a unit's file to its calibration, without registry or folder."""

import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from softcal.app.files.recording_file import read_labelled, read_recording
from softcal.core.errors import InputError, UnitRefused
from softcal.core.identity import content_sha256
from softcal.core.lot import Lot
from softcal.core.maps.interface import Anchors, FitProblem, UnitMap
from softcal.core.network.training import NetworkConfig
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.unit.calibrate import CalibrationConfig, calibrate_unit
from softcal.core.unit.calibration import CalibrationRecord
from softcal.core.unit.scoring import score_map
from softcal.core.unit.source_model import SourceModel
from softcal.core.unit.verdict import Limit, decide_audited


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
        audit: file of its labelled recording, which only scores.
        anchors: known loads, where someone took them.
        known: input hashes of the calibrations it has already: those are not computed again.
    """

    item_id: int
    serial: str
    recording: FileContent | None
    audit: FileContent | None = None
    anchors: Anchors | None = None
    known: frozenset[str] = frozenset()
    problem: str = ""


@dataclass(frozen=True, eq=False)
class SharedWork:
    """What every worker holds once.

    Args:
        lot: facts of the lot.
        source: the source's recording, the shared network and all that is derived from them.
        calibration: how maps are chosen and judged.
        own: how own calibrations are trained on audits, for comparison; None trains none.
        limit: the lot's limit; None derives one from the source's own error.
    """

    lot: Lot
    source: SourceModel
    calibration: CalibrationConfig
    own: NetworkConfig | None
    limit: Limit | None


@dataclass(frozen=True)
class Refusal:
    """A unit that got no map, and why."""

    verdict: str
    reason: str


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
    reason = "the process that fitted it died; run the batch again with --jobs 1 to see why"
    refusal = Refusal("retest", reason)
    return ChunkOutcome(tuple(UnitOutcome(task.item_id, task.serial, refusal) for task in chunk.tasks), 0.0)


def _work_on_unit(shared: SharedWork, task: UnitTask) -> UnitOutcome:
    try:
        recording, audit = _read(shared.lot, task)
    except InputError as error:
        refusal = Refusal("retest", f"recording not readable: {error}")
        return UnitOutcome(task.item_id, task.serial, refusal)
    input_sha256 = _input_sha256(shared, task, recording, audit)
    if input_sha256 in task.known:
        return UnitOutcome(task.item_id, task.serial, Known(input_sha256))
    result = _fit(shared, task, recording, audit, input_sha256)
    return UnitOutcome(task.item_id, task.serial, result, recording, audit)


def _read(lot: Lot, task: UnitTask) -> tuple[OutputRecording, LabelledRecording | None]:
    if task.recording is None:
        raise InputError(task.problem)
    rate_Hz, file = lot.sample_rate_Hz, task.recording
    recording = read_recording(file.path, task.serial, rate_Hz, lot.output_unit, file.content)
    if task.audit is None:
        return recording, None
    units = lot.output_unit, lot.reference_unit
    return recording, read_labelled(task.audit.path, task.serial, rate_Hz, units, task.audit.content)


def _input_sha256(
    shared: SharedWork, task: UnitTask, recording: OutputRecording, audit: LabelledRecording | None
) -> str:
    anchors = task.anchors
    settings = {
        "recording": recording.sha256,
        "audit": None if audit is None else audit.sha256,
        "network": shared.source.network.id,
        "calibration": asdict(shared.calibration),
        "own": asdict(shared.own) if shared.own is not None and audit is not None else None,
        "anchors": None if anchors is None else [anchors.output.tolist(), anchors.reference.tolist()],
        "limit": None if shared.limit is None else asdict(shared.limit),
    }
    return content_sha256({}, settings)


def _fit(
    shared: SharedWork,
    task: UnitTask,
    recording: OutputRecording,
    audit: LabelledRecording | None,
    input_sha256: str,
) -> CalibrationRecord | Refusal:
    start_s = time.perf_counter()
    source = shared.source
    try:
        problem = FitProblem(source.source, source.network, recording, task.anchors)
        calibration = calibrate_unit(problem, shared.limit, shared.calibration, source)
    except UnitRefused as error:
        return Refusal("fail", str(error))
    record = calibration.to_record(input_sha256, recording.sha256, time.perf_counter() - start_s)
    if audit is None:
        return record
    return _scored(shared, record, calibration.unit_map, audit)


def _scored(
    shared: SharedWork, record: CalibrationRecord, unit_map: UnitMap, audit: LabelledRecording
) -> CalibrationRecord:
    """Put beside a calibration what its audit measured, and what would be decided on that."""
    scores = score_map(shared.source.network, unit_map, audit, shared.own)
    limit_rmse, origin = float(str(record.evidence["limit_rmse"])), str(record.evidence["limit_origin"])
    limit = Limit(audit.reference_unit, limit_rmse, origin)
    measured = decide_audited(scores.before, scores.after, len(audit.windows), limit)
    told = {"audited_verdict": measured.word, "audited_reasons": "; ".join(measured.reasons)}
    return replace(
        record,
        before_rmse=scores.before,
        after_rmse=scores.after,
        own_rmse=scores.own,
        evidence={**record.evidence, **told},
    )
