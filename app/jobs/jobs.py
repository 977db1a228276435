"""Jobs of pages: calibration of a lot, training of f, a comparison, a gap diagnosis, a check, an export.

A job reads its request from the registry, tells how far it is, and leaves its result there. What it registers (a
network) it registers as any command would.
"""

import shutil
import tempfile
import threading
import time
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from softcal.app.batch.lot_work import BatchConfig, Callbacks
from softcal.app.bootstrap import data_folder
from softcal.app.jobs.launch import DEMO
from softcal.app.logs import log_crash
from softcal.core.errors import InputError, SoftcalError
from softcal.core.identity import content_sha256
from softcal.core.messages.reason import pack_reasons, to_stored
from softcal.core.network.config import EpochReport, NetworkConfig
from softcal.core.orders import RunState
from softcal.core.recording import LabelledRecording
from softcal.db.queues.job_board import Job, JobBoard
from softcal.db.registry import Registry

if TYPE_CHECKING:
    from softcal.db.schema.arrays import Arrays

HEARTBEAT_S = 1.0
MAX_ARCHIVE_AGE_S = 24 * 3600.0
"""An archive stays for a day; it can be made again at any time."""

PRESSING, TRAINING = 0.35, 0.3
"""Shares of the bar for pressing the demo's units and for training; the units have the rest."""

REPORT_S = 0.4
"""Between two reports; each is one transaction."""


@dataclass(frozen=True)
class Outcome:
    """Result of a job: a sentence, JSON values, arrays."""

    message: str
    result: Mapping[str, Any] = field(default_factory=dict)
    arrays: "Arrays | None" = None


class Steps(Protocol):
    """Whoever shows how far a task is."""

    def step(self, fraction: float, name: str, **values: object) -> None: ...


class JobProgress:
    """Writes how far a job is, at most every `REPORT_S`."""

    def __init__(self, board: JobBoard, job_id: str) -> None:
        self._board, self._job_id, self._reported_s = board, job_id, 0.0

    def __call__(self, fraction: float, message: str, trace: Mapping[str, Any] | None = None) -> None:
        """Report the completed fraction (0 ... 1), a sentence and live values."""
        if time.monotonic() - self._reported_s >= REPORT_S:
            self._reported_s = time.monotonic()
            self._board.report(self._job_id, fraction, message, trace)

    def step(self, fraction: float, name: str, **values: object) -> None:
        """Report a step by the key of its text, `step.NAME`, for screens of any language."""
        self(fraction, "", {"step": name, "values": values})


def run_job(registry: Registry, job_id: str, on_cancel: Callable[[], None]) -> RunState:
    """Perform a job and return how it ended: with a result, or a line with the error.

    After a stop request another thread calls `on_cancel`, which ends the process.

    Raises:
        InputError: there is no such job, or it was taken already.
    """
    board = registry.job_board
    job = board.take(job_id)
    stop = threading.Event()
    thread = threading.Thread(
        target=_send_heartbeats, args=(board, job_id, stop, on_cancel), name="job beat", daemon=True
    )
    thread.start()
    try:
        handlers = {
            "train": train,
            "compare": compare,
            "diagnose": diagnose,
            "station_check": check,
            "demo": demo,
            "calibrate": calibrate,
            "archive": archive,
        }
        if job.kind not in handlers:
            raise InputError(f"jobs of kind {job.kind!r} are unknown to this version; known: {', '.join(handlers)}")
        outcome = handlers[job.kind](registry, job, JobProgress(board, job_id))
        board.end(job_id, RunState.DONE, outcome.message, outcome.result, outcome.arrays)
    except SoftcalError as error:
        board.end(job_id, RunState.ERROR, pack_reasons([error.reason]))
    except Exception as error:
        board.end(job_id, RunState.ERROR, log_crash(error, f"job {job.kind}"))
    finally:
        stop.set()
        thread.join()
    return board.job(job_id).state


def _send_heartbeats(board: JobBoard, job_id: str, stop: threading.Event, on_cancel: Callable[[], None]) -> None:
    while not stop.wait(HEARTBEAT_S):
        try:
            if board.write_heartbeat(job_id):
                board.end(job_id, RunState.CANCELLED, "cancelled")
                on_cancel()
                return
        except SoftcalError:
            continue  # Away for a moment: the next beat tries again.


