"""Calibrate a whole lot without a screen: train or reuse f, fit every unit, verdicts, registry, exports; resumable."""

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace

from softcal.app.engine import EngineChoice, WorkerLost, run_all
from softcal.app.lot_folder import LotFolder
from softcal.app.workflow.train import TrainedOrFound, train_or_find
from softcal.core.calibrate import CalibrationConfig, calibrate_unit
from softcal.core.calibration import CalibrationRecord
from softcal.core.errors import InputError, UnitRefused
from softcal.core.identity import content_sha256
from softcal.core.lot import Lot
from softcal.core.maps.interface import Anchors, FitProblem
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.scoring import score_map
from softcal.core.source_model import SourceModel, make_source_model
from softcal.core.training import EpochReport, NetworkConfig
from softcal.core.verdict import Limit
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
        anchors: known loads by serial, where someone took them.
        actor: who asks, for the audit trail; None is the user the registry was opened by.
    """

    network: NetworkConfig = NetworkConfig()
    calibration: CalibrationConfig = CalibrationConfig()
    engine: EngineChoice = EngineChoice()
    chunk: int = 8
    score_own: bool = True
    refit: bool = False
    anchors: Mapping[str, Anchors] = field(default_factory=dict)
    actor: str | None = None


@dataclass(frozen=True, eq=False)
class UnitResult:
    """One row of the report.

    Args:
        serial: the unit.
        verdict: pass, conditional, fail or retest.
        reasons: why, most important first.
        record: its calibration; None for a unit that could not be read or mapped.
        revision: revision of the calibration in the registry.
        is_new: whether it was fitted now; otherwise the registry had it.
    """

    serial: str
    verdict: str
    reasons: tuple[str, ...]
    record: CalibrationRecord | None = None
    revision: int | None = None
    is_new: bool = True


@dataclass(frozen=True)
class Refusal:
    """A unit that got no map, and why."""

    serial: str
    verdict: str
    reason: str


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
        words = [unit.verdict for unit in self.units]
        return {word: words.count(word) for word in ("pass", "conditional", "fail", "retest")}


@dataclass(frozen=True, eq=False)
class _Task:
    """One unit on its way to a worker."""

    recording: OutputRecording
    audit: LabelledRecording | None
    anchors: Anchors | None
    input_sha256: str


@dataclass(frozen=True, eq=False)
class _Shared:
    """What every worker holds once."""

    source: SourceModel
    config: BatchConfig
    limit: Limit | None


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
    shared = _Shared(make_source_model(source, trained.network), config, _limit(registry.lot(folder.lot.id)))
    watch.on_start(len(folder.unit_paths))
    results: dict[str, UnitResult] = {}
    for result in _results(folder, registry, shared):
        results[result.serial] = result
        watch.on_unit(result)
    ordered = tuple(results[serial] for serial in folder.unit_paths)
    return BatchReport(folder.lot.id, trained, ordered, time.perf_counter() - start_s)


def _limit(lot: Lot) -> Limit | None:
    return None if lot.limit_rmse is None else Limit(lot.reference_unit, lot.limit_rmse)


def _results(folder: LotFolder, registry: Registry, shared: _Shared) -> Iterator[UnitResult]:
    ready: list[UnitResult] = []
    chunks = _chunks(folder, registry, shared, ready)
    for answer in run_all(shared.config.engine, _fit_chunk, shared, chunks):
        outcomes = _lost(answer.item) if isinstance(answer, WorkerLost) else answer
        with registry.transaction():
            ready += [_register(folder.lot.id, registry, outcome, shared.config.actor) for outcome in outcomes]
        while ready:
            yield ready.pop(0)
    yield from ready


def _chunks(folder: LotFolder, registry: Registry, shared: _Shared, ready: list[UnitResult]) -> Iterator[list[_Task]]:
    """Read the units one by one; those that need no fit go straight to `ready`."""
    chunk: list[_Task] = []
    for serial in folder.unit_paths:
        try:
            task = _read_task(folder, registry, serial, shared)
        except InputError as error:
            refusal = Refusal(serial, "retest", f"recording not readable: {error}")
            ready.append(_register(folder.lot.id, registry, refusal, shared.config.actor))
            continue
        known = None if shared.config.refit else registry.find_calibration(serial, task.input_sha256)
        if known is not None:
            record = known.record
            ready.append(UnitResult(serial, record.verdict, record.reasons, record, known.revision, is_new=False))
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
    actor, lot_id = shared.config.actor, folder.lot.id
    with registry.transaction():
        sha256 = registry.add_recording(lot_id, recording, "unit", actor=actor)
        audit_sha256 = None if audit is None else registry.add_recording(lot_id, audit, "audit", actor=actor)
    anchors = shared.config.anchors.get(serial)
    settings = {
        "recording": sha256,
        "audit": audit_sha256,
        "network": shared.source.network.id,
        "calibration": asdict(shared.config.calibration),
        "own": asdict(shared.config.network) if shared.config.score_own and audit is not None else None,
        "anchors": None if anchors is None else [anchors.output.tolist(), anchors.reference.tolist()],
        "limit": None if shared.limit is None else asdict(shared.limit),
    }
    return _Task(recording, audit, anchors, content_sha256({}, settings))


def _fit_chunk(shared: _Shared, tasks: list[_Task]) -> list[CalibrationRecord | Refusal]:
    return [_fit_unit(shared, task) for task in tasks]


def _fit_unit(shared: _Shared, task: _Task) -> CalibrationRecord | Refusal:
    start_s = time.perf_counter()
    try:
        problem = FitProblem(shared.source.source, shared.source.network, task.recording, task.anchors)
        calibration = calibrate_unit(problem, shared.limit, shared.config.calibration, shared.source)
    except UnitRefused as error:
        return Refusal(task.recording.serial, "fail", str(error))
    record = calibration.to_record(
        input_sha256=task.input_sha256,
        recording_sha256=task.recording.sha256,
        fit_s=time.perf_counter() - start_s,
    )
    if task.audit is None:
        return record
    own = shared.config.network if shared.config.score_own else None
    scores = score_map(shared.source.network, calibration.unit_map, task.audit, own)
    return replace(record, before_rmse=scores.before, after_rmse=scores.after, own_rmse=scores.own)


def _lost(tasks: list[_Task]) -> list[Refusal]:
    reason = "the process that fitted it died; run the batch again with --jobs 1 to see why"
    return [Refusal(task.recording.serial, "retest", reason) for task in tasks]


def _register(lot_id: str, registry: Registry, outcome: CalibrationRecord | Refusal, actor: str | None) -> UnitResult:
    if isinstance(outcome, Refusal):
        registry.add_refusal(lot_id, outcome.serial, outcome.verdict, (outcome.reason,), actor=actor)
        return UnitResult(outcome.serial, outcome.verdict, (outcome.reason,))
    revision = registry.add_calibration(lot_id, outcome, actor=actor, reason="batch")
    return UnitResult(outcome.serial, outcome.verdict, outcome.reasons, outcome, revision)


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
    errors = ("predicted_rmse", "before_rmse", "after_rmse", "own_rmse", "fit_s")
    unit_map = None
    if record is not None:
        unit_map = {"family": record.family, "revision": unit.revision, "sha256": record.map_sha256}
    return {
        "serial": unit.serial,
        "verdict": unit.verdict,
        "reasons": list(unit.reasons),
        **{name: getattr(record, name, None) for name in errors},
        "map": unit_map,
        "is_new": unit.is_new,
    }


TABLE_HEADER = ("serial", "verdict", "predicted", "before", "after", "own", "after/own", "fit_s", "map")


def table_row(unit: UnitResult) -> list[object]:
    """Return one row of the table a person reads, under `TABLE_HEADER`."""
    record = unit.record
    if record is None:
        return [unit.serial, unit.verdict, *[None] * 7]
    ratio = record.after_rmse / record.own_rmse if record.after_rmse and record.own_rmse else None
    errors = [record.predicted_rmse, record.before_rmse, record.after_rmse, record.own_rmse, ratio, record.fit_s]
    return [unit.serial, unit.verdict, *errors, record.family]
