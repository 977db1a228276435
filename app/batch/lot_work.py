"""The units of a lot as work items of the registry: claimed under a lease, computed by an engine, kept one by one.

Any number of batches share a lot. Each claims units, and a result and the end of its item are kept in one transaction,
so that a batch that is killed loses nothing and repeats nothing that was kept.
"""

import hashlib
import json
import math
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from itertools import chain
from pathlib import Path

from softcal.app.batch.calibrating import Refusal
from softcal.app.batch.claims import Claims
from softcal.app.batch.engine import EngineChoice, WorkerLost, run_all
from softcal.app.batch.report import UnitResult
from softcal.app.batch.unit_work import (
    Chunk,
    ChunkOutcome,
    FileContent,
    Known,
    SharedWork,
    UnitOutcome,
    UnitTask,
    lost,
    work_on,
)
from softcal.app.files.lot_folder import LotFolder
from softcal.app.logs import note
from softcal.core.errors import InputError
from softcal.core.identity import content_sha256
from softcal.core.maps.interface import Anchors
from softcal.core.network.training import EpochReport, NetworkConfig
from softcal.core.reason import Reason, plain
from softcal.core.unit.method import Method
from softcal.core.unit.verdict import Release, Verdict
from softcal.db.entries import MadeCalibration
from softcal.db.registry import Registry
from softcal.db.work_queue import WorkItem, WorkSet

CHUNK_S = 1.0
"""Seconds of CPU a chunk should hold. By `benchmarks/batch_chunks.py` a chunk of one unit costs the command twice as
much as one of four or more, and a batch that is killed repeats no more than the chunks under way."""

FIRST_CHUNK, LARGEST_CHUNK = 4, 128
LOOK_EVERY_S = 1.0
"""How often a batch that waits for units of others looks whether they are done."""


@dataclass(frozen=True)
class BatchConfig:
    """How a lot is calibrated.

    Args:
        network: how f is built and trained.
        method: every number of the calibration.
        engine: where the fits run.
        chunk: units that go to a worker together; None lets the time they take decide.
        score_own: whether own calibrations are trained on audit recordings, for comparison.
        refit: whether units are fitted again although the registry has their result.
        release: which verdicts release files.
        anchors: known loads by serial, where someone took them.
        actor: who asks, for the audit trail; None is the user the registry was opened by.
    """

    network: NetworkConfig = NetworkConfig()
    method: Method = Method()
    engine: EngineChoice = EngineChoice()
    chunk: int | None = None
    score_own: bool = True
    refit: bool = False
    release: Release = Release.PASS
    anchors: Mapping[str, Anchors] = field(default_factory=dict)
    actor: str | None = None


def _silent(_: object) -> None:
    return None


@dataclass(frozen=True)
class Watch:
    """Told as the batch goes on; the defaults say nothing.

    Args:
        on_epoch: every epoch of a training.
        on_start: how many units the lot has.
        on_unit: every result of this batch.
        on_done: how many units of the lot are done so far, by this batch and others.
        on_wait: how many units others hold, while there is nothing else to do.
    """

    on_epoch: Callable[[EpochReport], None] = _silent
    on_start: Callable[[int], None] = _silent
    on_unit: Callable[[UnitResult], None] = _silent
    on_done: Callable[[int], None] = _silent
    on_wait: Callable[[int], None] = _silent


