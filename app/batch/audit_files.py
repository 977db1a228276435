"""Labelled recordings of audited units out of tables: what becomes of each, where it is kept."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from softcal.app.files.importing import Columns, ImportPlan, LookedAt, look_through
from softcal.app.files.recording_file import replace_recording
from softcal.core.errors import InputError
from softcal.core.lot import Lot
from softcal.core.recording import LabelledRecording
from softcal.core.words.reason import Reason, plain, reason
from softcal.db.registry import Registry


@dataclass(frozen=True, eq=False)
class AuditFile:
    """What would become of one table.

    Args:
        recording: None where it is refused.
        refusal: why; None where it is taken.
    """

    file: str
    serial: str
    recording: LabelledRecording | None
    refusal: Reason | None = None


def look_at_audits(
    lot: Lot, units: Collection[str], files: Sequence[Path], columns: Columns, sheet: str | None = None
) -> tuple[AuditFile, ...]:
    """Read tables as audits of a lot's units and say which would be refused and why.

    Args:
        files: one per unit, called by its serial, or wide ones with a column per unit.
    """
    plan = ImportPlan(files, columns, lot, audit=True, sheet=sheet)
    return tuple(_looked(one, units) for one in look_through(plan))


def _looked(one: LookedAt, units: Collection[str]) -> AuditFile:
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


def write_audits(folder: Path, found: Sequence[AuditFile]) -> list[str]:
    """Write the recordings that are taken into audit/; return the serials of those replaced."""
    taken = {one.serial: one.recording for one in found if one.recording is not None}
    return [serial for serial, one in taken.items() if replace_recording(folder / "audit", serial, ".csv", one)]


def store_audits(registry: Registry, lot_id: str, found: Sequence[AuditFile], actor: str | None = None) -> int:
    """Keep the recordings that are taken, and return how many; the next calibration has them."""
    taken = [one.recording for one in found if one.recording is not None]
    with registry.transaction():
        for recording in taken:
            registry.recordings.add(lot_id, recording, "audit", actor=actor)
    return len(taken)
