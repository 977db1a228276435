"""Units of a lot as work items: claimed under a lease, computed, and stored one by one.

Any number of batches share a lot. Each claims units, and a result and the end of its item are kept in one transaction,
so that a batch that is killed loses nothing and repeats nothing that was kept. What is told of a unit comes from its
calibrations and refusals alone; the queue says who works at what, and nothing else.
"""

import hashlib
import math
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from importlib.metadata import version
from itertools import chain

from sqlalchemy.exc import SQLAlchemyError

from softcal.app.batch.claims import Claims
from softcal.app.batch.engine import EngineChoice, WorkerFailure, run_all
from softcal.app.batch.guard import PassingRefusal, failed_outcome, isolate_units
from softcal.app.batch.unit_work import (
    Chunk,
    ChunkOutcome,
    FileContent,
    ReadFile,
    SharedWork,
    UnitOutcome,
    UnitTask,
    work_on,
)
from softcal.app.calibration.lot_context import StoredInputs, put_back, store_result
from softcal.app.calibration.unit_calibration import ExistingCalibration, LotContext, Refusal
from softcal.app.files.lot_folder import LotFolder
from softcal.app.files.regular import read_regular
from softcal.app.logs import note
from softcal.app.registry.known_loads import values
from softcal.core.errors import InputError, RegistryError
from softcal.core.identity import content_sha256
from softcal.core.lot import Lot
from softcal.core.maps.interface import Anchors
from softcal.core.messages.reason import Reason, plain
from softcal.core.network.config import EpochReport, NetworkConfig
from softcal.core.unit.verdict import Release, Verdict
from softcal.db.entries import UnitResult
from softcal.db.provenance import build_id
from softcal.db.queues.work_queue import WorkItem, WorkSet
from softcal.db.registry import Registry

CHUNK_S = 1.0
"""Seconds of CPU a chunk should hold. Measured: a chunk of one unit costs the command twice as
much as one of four or more, and a batch that is killed repeats no more than the chunks under way."""

NO_RESULT = "the registry has no result of it; have the registry verified"
FIRST_CHUNK, LARGEST_CHUNK = 4, 128
MAX_UNREAD_BYTES = 64_000_000
"""Files are read ahead up to so many bytes: each is read once, a large lot needs no more."""

POLL_S = 1.0
"""How often a batch that waits for units of others looks whether they are done."""


@dataclass(frozen=True)
class BatchConfig:
    """Configuration of a batch.

    Args:
        chunk: units that go to a worker together; None lets the time they take decide.
        score_own: whether own calibrations are trained on audits, for comparison.
        refit: whether units are fitted again, once with each build, although the registry has their result.
        anchors: known loads by serial.
        family: of every unit's map, or `auto`; None takes the one stated with the lot.
        actor: who asks, for the audit trail; None is the user the registry was opened by.
    """

    network: NetworkConfig = NetworkConfig()
    engine: EngineChoice = EngineChoice()
    chunk: int | None = None
    score_own: bool = True
    refit: bool = False
    release: Release = Release.PASS
    anchors: Mapping[str, Anchors] = field(default_factory=dict)
    family: str | None = None
    unit_limit_s: float = 900.0
    actor: str | None = None


Files = tuple[FileContent, FileContent | None]
"""Recording of a unit, and its audit."""


def _ignore(*_: object) -> None:
    return None


@dataclass(frozen=True)
class Callbacks:
    """Callbacks of a batch; the defaults do nothing.

    `on_done` gets how many units are done, by this batch and others, of how many. `on_wait` gets how many others have
    leased while there is nothing else to do.
    """

    on_epoch: Callable[[EpochReport], None] = _ignore
    on_unit: Callable[[UnitResult], None] = _ignore
    on_done: Callable[[int, int], None] = _ignore
    on_wait: Callable[[int], None] = _ignore