def train(registry: Registry, job: Job, progress: JobProgress) -> Outcome:
    """Train f on a lot's newest source; request: lot, hidden, seed, members, max_epochs."""
    from softcal.app.batch.train import provide_network

    request = job.request
    lot = registry.lots.get(request["lot"])
    config = NetworkConfig(
        hidden=tuple(request["hidden"]),
        seed=request["seed"],
        members=request["members"],
        max_epochs=request["max_epochs"],
    )
    trace: dict[str, list[float]] = {"epoch": [], "train": [], "validation": []}

    def on_epoch(report: EpochReport) -> None:
        trace["epoch"].append(float(len(trace["epoch"]) + 1))
        trace["train"].append(round(report.train_rmse, 6))
        trace["validation"].append(round(report.validation_rmse, 6))
        done = (report.member + report.epoch / report.max_epochs) / config.members
        progress(done, f"{report.epoch} / {report.max_epochs}, {report.best_validation_rmse:.4g}", trace)

    progress(0.0, "")
    network = provide_network(lot, newest_source(registry, lot.id), registry, config, job.actor, on_epoch)
    result = {"network": network.network.id, "is_new": network.is_new, "trace": trace, **network.metrics}
    return Outcome(network.network.id[:12], result)


def newest_source(registry: Registry, lot_id: str) -> LabelledRecording:
    """Return the newest labelled recording of a lot's source.

    Raises:
        InputError: no source yet.
    """
    entries = registry.recordings.of_lot(lot_id, kind="source")
    if not entries:
        raise InputError(f"lot {lot_id!r} has no source recording; press its source unit first")
    source = registry.recordings.get(entries[-1].sha256)
    if not isinstance(source, LabelledRecording):
        raise ValueError("a source recording without reference")
    return source


def compare(registry: Registry, job: Job, progress: JobProgress) -> Outcome:
    """Map units with several networks and families; request: lot, networks, families, units."""
    from softcal.app.calibration.comparison import compare_on_lot

    rows = compare_on_lot(registry, job.request, progress)
    return Outcome("", {"rows": rows})


def diagnose(registry: Registry, job: Job, progress: JobProgress) -> Outcome:
    """Diagnose a case; request: case, experiment to press once more on a sealed rig, calibration."""
    from softcal.app.gap.diagnose import diagnose_case
    from softcal.app.gap.page_cases import ask_case, pack_diagnosis

    folder = Path(job.request["case"])
    if experiment := job.request.get("experiment"):
        progress(0.05, "pressing the proposed run")
        ask_case(folder, experiment)
    steps = 0

    def on_step(text: str) -> None:
        nonlocal steps
        steps += 1
        progress(min(0.95, 1 - 0.9**steps), text)

    report, arrays = pack_diagnosis(
        diagnose_case(folder, on_step, with_calibration=bool(job.request.get("calibration")))
    )
    return Outcome(report["verdict"], report, arrays)


def check(registry: Registry, job: Job, progress: JobProgress) -> Outcome:
    """Find and test the devices of a rig; request: file or simulated, ports, may_move."""
    from softcal.app.line.rig import check_station
    from softcal.station.bench.station_file import station_toml

    request = job.request
    file = None if request["file"] is None else Path(request["file"])
    progress(0.1, "")
    result = check_station(request["ports"], file, request["simulated"], request["may_move"])
    findings = [
        [to_stored(f.device), to_stored(f.what), to_stored(f.value), f.cure and to_stored(f.cure)]
        for f in result.findings
    ]
    ports = [[d.port, d.role, d.kind, to_stored(d.says)] for d in result.devices]
    return Outcome("", result.as_json() | {"ports": ports, "found": findings, "toml": station_toml(result.config)})


def lot_callbacks(progress: Steps, begin: float = 0.0) -> Callbacks:
    """Return callbacks that map training and units of a lot to one progress from `begin` to 1."""
    trained = begin + TRAINING * (1 - begin)

    def on_epoch(report: EpochReport) -> None:
        done = report.epoch / report.max_epochs
        progress.step(begin + (trained - begin) * done, "train", epoch=report.epoch, most=report.max_epochs)

    def on_done(done: int, units: int) -> None:
        progress.step(trained + (1 - trained) * done / max(units, 1), "units", done=done, total=units)

    return Callbacks(on_epoch=on_epoch, on_done=on_done)