class LotWork:
    """The units of one lot on their way through queue, engine and registry."""

    def __init__(
        self, folder: LotFolder, registry: Registry, shared: SharedWork, config: BatchConfig, watch: Watch
    ) -> None:
        self._folder, self._registry, self._shared = folder, registry, shared
        self._config, self._watch = config, watch
        self._lot_id = folder.lot.id
        self._work = WorkSet(self._lot_id, _settings_sha256(shared, config.refit))
        self._made: dict[str, UnitResult] = {}
        self._unit_s: float | None = None

    def results(self) -> dict[str, UnitResult]:
        """Return the result of every unit, whoever made it."""
        inputs = {serial: self._input_sha256(serial) for serial in self._folder.unit_paths}
        with Claims(self._registry, self._work) as claims:
            claims.take_back_from_dead()
            claims.queue.enqueue(self._work, inputs)
            self._tell_done(claims)
            while not self._is_done(claims, inputs):
                self._work_off(claims)
            return self._from_queue(claims, inputs) | self._made

    def _work_off(self, claims: Claims) -> None:
        """Work until nothing is free; wait a moment where others hold the rest."""
        chunks = self._chunks(claims)
        first = next(chunks, None)
        if first is None:
            held = claims.queue.counts(work=self._work)
            self._watch.on_wait(held["claimed"])
            time.sleep(LOOK_EVERY_S if held["claimed"] else 0.0)
            return
        for answer in run_all(self._config.engine, work_on, self._shared, chain([first], chunks), Chunk.split):
            outcome = lost(answer.item) if isinstance(answer, WorkerLost) else answer
            for result in self._keep(claims, outcome):
                self._made[result.serial] = result
                self._watch.on_unit(result)
            self._tell_done(claims)

    def _is_done(self, claims: Claims, inputs: Mapping[str, str]) -> bool:
        counts = claims.queue.counts(work=self._work)
        if counts["queued"] + counts["claimed"] == 0:
            # A batch with other settings forgets what nobody was working at just then.
            return claims.queue.enqueue(self._work, self._missing(claims, inputs)) == 0
        return False

    def _missing(self, claims: Claims, inputs: Mapping[str, str]) -> dict[str, str]:
        known = {(item.serial, item.input_sha256) for item in claims.queue.ended(self._work)}
        return {serial: sha256 for serial, sha256 in inputs.items() if (serial, sha256) not in known}

    def _tell_done(self, claims: Claims) -> None:
        self._watch.on_done(sum(claims.queue.counts(work=self._work)[state] for state in ("done", "failed")))

    def _input_sha256(self, serial: str) -> str:
        """Return the hash of the files as they lie there: much faster than reading them as recordings."""
        paths = [self._folder.unit_paths[serial], self._folder.audit_paths.get(serial)]
        anchors = self._config.anchors.get(serial)
        loads = None if anchors is None else [anchors.output.tolist(), anchors.reference.tolist()]
        files = [path and (path.suffix, _file_sha256(path)) for path in paths]
        return content_sha256({}, {"set": self._work.name, "files": files, "anchors": loads})

    def _chunks(self, claims: Claims) -> Iterator[Chunk]:
        while items := claims.take(self._chunk_size()):
            yield Chunk(tuple(self._tasks(items)))

    def _chunk_size(self) -> int:
        if self._config.chunk is not None:
            return self._config.chunk
        if self._unit_s is None:
            return FIRST_CHUNK
        return min(max(1, math.ceil(CHUNK_S / max(self._unit_s, 1e-6))), LARGEST_CHUNK)

    def _tasks(self, items: list[WorkItem]) -> Iterator[UnitTask]:
        serials = [item.serial for item in items]
        known = {} if self._config.refit else self._registry.known_inputs(self._lot_id, serials)
        for item in items:
            path, audit_path = self._folder.unit_paths.get(item.serial), self._folder.audit_paths.get(item.serial)
            if path is None:
                yield UnitTask(item.id, item.serial, None, problem="its file is no longer in the lot folder")
                continue
            try:
                recording = FileContent(path, path.read_bytes())
                audit = None if audit_path is None else FileContent(audit_path, audit_path.read_bytes())
            except OSError as error:
                yield UnitTask(item.id, item.serial, None, problem=f"{error.filename}: {error.strerror}")
                continue
            anchors = self._config.anchors.get(item.serial)
            yield UnitTask(item.id, item.serial, recording, audit, anchors, known.get(item.serial, frozenset()))

    def _keep(self, claims: Claims, outcome: ChunkOutcome) -> list[UnitResult]:
        """Register what is still this batch's own, and close its items, in one transaction."""
        if outcome.work_s and outcome.units:
            self._unit_s = outcome.work_s / len(outcome.units)
        kept = []
        with self._registry.transaction():
            mine = claims.queue.held(claims.owner, [unit.task_id for unit in outcome.units])
            for unit in outcome.units:
                if unit.task_id in mine:
                    result = self._register(unit)
                    claims.queue.finish(claims.owner, unit.task_id, _result_text(result))
                    kept.append(result)
        for result in kept:
            revision = result.made and result.made.revision
            note("unit", lot=self._lot_id, serial=result.serial, verdict=result.verdict, revision=revision)
        return kept

    def _register(self, unit: UnitOutcome) -> UnitResult:
        registry, lot_id, actor = self._registry, self._lot_id, self._config.actor
        for recording, kind in ((unit.recording, "unit"), (unit.audit, "audit")):
            if recording is not None:
                registry.add_recording(lot_id, recording, kind, actor=actor)
        if isinstance(unit.result, Refusal):
            word, reasons = str(unit.result.verdict), (unit.result.reason,)
            registry.add_refusal(lot_id, unit.serial, word, reasons, actor=actor)
            return UnitResult(unit.serial, word, reasons)
        if isinstance(unit.result, Known):
            stored = registry.find_calibration(unit.serial, unit.result.input_sha256, lot_id=lot_id)
            if stored is None:
                raise InputError(f"{unit.serial}: its calibration vanished from the registry; run `registry verify`")
            return _of_made(MadeCalibration.of(stored.record, stored.revision), is_new=False)
        revision = registry.add_calibration(lot_id, unit.result, actor=actor, reason="batch")
        return _of_made(MadeCalibration.of(unit.result, revision), is_new=True)

    def _from_queue(self, claims: Claims, inputs: Mapping[str, str]) -> dict[str, UnitResult]:
        """Return the results that were there before, or that another batch made."""
        wanted = set(inputs.items()) - {(serial, inputs[serial]) for serial in self._made}
        ended = [item for item in claims.queue.ended(self._work) if (item.serial, item.input_sha256) in wanted]
        made = self._registry.made_calibrations(self._lot_id) if ended else {}
        return {item.serial: _result(item, made) for item in ended}