class LotWork:
    """The units of one lot on their way through queue, engine and registry."""

    def __init__(
        self,
        folder: LotFolder,
        registry: Registry,
        context: LotContext,
        stored: StoredInputs,
        config: BatchConfig,
        callbacks: Callbacks,
    ) -> None:
        self._folder, self._registry, self._context, self._stored = folder, registry, context, stored
        self._config, self._callbacks = config, callbacks
        self._lot_id = folder.lot.id
        self._work = WorkSet(self._lot_id, _settings_sha256(folder.lot, context, config.refit))
        self._unread = deque(folder.unit_paths)
        self._files_ahead: dict[str, Files] = {}
        self._work_hashes: dict[str, str] = {}
        self._recordings: dict[str, str] = {}
        self._new: set[str] = set()
        self._decided: set[str] = set()
        self._unit_s: float | None = None
        self.files: list[ReadFile] = []

    def run(self) -> None:
        """Work until every unit has a result of any process."""
        with Claims(self._registry, self._work) as claims:
            claims.take_back_from_dead()
            self._report_progress(claims)
            while not self._is_done(claims):
                chunks = self._chunks(claims)
                first = next(chunks, None)
                if first is None:
                    # Nothing is free; others may hold the rest.
                    if claimed := claims.queue.counts(work=self._work)["claimed"]:
                        self._callbacks.on_wait(claimed)
                        time.sleep(POLL_S)
                    continue
                work = partial(isolate_units, work_on, self._config.unit_limit_s)
                shared = SharedWork(self._folder.lot, self._context, self._folder.names)
                for answer in run_all(self._config.engine, work, shared, chain([first], chunks), Chunk.split):
                    outcome = failed_outcome(answer.item) if isinstance(answer, WorkerFailure) else answer
                    for result in self._store_outcome(claims, outcome):
                        self._callbacks.on_unit(result)
                    self._report_progress(claims)

    def _read_ahead(self, claims: Claims) -> None:
        self._files_ahead.clear()
        works, size = dict[str, str](), 0
        while self._unread and size < MAX_UNREAD_BYTES:
            serial = self._unread.popleft()
            if serial in self._work_hashes:
                continue
            if problem := self._folder.problems.get(serial):
                self._refuse(serial, problem)
                continue
            try:
                files = self._contents(serial)
            except InputError as error:
                self._refuse(serial, f"recording not readable: {error}")
                continue
            self._files_ahead[serial] = files
            works[serial] = self._work_sha256(serial, *files)
            size += sum(len(file.content) for file in files if file is not None)
        self._work_hashes |= works
        undecided = self._undecided(list(works))
        self._files_ahead = {serial: self._files_ahead[serial] for serial in undecided}
        claims.queue.enqueue(self._work, undecided)
        self._report_progress(claims)

    def _undecided(self, serials: Sequence[str]) -> dict[str, str]:
        """Return the work of the units whose newest result answers something else. Where the same
        work was calibrated before, that calibration is put into use again.
        """
        requested = {serial: self._work_hashes[serial] for serial in serials if serial not in self._decided}
        decided = self._registry.calibrations.decided_works(self._lot_id, list(requested))
        undecided = {serial: work for serial, work in requested.items() if decided.get(serial) != work}
        for serial, input_sha256 in self._registry.calibrations.inputs_of_works(self._lot_id, undecided).items():
            unit, actor = (self._registry, self._lot_id, serial), self._config.actor
            if put_back(*unit, input_sha256, "batch", actor=actor, work_sha256=undecided[serial]):
                del undecided[serial]
                self._decided.add(serial)
        return undecided

    def _refuse(self, serial: str, reason: Reason | str, work_sha256: str | None = None) -> None:
        details = {"actor": self._config.actor, "work_sha256": work_sha256}
        self._registry.calibrations.refuse(
            self._lot_id, serial, str(Verdict.RETEST), (Reason.parse(reason),), **details
        )
        self._decided.add(serial)

    def unit_results(self, serials: Sequence[str]) -> dict[str, UnitResult]:
        results, no_result = self._registry.pages.unit_statuses(self._lot_id, serials), (plain(NO_RESULT),)
        return {
            serial: replace(
                results.get(serial) or UnitResult(serial, Verdict.RETEST, no_result), is_new=serial in self._new
            )
            for serial in serials
        }

    def recordings(self, serials: Sequence[str]) -> dict[str, str]:
        """Return the hash of the recording that each calibrated unit was calibrated from."""
        missing = [serial for serial in serials if serial not in self._recordings]
        states = {serial: result.state for serial, result in self.unit_results(missing).items()}
        stored = {serial: state.fit.recording_sha256 for serial, state in states.items() if state is not None}
        return stored | {serial: self._recordings[serial] for serial in serials if serial in self._recordings}

    def _is_done(self, claims: Claims) -> bool:
        counts = claims.queue.counts(work=self._work)
        if self._unread or counts["queued"] + counts["claimed"] > 0:
            return False
        # A batch with other settings forgets what nobody worked at; rows can be lost.
        undecided = self._undecided(list(self._work_hashes))
        for item in claims.queue.exhausted_items(self._work):
            if undecided.pop(item.serial, None) is not None:
                self._refuse(item.serial, "not calibrated: the programs that worked on it died; run the batch again")
        return claims.queue.enqueue(self._work, undecided) == 0 and not undecided

    def _report_progress(self, claims: Claims) -> None:
        counts = claims.queue.counts(work=self._work)
        remaining = len(self._unread) + counts["queued"] + counts["claimed"]
        units = len(self._folder.unit_paths)
        self._callbacks.on_done(max(0, units - remaining), units)

    def _contents(self, serial: str) -> Files:
        folder = self._folder
        folder.check_name(serial)
        path, audit_path = folder.unit_paths[serial], folder.audit_paths.get(serial)
        audit = None if audit_path is None else FileContent(audit_path, read_regular(audit_path, folder.root))
        return FileContent(path, read_regular(path, folder.root)), audit

    def _work_sha256(self, serial: str, recording: FileContent, audit: FileContent | None) -> str:
        anchors, stored = self._config.anchors.get(serial), self._stored
        loads: object = None if anchors is None else [anchors.output.tolist(), anchors.reference.tolist()]
        if anchors is None and serial in stored.loads:
            loads = {sha256: values(one) for sha256, one in stored.loads[serial].items()}
        files = [file and [file.path.suffix, hashlib.sha256(file.content).hexdigest()] for file in (recording, audit)]
        day_correction = self._context.day_correction
        golden = None if day_correction and day_correction.is_measured else stored.golden.get(serial)
        extra: dict[str, object] = {} if golden is None else {"golden": golden}
        if audit is None and serial in stored.audits:
            extra["audit"] = stored.audits[serial].sha256
        if audit is not None and serial in self._folder.measured_at:
            extra["measured_at"] = self._folder.measured_at[serial].isoformat()
        return content_sha256({}, {"set": self._work.name, "files": files, "anchors": loads, **extra})

    def _chunks(self, claims: Claims) -> Iterator[Chunk]:
        while True:
            size = self._config.chunk or FIRST_CHUNK
            if self._config.chunk is None and self._unit_s is not None:
                size = min(max(1, math.ceil(CHUNK_S / max(self._unit_s, 1e-6))), LARGEST_CHUNK)
            items = claims.take(size)
            if not items and not self._unread:
                return
            if not items:
                self._read_ahead(claims)
                continue
            lot_items = [item for item in items if item.serial in self._folder.unit_paths]
            for item in items:
                if item not in lot_items:
                    # Asked for by a program with other files: it asks again.
                    claims.queue.finish(claims.owner, [item.id])
            if lot_items:
                yield Chunk(tuple(self._tasks(lot_items)))

    def _tasks(self, items: list[WorkItem]) -> Iterator[UnitTask]:
        serials = [item.serial for item in items]
        inputs_by_serial = (
            {} if self._config.refit else self._registry.calibrations.stored_inputs(self._lot_id, serials)
        )
        for item in items:
            try:
                files = self._files_ahead.pop(item.serial, None)
                recording, audit = files or self._contents(item.serial)
            except InputError as error:
                self._work_hashes.pop(item.serial, None)
                yield UnitTask(item.id, item.serial, None, problem=str(error))
                continue
            if files is None:
                # Asked for by another batch, or tried again: the file may be another by now.
                self._work_hashes[item.serial] = self._work_sha256(item.serial, recording, audit)
            inputs = self._stored.unit(item.serial, self._config.anchors.get(item.serial))
            existing, at = inputs_by_serial.get(item.serial, frozenset()), self._folder.measured_at.get(item.serial)
            yield UnitTask(item.id, item.serial, recording, audit, inputs, existing, declared_at=at)

    def _store_outcome(self, claims: Claims, outcome: ChunkOutcome) -> list[UnitResult]:
        if outcome.work_s and outcome.units:
            self._unit_s = outcome.work_s / len(outcome.units)
        self.files += [file for unit in outcome.units for file in unit.files]

        def store() -> dict[str, UnitResult]:
            with self._registry.transaction():
                leased_ids = claims.queue.lock_leased(claims.owner, [unit.task_id for unit in outcome.units])
                leased = [unit for unit in outcome.units if unit.task_id in leased_ids]
                for unit in leased:
                    self._register(unit)
                claims.queue.finish(claims.owner, [unit.task_id for unit in leased])
                return self.unit_results([unit.serial for unit in leased])

        # What was kept although the connection broke is not this batch's own any more.
        results = self._registry.database.once_more(store, is_repeatable=True)
        for result in results.values():
            revision = result.calibration and result.calibration.revision
            note("unit", lot=self._lot_id, serial=result.serial, verdict=result.verdict, revision=revision)
        return list(results.values())

    def _register(self, unit: UnitOutcome) -> None:
        registry, result, work = self._registry, unit.result, self._work_hashes.get(unit.serial)
        self._decided.add(unit.serial)
        try:
            with registry.part():
                for recording, kind, at in ((unit.recording, "unit", None), (unit.audit, "audit", unit.measured_at)):
                    if recording is not None:
                        actor = self._config.actor
                        registry.recordings.add(self._lot_id, recording, kind, actor=actor, measured_at=at)
                if isinstance(result, PassingRefusal):
                    details = {"lot": self._lot_id, "serial": unit.serial, "reason": str(result.reason)}
                    note("unit_failed", trace=result.trace, **details)
                statement = registry, self._lot_id, unit.serial, result, "batch"
                work_sha256 = None if isinstance(result, PassingRefusal) else work
                store_result(*statement, actor=self._config.actor, reason="batch", work_sha256=work_sha256)
            if unit.recording is not None and not isinstance(result, Refusal):
                self._recordings[unit.serial] = unit.recording.sha256
            if not isinstance(result, ExistingCalibration):
                self._new.add(unit.serial)
        except (RegistryError, SQLAlchemyError):
            raise
        except Exception as error:
            self._refuse(unit.serial, f"its result cannot be kept: {error}", work)
            self._new.add(unit.serial)


def _settings_sha256(lot: Lot, context: LotContext, is_refit: bool) -> str:
    """Return the hash of all inputs of a result besides the unit's own files."""
    networks = [model.network.id for model in context.sources]
    settings = {
        "lot": {name: value for name, value in lot.settings().items() if name != "limit_rmse"},
        "network": networks if len(networks) > 1 else networks[0],
        "method": context.source.method.id,
        "own": None if context.own_calibration is None else asdict(context.own_calibration),
        "limit": None if context.limit is None else context.limit.to_json(),
        "line": None if context.line is None else vars(context.line),
        **({} if context.reference is None else {"reference": context.reference.to_json()}),
        **({} if context.day_correction is None else {"golden": context.day_correction.sha256}),
        **({"rules": sorted(context.rules)} if context.rules else {}),
        # A newer version may read what an older one refused.
        "version": version("softcal"),
        # To fit again is work of its own, once with each build; interrupted, it goes on.
        "refit": build_id() if is_refit else None,
    }
    return content_sha256({}, settings)
