"""Jobs of a whole lot: the demo, a calibration of all its units, their files in one archive."""

import shutil
import tempfile
import time
import zipfile
from pathlib import Path

from softcal.app.batch.lot_work import BatchConfig, Watch
from softcal.app.bootstrap import data_folder
from softcal.app.jobs.outcome import Outcome, Teller
from softcal.app.jobs.process import DEMO
from softcal.core.errors import InputError
from softcal.core.network.config import EpochReport
from softcal.db.queues.job_board import Job
from softcal.db.registry import Registry

KEPT_S = 24 * 3600.0
"""An archive stays for a day; it can be made again at any time."""

PRESSING, TRAINING = 0.35, 0.3
"""Shares of the bar for pressing the demo's units and for training; the units have the rest."""


def lot_watch(tell: Teller, begin: float = 0.0) -> Watch:
    """Return a watch that tells training and units as one bar from `begin` to 1."""
    trained = begin + TRAINING * (1 - begin)

    def on_epoch(report: EpochReport) -> None:
        done = report.epoch / report.max_epochs
        tell.step(begin + (trained - begin) * done, "train", epoch=report.epoch, most=report.max_epochs)

    def on_done(done: int, units: int) -> None:
        tell.step(trained + (1 - trained) * done / max(units, 1), "units", done=done, total=units)

    return Watch(on_epoch=on_epoch, on_done=on_done)


def demo(registry: Registry, job: Job, tell: Teller) -> Outcome:
    """Press the demo's lot on a simulated station and calibrate it; request: units."""
    from softcal.app.batch.batch import run_batch
    from softcal.app.batch.front_door import lots_folder
    from softcal.app.line.demo import DemoConfig, press_demo_lot

    config = DemoConfig(units=job.request["units"], batch=BatchConfig(chunk=1, actor=job.actor))
    runs, total = 0, 1 + 2 * config.units

    def on_run(_: str) -> None:
        nonlocal runs
        runs = min(runs + 1, total)
        tell.step(PRESSING * runs / total, "press", done=runs, total=total)

    tell.step(0.0, "press", done=0, total=total)
    folder = press_demo_lot(config, lots_folder() / DEMO, on_run)
    report = run_batch(folder, registry, config.batch, lot_watch(tell, PRESSING))
    return Outcome("", {"lot": report.lot_id, "counts": report.counts})


def calibrate(registry: Registry, job: Job, tell: Teller) -> Outcome:
    """Calibrate every unit of a lot, or again; request: lot. What is known is not computed anew."""
    from softcal.app.batch.batch import run_batch
    from softcal.app.batch.front_door import lot_files, network_of

    lot_id = job.request["lot"]
    config = BatchConfig(network=network_of(registry, lot_id), actor=job.actor)
    with lot_files(registry, lot_id, lambda done, total: tell.step(0.0, "read", done=done, total=total)) as folder:
        report = run_batch(folder, registry, config, lot_watch(tell))
    new = sum(unit.is_new for unit in report.units)
    return Outcome("", {"lot": lot_id, "counts": report.counts, "new": new, "known": len(report.units) - new})


def archives_folder() -> Path:
    """Return the folder of archives that wait to be taken."""
    folder = data_folder() / "archives"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def archive_path(job: Job) -> Path:
    """Return where the archive of a job lies, as long as it is kept."""
    return archives_folder() / f"{job.job_id}.zip"


def archive(registry: Registry, job: Job, tell: Teller) -> Outcome:
    """Pack files and certificates of a lot; request: lot, serials, formats, release.

    `serials` None takes every calibrated unit; a unit whose device files are refused has its reports, and its reason.
    """
    from softcal.app.export.calibrated_unit import ExportOptions
    from softcal.app.export.certificates.laboratory import kept_laboratory
    from softcal.app.export.export import ExportedUnit, export_units
    from softcal.core.unit.verdict import Release

    request = job.request
    lot_id = request["lot"]
    known = [unit.serial for unit in registry.lots.units(lot_id) if unit.role == "target" and unit.revision is not None]
    serials = request["serials"] or known
    if not serials:
        raise InputError(f"lot {lot_id!r} has no calibrated unit yet; there is nothing to pack")
    for file in archives_folder().glob("*.zip"):
        if time.time() - file.stat().st_mtime > KEPT_S:
            file.unlink(missing_ok=True)
    options = ExportOptions(release=Release(request["release"]), lot_id=lot_id, laboratory=kept_laboratory())
    done = 0

    def on_unit(_: ExportedUnit) -> None:
        nonlocal done
        done += 1
        tell.step(0.95 * done / len(serials), "files", done=done, total=len(serials))

    tell.step(0.0, "files", done=0, total=len(serials))
    with tempfile.TemporaryDirectory(prefix="softcal-archive-") as place:
        folder = Path(place) / "files"
        exported = export_units(registry, serials, request["formats"], folder, options, on_unit)
        packed = Path(place) / "files.zip"
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as into:
            for file in sorted(folder.iterdir()):
                into.write(file, file.name)
        shutil.move(packed, archive_path(job))
    facts = {"lot": lot_id, "units": len(serials), "formats": request["formats"]}
    registry.trail.add("export", "lots", (lot_id,), facts, actor=job.actor)
    refused = [[unit.serial, unit.refusal] for unit in exported if unit.refusal]
    return Outcome("", {"lot": lot_id, "units": len(exported), "refused": refused})
