"""Preview of a new or repeated lot before any fit."""

import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from softcal.app.bootstrap import data_folder
from softcal.app.calibration.lot_context import config_of, declared_sources
from softcal.app.files.import_plan import ImportPlan
from softcal.app.files.importing import ImportPreview, compare_audits, import_lot, preview_import
from softcal.app.files.lot_folder import FOLDER_OF, LotFolder, open_lot_folder
from softcal.app.files.lot_toml import write_lot_toml
from softcal.app.files.recording_file import replace_table, write_recording
from softcal.app.files.unused_input import UnusedInput
from softcal.app.files.unused_parts import unused_of_import
from softcal.app.registry.lot_recordings import newest_audits, source_recording
from softcal.app.registry.same_recordings import same_recordings_with
from softcal.core.errors import InputError, UnitRefused
from softcal.core.messages.reason import Reason
from softcal.core.network.config import NetworkConfig
from softcal.core.quality.duplicate_recordings import RecordedOutput
from softcal.core.unit.findings import contradictions
from softcal.core.unit.health import check_alive, health_findings, output_limits
from softcal.core.unit.method import Method
from softcal.db.registry import Registry


@dataclass(frozen=True)
class UnitPreview:
    """Preview of one unit of a new lot.

    `problem` is the reason of a refusal before any fit, `findings` are those of its output alone: with these it will
    not pass.
    """

    file: str
    serial: str
    rows: int = 0
    seconds: float = 0.0
    problem: str = ""
    findings: tuple[Reason, ...] = ()


@dataclass(frozen=True)
class LotPreview:
    """Preview of the tables of a new lot.

    Args:
        audits: serials of targets whose references would be audits.
        not_used: unused parts of the tables; a refusal is listed with its unit.
        remarks: what is odd and no error, here and against the registry.
    """

    units: tuple[UnitPreview, ...]
    audits: tuple[str, ...]
    not_used: tuple[UnusedInput, ...]
    remarks: tuple[Reason, ...]


def preview_lot(plan: ImportPlan, registry: Registry) -> LotPreview:
    """Return the preview of every unit of a plan, without writing or fitting."""
    previews = preview_import(plan)
    source = next((preview for preview in previews if preview.serial == plan.lot.source), None)
    units = tuple(_preview_unit(preview, source, plan) for preview in previews)
    tables = [(preview.path, preview.serial, preview.unit) for preview in previews if preview.unit is not None]
    audits, not_used = unused_of_import(plan, tables)
    recorded_outputs = [RecordedOutput(serial, plan.lot.id, unit.recording.output_sha256) for _, serial, unit in tables]
    comparisons = compare_audits(plan, {serial: unit for _, serial, unit in tables})
    return LotPreview(units, tuple(audits), not_used, (*comparisons, *same_recordings_with(registry, recorded_outputs)))


def _preview_unit(preview: ImportPreview, source: ImportPreview | None, plan: ImportPlan) -> UnitPreview:
    if preview.unit is None:
        return UnitPreview(preview.file, preview.serial, problem=preview.problem)
    recording, reference = preview.unit.recording, preview.unit.reference
    details = (preview.file, preview.serial, len(recording), len(recording) / plan.lot.sample_rate_Hz)
    if source is preview and reference is None:
        return UnitPreview(*details, problem=f"the source {preview.serial} has no reference")
    if source is None or source is preview or source.unit is None or source.unit.reference is None:
        return UnitPreview(*details)
    method, source_output = Method(), source.unit.recording
    try:
        check_alive(recording, source_output, method.health)
    except UnitRefused as error:
        return UnitPreview(*details, findings=(error.reason,))
    is_rising = source.unit.labelled(plan.lot.reference_unit).direction > 0
    limits = output_limits(recording, source_output, is_rising, method)
    findings = contradictions(source_output, recording, limits, method) or health_findings(
        recording, source_output, limits, method
    )
    return UnitPreview(*details, findings=tuple(finding.reason for finding in findings))


def lots_folder() -> Path:
    """Return the folder of the lots that came through a browser."""
    folder = data_folder() / "lots"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def store_lot(registry: Registry, plan: ImportPlan, actor: str) -> Path:
    """Write a new lot's folder, whole or not at all, and register the lot; return the folder.

    Raises:
        InputError: the registry knows a lot of this name, or a file cannot be used.
    """
    if plan.lot.id in registry.lots.ids():
        raise InputError(f"lot {plan.lot.id!r} is in the registry already; choose another name for the new lot")
    folder = lots_folder() / plan.lot.id
    # Without a lot in the registry it is left from one that came to nothing.
    shutil.rmtree(folder, ignore_errors=True)
    import_lot(plan, folder)
    registry.lots.add(plan.lot, actor=actor)
    return folder


@contextmanager
def lot_files(registry: Registry, lot_id: str, on_progress: Callable[[int, int], None]) -> Iterator[LotFolder]:
    """Yield a lot as a folder: the registry's newest recordings, and files not read before.

    Raises:
        InputError: the lot has no source recording.
    """
    lot, stored = registry.lots.get(lot_id), lots_folder() / lot_id
    newest = {(one.kind, one.serial): one for one in registry.recordings.of_lot(lot_id) if one.kind != "audit"}
    newest |= {("audit", serial): entry for serial, entry in newest_audits(registry, lot_id).items()}
    with tempfile.TemporaryDirectory(prefix="softcal-lot-") as scratch:
        folder = Path(scratch) / "lot"
        if stored.is_dir():
            shutil.copytree(stored, folder)
        folder.mkdir(exist_ok=True)
        others = [source_recording(registry, network).serial for network in declared_sources(registry, lot_id)]
        measured_at = open_lot_folder(folder).measured_at if stored.is_dir() else {}
        audits = {serial: entry.observed_at for (kind, serial), entry in newest.items() if kind == "audit"}
        write_lot_toml(folder, lot, more_sources=others, measured_at={**measured_at, **audits})
        # Parquet keeps every bit, so that the same recording is known again.
        for number, ((kind, serial), entry) in enumerate(newest.items()):
            on_progress(number, len(newest))
            recording = registry.recordings.get(entry.sha256)
            replace_table(folder / FOLDER_OF[kind] / f"{serial}.parquet", partial(write_recording, recording=recording))
        yield open_lot_folder(folder)


def network_of(registry: Registry, lot_id: str) -> NetworkConfig:
    """Return how the network in use was trained; the usual way without one."""
    state = registry.networks.released(lot_id)
    return config_of(state.network) if state else NetworkConfig()