def _settings_sha256(shared: SharedWork, is_refit: bool) -> str:
    """Return the hash of all that a result depends on beside the unit's own files."""
    settings = {
        "lot": {name: value for name, value in shared.lot.settings().items() if name != "limit_rmse"},
        "network": shared.source.network.id,
        "method": shared.source.method.id,
        "own": None if shared.own is None else asdict(shared.own),
        "limit": None if shared.limit is None else shared.limit.to_json(),
        # A newer version may read what an older one refused.
        "version": version("softcal"),
        "refit": uuid.uuid4().hex if is_refit else None,
    }
    return content_sha256({}, settings)


def _file_sha256(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        return f"{time.time_ns()}: {error.strerror}"


def _of_made(made: MadeCalibration, *, is_new: bool) -> UnitResult:
    return UnitResult(made.serial, made.verdict, made.reasons, made, is_new)


def _result_text(result: UnitResult) -> str:
    if result.made is not None:
        return json.dumps({"revision": result.made.revision})
    return json.dumps({"verdict": result.verdict, "reasons": [why.to_json() for why in result.reasons]})


def _result(item: WorkItem, made: Mapping[tuple[str, int], MadeCalibration]) -> UnitResult:
    if item.state == "failed":
        why = plain(f"not calibrated: {item.result}; run the batch again")
        return UnitResult(item.serial, Verdict.RETEST, (why,), is_new=False)
    facts = json.loads(item.result or "{}")
    if "revision" in facts:
        return _of_made(made[item.serial, facts["revision"]], is_new=False)
    return UnitResult(item.serial, facts["verdict"], tuple(map(Reason.of, facts["reasons"])), is_new=False)
