"""What another process computes for a page: a lot, f, a comparison, a gap, a check, files.

A job reads its request from the registry, tells how far it is, and leaves its result there. What it registers (a
network) it registers as any command would.
"""

import threading
from collections.abc import Callable, Mapping
from pathlib import Path

from softcal.app.jobs.outcome import Outcome, Teller
from softcal.app.logs import log_crash
from softcal.core.errors import InputError, SoftcalError
from softcal.core.network.config import EpochReport, NetworkConfig
from softcal.core.orders import RunState
from softcal.core.recording import LabelledRecording
from softcal.core.words.reason import packed, to_kept
from softcal.db.queues.job_board import Job, JobBoard
from softcal.db.registry import Registry

BEAT_S = 1.0

Work = Callable[[Registry, Job, Teller], Outcome]


def run_job(registry: Registry, job_id: str, on_cancel: Callable[[], None]) -> RunState:
    """Do a job and return how it ended: always with a result, or a line that says why not.

    Args:
        on_cancel: called from another thread once somebody wants the job stopped and it is marked so; ends the process.

    Raises:
        InputError: there is no such job, or it was taken already.
    """
    board = registry.job_board
    job = board.take(job_id)
    over = threading.Event()
    beater = threading.Thread(target=_beat, args=(board, job_id, over, on_cancel), name="job beat", daemon=True)
    beater.start()
    try:
        outcome = _work(job.kind)(registry, job, Teller(board, job_id))
        board.end(job_id, RunState.DONE, outcome.message, outcome.result, outcome.arrays)
    except SoftcalError as error:
        board.end(job_id, RunState.ERROR, packed([error.reason]))
    except Exception as error:
        board.end(job_id, RunState.ERROR, log_crash(error, f"job {job.kind}"))
    finally:
        over.set()
        beater.join()
    return board.job(job_id).state


def _beat(board: JobBoard, job_id: str, over: threading.Event, on_cancel: Callable[[], None]) -> None:
    while not over.wait(BEAT_S):
        try:
            if board.beat(job_id):
                board.end(job_id, RunState.CANCELLED, "cancelled")
                on_cancel()
                return
        except SoftcalError:
            continue  # Away for a moment: the next beat tries again.


def _work(kind: str) -> Work:
    from softcal.app.jobs import lot_jobs

    works: Mapping[str, Work] = {
        "train": train,
        "compare": compare,
        "diagnose": diagnose,
        "station_check": check,
        "demo": lot_jobs.demo,
        "calibrate": lot_jobs.calibrate,
        "archive": lot_jobs.archive,
    }
    if kind not in works:
        raise InputError(f"jobs of kind {kind!r} are unknown to this version; known: {', '.join(works)}")
    return works[kind]


def train(registry: Registry, job: Job, tell: Teller) -> Outcome:
    """Train f on a lot's newest source; request: lot, hidden, seed, members, max_epochs."""
    from softcal.app.batch.train import train_or_find

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
        tell(done, f"{report.epoch} / {report.max_epochs}, {report.best_validation_rmse:.4g}", trace)

    tell(0.0, "")
    network = train_or_find(lot, newest_source(registry, lot.id), registry, config, job.actor, on_epoch)
    result = {"network": network.network.id, "is_new": network.is_new, "trace": trace, **network.metrics}
    return Outcome(network.network.id[:12], result)


def newest_source(registry: Registry, lot_id: str) -> LabelledRecording:
    """Return the newest labelled recording of a lot's source.

    Raises:
        InputError: there is none yet.
    """
    entries = registry.recordings.of_lot(lot_id, kind="source")
    if not entries:
        raise InputError(f"lot {lot_id!r} has no source recording; press its source unit first")
    source = registry.recordings.get(entries[-1].sha256)
    if not isinstance(source, LabelledRecording):
        raise ValueError("a source recording without reference")
    return source


def compare(registry: Registry, job: Job, tell: Teller) -> Outcome:
    """Map units with several networks and families; request: lot, networks, families, units."""
    from softcal.app.batch.compare import compare_on_lot

    rows = compare_on_lot(registry, job.request, tell)
    return Outcome("", {"rows": rows})


def diagnose(registry: Registry, job: Job, tell: Teller) -> Outcome:
    """Diagnose a case; request: case, experiment to press once more on a sealed rig."""
    from softcal.app.gap.desk import ask_case, kept_of
    from softcal.app.gap.diagnose import diagnose_case

    folder = Path(job.request["case"])
    if experiment := job.request.get("experiment"):
        tell(0.05, "pressing the proposed run")
        ask_case(folder, experiment)
    steps = 0

    def on_step(text: str) -> None:
        nonlocal steps
        steps += 1
        tell(min(0.95, 1 - 0.9**steps), text)

    report, arrays = kept_of(diagnose_case(folder, on_step))
    return Outcome(report["verdict"], report, arrays)


def check(registry: Registry, job: Job, tell: Teller) -> Outcome:
    """Find and test the devices of a rig; request: file or simulated, ports, may_move."""
    from softcal.app.line.rig import check_station
    from softcal.station.devices.config import station_toml

    request = job.request
    file = None if request["file"] is None else Path(request["file"])
    tell(0.1, "")
    checked = check_station(request["ports"], file, request["simulated"], request["may_move"])
    findings = [
        [to_kept(f.device), to_kept(f.what), to_kept(f.value), f.cure and to_kept(f.cure)] for f in checked.findings
    ]
    ports = [[d.port, d.role, d.kind, to_kept(d.says)] for d in checked.devices]
    return Outcome("", checked.as_json() | {"ports": ports, "found": findings, "toml": station_toml(checked.config)})
