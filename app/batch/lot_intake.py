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
from softcal.app.files.importing import LookedAt, compare_audits, import_lot, look_through
from softcal.app.files.lot_folder import FOLDER_OF, LotFolder, open_lot_folder
from softcal.app.files.lot_toml import write_lot_toml
from softcal.app.files.not_used import NotUsed
from softcal.app.files.recording_file import replace_table, write_recording
from softcal.app.files.unused_parts import unused_of_import
from softcal.app.registry.lot_recordings import newest_audits, source_recording
from softcal.app.registry.same_recordings import same_recordings_with
from softcal.core.errors import InputError, UnitRefused
from softcal.core.messages.reason import Reason
from softcal.core.network.config import NetworkConfig
from softcal.core.quality.same_recording import Pressed
from softcal.core.unit.findings import contradictions
from softcal.core.unit.health import check_alive, health_findings, output_limits
from softcal.core.unit.method import Method
from softcal.db.registry import Registry


@dataclass(frozen=True)
class Expected:
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
class ExpectedLot:
    """Preview of the tables of a new lot.

    Args:
        audits: serials of targets whose references would be audits.
        not_used: unused parts of the tables; a refusal is listed with its unit.
        remarks: what is odd and no error, here and against the registry.
    """

    units: tuple[Expected, ...]
    audits: tuple[str, ...]
    not_used: tuple[NotUsed, ...]
    remarks: tuple[Reason, ...]


def expect(plan: ImportPlan, registry: Registry) -> ExpectedLot:
    """Return the preview of every unit of a plan, without writing or fitting."""
    looks = look_through(plan)
    source = next((look for look in looks if look.serial == plan.lot.source), None)
    units = tuple(_expected(look, source, plan) for look in looks)
    tables = [(look.path, look.serial, look.unit) for look in looks if look.unit is not None]
    audits, not_used = unused_of_import(plan, tables)
    pressed = [Pressed(serial, plan.lot.id, unit.recording.output_sha256) for _, serial, unit in tables]
    compared = compare_audits(plan, {serial: unit for _, serial, unit in tables})
    return ExpectedLot(units, tuple(audits), not_used, (*compared, *same_recordings_with(registry, pressed)))


def _expected(look: LookedAt, source: LookedAt | None, plan: ImportPlan) -> Expected:
    if look.unit is None:
        return Expected(look.file, look.serial, problem=look.problem)
    recording, reference = look.unit.recording, look.unit.reference
    facts = (look.file, look.serial, len(recording), len(recording) / plan.lot.sample_rate_Hz)
    if source is look and reference is None:
        return Expected(*facts, problem=f"the source {look.serial} has no reference")
    if source is None or source is look or source.unit is None or source.unit.reference is None:
        return Expected(*facts)
    method, known = Method(), source.unit.recording
    try:
        check_alive(recording, known, method.health)
    except UnitRefused as error:
        return Expected(*facts, findings=(error.reason,))
    is_rising = source.unit.labelled(plan.lot.reference_unit).direction > 0
    limits = output_limits(recording, known, is_rising, method)
    against = contradictions(known, recording, limits, method) or health_findings(
        recording, known, limits, method.health
    )
    return Expected(*facts, findings=tuple(finding.reason for finding in against))


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
def lot_files(registry: Registry, lot_id: str, tell: Callable[[int, int], None]) -> Iterator[LotFolder]:
    """Yield a lot as a folder: the registry's newest recordings, and files not read before.

    Raises:
        InputError: the lot has no source recording.
    """
    lot, stored = registry.lots.get(lot_id), lots_folder() / lot_id
    newest = {(one.kind, one.serial): one for one in registry.recordings.of_lot(lot_id) if one.kind != "audit"}
    newest |= {("audit", serial): entry for serial, entry in newest_audits(registry, lot_id).items()}
    with tempfile.TemporaryDirectory(prefix="softcal-lot-") as place:
        folder = Path(place) / "lot"
        if stored.is_dir():
            shutil.copytree(stored, folder)
        folder.mkdir(exist_ok=True)
        others = [source_recording(registry, network).serial for network in declared_sources(registry, lot_id)]
        measured_at = open_lot_folder(folder).measured_at if stored.is_dir() else {}
        audits = {serial: entry.observed_at for (kind, serial), entry in newest.items() if kind == "audit"}
        write_lot_toml(folder, lot, more_sources=others, measured_at={**measured_at, **audits})
        # Parquet keeps every bit, so that the same recording is known again.
        for number, ((kind, serial), entry) in enumerate(newest.items()):
            tell(number, len(newest))
            recording = registry.recordings.get(entry.sha256)
            replace_table(folder / FOLDER_OF[kind] / f"{serial}.parquet", partial(write_recording, recording=recording))
        yield open_lot_folder(folder)


def network_of(registry: Registry, lot_id: str) -> NetworkConfig:
    """Return how the network in use was trained; the usual way without one."""
    state = registry.networks.released(lot_id)
    return config_of(state.network) if state else NetworkConfig()