def demo(registry: Registry, job: Job, progress: JobProgress) -> Outcome:
    """Press the demo's lot on a simulated station and calibrate it; request: units."""
    from softcal.app.batch.batch import run_batch
    from softcal.app.batch.lot_intake import lots_folder
    from softcal.app.line.demo import DemoConfig, press_demo_lot

    config = DemoConfig(units=job.request["units"], batch=BatchConfig(chunk=1, actor=job.actor))
    runs, total = 0, config.runs

    def on_run(_: str) -> None:
        nonlocal runs
        runs = min(runs + 1, total)
        progress.step(PRESSING * runs / total, "press", done=runs, total=total)

    progress.step(0.0, "press", done=0, total=total)
    folder = press_demo_lot(config, lots_folder() / DEMO, on_run)
    report = run_batch(folder, registry, config.batch, lot_callbacks(progress, PRESSING))
    return Outcome("", {"lot": report.lot_id, "counts": report.counts})


def calibrate(registry: Registry, job: Job, progress: JobProgress) -> Outcome:
    """Calibrate every unit of a lot; request: lot, map. Stored results are not computed again."""
    from softcal.app.batch.batch import run_batch
    from softcal.app.batch.lot_intake import lot_files, network_of

    lot_id = job.request["lot"]
    config = BatchConfig(network=network_of(registry, lot_id), family=job.request.get("map"), actor=job.actor)
    with lot_files(registry, lot_id, lambda done, total: progress.step(0.0, "read", done=done, total=total)) as folder:
        report = run_batch(folder, registry, config, lot_callbacks(progress))
    new = sum(unit.is_new for unit in report.units)
    return Outcome("", {"lot": lot_id, "counts": report.counts, "new": new, "known": len(report.units) - new})


def archives_folder() -> Path:
    """Return the folder of archives that wait to be taken."""
    folder = data_folder() / "archives"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def archive_path(job: Job) -> Path:
    """Return the path of a job's archive, while it is stored."""
    return archives_folder() / f"{job.job_id}.zip"


def archived_state(registry: Registry, lot_id: str) -> str:
    """Return the SHA-256 of what an archive of a lot rests on: every unit's verdict and state."""
    units = [[unit.serial, unit.verdict, unit.state_sha256] for unit in registry.lots.units(lot_id)]
    return content_sha256({}, {"units": units})


def archive(registry: Registry, job: Job, progress: JobProgress) -> Outcome:
    """Pack files and certificates of a lot; request: lot, serials, formats, release.

    `serials` None takes every calibrated unit; a unit whose device files are refused has its reports, and its reason.
    """
    from softcal.app.export.calibrated_unit import ExportOptions
    from softcal.app.export.export import ExportedUnit, export_units
    from softcal.core.unit.verdict import Release

    request = job.request
    lot_id = request["lot"]
    state = archived_state(registry, lot_id)
    calibrated = [
        unit.serial for unit in registry.lots.units(lot_id) if unit.role == "target" and unit.revision is not None
    ]
    serials = request["serials"] or calibrated
    if not serials:
        raise InputError(f"lot {lot_id!r} has no calibrated unit yet; there is nothing to pack")
    for file in archives_folder().glob("*.zip"):
        if time.time() - file.stat().st_mtime > MAX_ARCHIVE_AGE_S:
            file.unlink(missing_ok=True)
    options = ExportOptions(release=Release(request["release"]), lot_id=lot_id)
    done = 0

    def on_unit(_: ExportedUnit) -> None:
        nonlocal done
        done += 1
        progress.step(0.95 * done / len(serials), "files", done=done, total=len(serials))

    progress.step(0.0, "files", done=0, total=len(serials))
    with tempfile.TemporaryDirectory(prefix="softcal-archive-") as scratch:
        folder = Path(scratch) / "files"
        exported = export_units(registry, serials, request["formats"], folder, options, on_unit, folder_name="archive")
        zip_path = Path(scratch) / "files.zip"
        with zipfile.ZipFile(zip_path, "w", zipfile.ZIP_DEFLATED) as bundle:
            for file in sorted(folder.iterdir()):
                bundle.write(file, file.name)
        shutil.move(zip_path, archive_path(job))
    content = {"lot": lot_id, "units": len(serials), "formats": request["formats"]}
    registry.trail.add("export", "lots", (lot_id,), content, actor=job.actor)
    refused = [[unit.serial, unit.refusal] for unit in exported if unit.refusal]
    return Outcome("", {"lot": lot_id, "units": len(exported), "refused": refused, "state": state})
