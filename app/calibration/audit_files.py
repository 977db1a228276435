"""Labelled recordings of audited units out of tables: what becomes of each, where it is kept."""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path

from softcal.app.files.import_plan import Columns, ImportPlan
from softcal.app.files.importing import preview_import
from softcal.app.files.lot_toml import update_measured_at
from softcal.app.files.measured_at import measured_at
from softcal.app.files.recording_file import FileRecording, replace_table, write_rows
from softcal.app.files.unused_input import UnusedInput
from softcal.app.files.unused_parts import no_reference_column
from softcal.app.registry.same_recordings import same_recordings_with
from softcal.app.tables.options import DETECT, TableOptions
from softcal.core.errors import InputError
from softcal.core.inspection.comparison import compare_with_source
from softcal.core.lot import Lot
from softcal.core.messages.reason import Reason, plain, reason
from softcal.core.quality.duplicate_recordings import RecordedOutput, same_recordings
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.db.registry import Registry


@dataclass(frozen=True, eq=False)
class AuditFile:
    """What would become of one table: a recording and when it was measured (UTC), or why it is refused."""

    file: str
    serial: str
    recording: LabelledRecording | None
    refusal: Reason | None = None
    read: FileRecording | None = None
    measured_at: datetime | None = None


def unused_of_audits(
    lot: Lot,
    audits: Sequence[AuditFile],
    registry: Registry | None = None,
    others: Iterable[OutputRecording | LabelledRecording] = (),
    source: LabelledRecording | None = None,
) -> tuple[tuple[UnusedInput, ...], tuple[Reason, ...]]:
    """Return the audits that are not taken, and the remarks on those that are.

    Args:
        registry: with whose recordings the audits are compared, too.
        others: recordings of the lot that they are compared with.
        source: whose unit of measure and sign they should have.
    """
    refused = [
        UnusedInput("audit", one.serial, one.refusal, one.file)
        if one.serial
        else UnusedInput("file", one.file, one.refusal)
        for one in audits
        if one.refusal is not None
    ]
    accepted = [one.recording for one in audits if one.recording is not None]
    recorded_outputs = [RecordedOutput(one.serial, lot.id, one.output_sha256) for one in (*accepted, *others)]
    remarks = (
        same_recordings(recorded_outputs) if registry is None else same_recordings_with(registry, recorded_outputs)
    )
    compared = () if source is None else compare_with_source(source, accepted)
    return tuple(refused), (*compared, *remarks)


def read_audit_files(
    lot: Lot,
    units: Collection[str],
    files: Sequence[Path],
    columns: Columns,
    table: TableOptions = DETECT,
    declared_at: datetime | None = None,
) -> tuple[AuditFile, ...]:
    """Read tables as audits of a lot's units, and say which would be refused and why. A table is of
    one unit and called by its serial, or wide with a column per unit.

    Args:
        declared_at: when they were measured, UTC, where their own stamps do not tell.
    """
    plan = ImportPlan(files, columns, lot, audit=True, table=table)
    audit_files = []
    for preview in preview_import(plan):
        recording, refusal, at = None, None, None
        if preview.unit is None:
            refusal = plain(preview.problem)
        elif preview.serial not in units:
            refusal = reason("audit.foreign_unit", serial=preview.serial)
        elif preview.unit.reference is None:
            has_reference_name = columns.reference is not None
            refusal = (
                no_reference_column(columns, preview.unit.file.table)
                if has_reference_name
                else Reason("audit.no_reference")
            )
        else:
            try:
                at = measured_at(preview.unit.audit or preview.unit.file, declared_at)
                recording = preview.unit.labelled(lot.reference_unit)
            except InputError as error:
                refusal = error.reason
        read = None if preview.unit is None else preview.unit.audit or preview.unit.file
        audit_files.append(AuditFile(preview.file, preview.serial, recording, refusal, read, at))
    return tuple(audit_files)


def write_audits(folder: Path, audits: Sequence[AuditFile]) -> list[str]:
    """Write the recordings that are taken into audit/, and when they were measured; return the serials replaced."""
    accepted = {audit.serial: audit for audit in audits if audit.recording is not None}
    read = {serial: audit.read for serial, audit in accepted.items() if audit.read is not None}
    paths = {serial: folder / "audit" / f"{serial}.csv" for serial in read}
    replaced = [serial for serial, file in read.items() if replace_table(paths[serial], partial(write_rows, file=file))]
    update_measured_at(folder, {serial: audit.measured_at for serial, audit in accepted.items()})
    return replaced


def store_audits(registry: Registry, lot_id: str, audits: Sequence[AuditFile], actor: str | None = None) -> int:
    """Keep the recordings that are taken, and return how many; the next calibration has them."""
    accepted = [(audit.recording, audit.measured_at) for audit in audits if audit.recording is not None]
    with registry.transaction():
        for recording, at in accepted:
            registry.recordings.add(lot_id, recording, "audit", actor=actor, measured_at=at)
    return len(accepted)
