"""Calibrate a whole lot without a screen: train or reuse f, fit every unit, verdicts, registry, exports; resumable."""

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace

from softcal.app.engine import EngineChoice, WorkerLost, run_all
from softcal.app.lot_folder import LotFolder
from softcal.app.workflow.train import TrainedOrFound, train_or_find
from softcal.core.calibrate import CalibrationConfig, SourceModel, calibrate_unit, limit_of
from softcal.core.calibration import CalibrationRecord, refused_record
from softcal.core.errors import InputError, UnitRefused
from softcal.core.identity import content_sha256
from softcal.core.maps.interface import FitProblem
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.scoring import score_map
from softcal.core.training import EpochReport, NetworkConfig
from softcal.db.registry import Registry


@dataclass(frozen=True)
class BatchConfig:
    """How a lot is calibrated.

    Args:
        network: how f is built and trained.
        calibration: how maps are chosen and judged.
        engine: where the fits run.
        chunk: units per work item; fits take milliseconds, so a chunk amortises sending them to a worker.
        score_own: whether own calibrations are trained on audit recordings, for comparison.
        refit: whether units are fitted again although the registry has their result.
        actor: who asks, for the audit trail.
    """

    network: NetworkConfig = NetworkConfig()
    calibration: CalibrationConfig = CalibrationConfig()
    engine: EngineChoice = EngineChoice()
    chunk: int = 8
    score_own: bool = True
    refit: bool = False
    actor: str = "softcal batch"


@dataclass(frozen=True, eq=False)
class UnitResult:
    """One row of the report.

    Args:
        record: the calibration, also of a unit that was refused.
        revision: its revision in the registry.
        is_new: whether it was fitted now; otherwise the registry had it.
    """

    record: CalibrationRecord
    revision: int
    is_new: bool


@dataclass(frozen=True, eq=False)
class BatchReport:
    """What a batch did."""

    lot_id: str
    network: TrainedOrFound
    units: tuple[UnitResult, ...]
    wall_s: float

    @property
    def counts(self) -> dict[str, int]:
        """Units by verdict."""
        words = [unit.record.verdict for unit in self.units]
        return {word: words.count(word) for word in ("pass", "conditional", "fail", "retest")}


@dataclass(frozen=True, eq=False)
class _Task:
    """One unit on its way to a worker."""

    recording: OutputRecording
    recording_sha256: str
    audit: LabelledRecording | None
    input_sha256: str


@dataclass(frozen=True, eq=False)
class _Shared:
    """What every worker holds once."""

    source: SourceModel
    config: BatchConfig
    limit_rmse: float | None


def _silent(_: object) -> None:
    return None


@dataclass(frozen=True)
class Watch:
    """Told as the batch goes on; the defaults say nothing."""

    on_epoch: Callable[[EpochReport], None] = _silent
    on_start: Callable[[int], None] = _silent
    on_unit: Callable[[UnitResult], None] = _silent


def run_batch(folder: LotFolder, registry: Registry, config: BatchConfig, watch: Watch = Watch()) -> BatchReport:
    """Calibrate every unit of a lot folder and register the results as they come.

    A unit whose file cannot be read or that cannot be mapped gets a verdict with its reason, and the lot goes on.
    Whatever the registry already has for the same recording, network and configuration is not computed again.

    Raises:
        InputError: the source cannot be used; without it there is no lot.
    """
    start_s = time.perf_counter()
    source = folder.read_source()
    trained = train_or_find(folder.lot, source, registry, config.network, config.actor, watch.on_epoch)
    shared = _Shared(SourceModel.of(source, trained.network), config, folder.lot.limit_rmse)
    watch.on_start(len(folder.unit_paths))
    results: dict[str, UnitResult] = {}
    for result in _results(folder, registry, shared):
        results[result.record.serial] = result
        watch.on_unit(result)
    ordered = tuple(results[serial] for serial in folder.unit_paths)
    return BatchReport(folder.lot.id, trained, ordered, time.perf_counter() - start_s)


def _results(folder: LotFolder, registry: Registry, shared: _Shared) -> Iterator[UnitResult]:
    finished: list[UnitResult] = []
    chunks = _chunks(folder, registry, shared, finished)
    for answer in run_all(shared.config.engine, _fit_chunk, shared, chunks):
        records = _lost(answer.item, shared) if isinstance(answer, WorkerLost) else answer
        with registry.transaction():
            for record in records:
                finished.append(_register(folder, registry, record, shared.config))
        yield from finished
        finished.clear()
    yield from finished


