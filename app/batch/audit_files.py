"""Labelled recordings of audited units out of tables: what would become of each, and their way into the registry."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from softcal.app.files.importing import Columns, ImportPlan, LookedAt, look_through
from softcal.core.errors import InputError
from softcal.core.recording import LabelledRecording
from softcal.core.words.reason import Reason, plain, reason
from softcal.db.registry import Registry


@dataclass(frozen=True, eq=False)
class AuditFile:
    """What would become of one table.

    Args:
        file: its name.
        serial: of the unit it would audit.
        recording: None where it is refused.
        refusal: why; None where it is taken.
    """

    file: str
    serial: str
    recording: LabelledRecording | None
    refusal: Reason | None = None


def look_at_audits(registry: Registry, lot_id: str, files: Sequence[Path], columns: Columns) -> tuple[AuditFile, ...]:
    """Read tables as audits of units of a lot and say which would be refused and why; nothing is written.

    Args:
        files: one per unit, called by its serial, or wide ones with a column per unit.
        columns: which columns hold what.

    Raises:
        InputError: the lot is not in the registry.
    """
    lot = registry.lot(lot_id)
    units = {unit.serial for unit in registry.units(lot_id) if unit.role == "target"}
    return tuple(_looked(one, units) for one in look_through(ImportPlan(files, columns, lot, audit=True)))


def _looked(one: LookedAt, units: set[str]) -> AuditFile:
    if one.unit is None:
        return AuditFile(one.file, one.serial, None, plain(one.problem))
    if one.serial not in units:
        return AuditFile(one.file, one.serial, None, reason("audit.stranger", serial=one.serial))
    if one.unit.reference is None:
        return AuditFile(one.file, one.serial, None, Reason("audit.no_reference"))
    try:
        return AuditFile(one.file, one.serial, LabelledRecording(one.unit.recording, one.unit.reference))
    except InputError as error:
        return AuditFile(one.file, one.serial, None, error.reason)


def store_audits(registry: Registry, lot_id: str, found: Sequence[AuditFile], actor: str) -> int:
    """Keep the recordings that are not refused, and return how many; the next calibration of the lot scores them."""
    taken = [one.recording for one in found if one.recording is not None]
    with registry.transaction():
        for recording in taken:
            registry.add_recording(lot_id, recording, "audit", actor=actor)
    return len(taken)