def _chunks(
    folder: LotFolder, registry: Registry, shared: _Shared, finished: list[UnitResult]
) -> Iterator[list[_Task]]:
    """Read the units one by one; those that need no fit go straight to `finished`."""
    chunk: list[_Task] = []
    for serial in folder.unit_paths:
        try:
            task = _read_task(folder, registry, serial, shared)
        except InputError as error:
            record = refused_record(serial, shared.source.network.id, "retest", f"recording not readable: {error}")
            finished.append(_register(folder, registry, record, shared.config))
            continue
        known = None if shared.config.refit else registry.find_calibration(serial, task.input_sha256)
        if known is not None:
            finished.append(UnitResult(known.record, known.revision, False))
            continue
        chunk.append(task)
        if len(chunk) == shared.config.chunk:
            yield chunk
            chunk = []
    if chunk:
        yield chunk


def _read_task(folder: LotFolder, registry: Registry, serial: str, shared: _Shared) -> _Task:
    recording = folder.read_unit(serial)
    audit = folder.read_audit(serial)
    sha256 = registry.add_recording(folder.lot.id, serial, "unit", recording)
    audit_sha256 = None
    if audit is not None:
        audit_sha256 = registry.add_recording(folder.lot.id, serial, "audit", audit.unlabelled, audit.reference)
    settings = {
        "recording": sha256,
        "audit": audit_sha256,
        "network": shared.source.network.id,
        "calibration": asdict(shared.config.calibration),
        "own": asdict(shared.config.network) if shared.config.score_own and audit is not None else None,
        "limit_rmse": shared.limit_rmse,
    }
    return _Task(recording, sha256, audit, content_sha256({}, settings))


def _fit_chunk(shared: _Shared, tasks: list[_Task]) -> list[CalibrationRecord]:
    return [_fit_unit(shared, task) for task in tasks]


def _fit_unit(shared: _Shared, task: _Task) -> CalibrationRecord:
    source, serial = shared.source, task.recording.serial
    start_s = time.perf_counter()
    try:
        problem = FitProblem(source.recording, source.network, task.recording)
        limit = limit_of(source, shared.limit_rmse)
        calibration = calibrate_unit(problem, limit, shared.config.calibration, source)
    except UnitRefused as error:
        refused = refused_record(serial, source.network.id, "fail", str(error))
        return replace(refused, input_sha256=task.input_sha256, recording_sha256=task.recording_sha256)
    record = calibration.to_record(
        input_sha256=task.input_sha256,
        recording_sha256=task.recording_sha256,
        fit_s=time.perf_counter() - start_s,
    )
    if task.audit is None:
        return record
    own = shared.config.network if shared.config.score_own else None
    scores = score_map(source.network, calibration.unit_map, task.audit, own)
    return replace(record, before_rmse=scores.before, after_rmse=scores.after, own_rmse=scores.own)


def _lost(tasks: list[_Task], shared: _Shared) -> list[CalibrationRecord]:
    reason = "the process that fitted it died three times; run the batch again, with --jobs 1 to see more"
    return [refused_record(t.recording.serial, shared.source.network.id, "retest", reason) for t in tasks]


def _register(folder: LotFolder, registry: Registry, record: CalibrationRecord, config: BatchConfig) -> UnitResult:
    revision = registry.add_calibration(folder.lot.id, record, actor=config.actor, reason="batch")
    return UnitResult(record, revision, True)


def report_json(report: BatchReport) -> dict[str, object]:
    """Return the report as the JSON of `softcal batch --json` (schema `softcal.batch/1`)."""
    return {
        "schema": "softcal.batch/1",
        "lot": report.lot_id,
        "network": report.network.network.id,
        "network_is_new": report.network.is_new,
        "train_s": report.network.metrics.get("train_s"),
        "wall_s": report.wall_s,
        "counts": report.counts,
        "units": [_unit_json(unit) for unit in report.units],
    }


def _unit_json(unit: UnitResult) -> dict[str, object]:
    record = unit.record
    unit_map = {"family": record.family, "revision": unit.revision, "sha256": record.map_sha256}
    return {
        "serial": record.serial,
        "verdict": record.verdict,
        "reasons": list(record.reasons),
        "predicted_rmse": record.predicted_rmse,
        "before_rmse": record.before_rmse,
        "after_rmse": record.after_rmse,
        "own_rmse": record.own_rmse,
        "fit_s": record.fit_s,
        "map": unit_map,
        "is_new": unit.is_new,
    }


def batch_table(report: BatchReport) -> tuple[list[str], list[list[object]]]:
    """Return header and rows of the table a person reads."""
    header = ["serial", "verdict", "predicted", "before", "after", "own", "after/own", "fit_s", "map", "reason"]
    rows: list[list[object]] = []
    for unit in report.units:
        record = unit.record
        ratio = record.after_rmse / record.own_rmse if record.after_rmse and record.own_rmse else None
        errors = [record.predicted_rmse, record.before_rmse, record.after_rmse, record.own_rmse, ratio, record.fit_s]
        rows.append([record.serial, record.verdict, *errors, record.family, "; ".join(record.reasons)[:100]])
    return header, rows
