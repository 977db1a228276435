"""The audits of a lot's units that the registry keeps: what was measured stands until it is measured anew."""

from softcal.core.recording import LabelledRecording
from softcal.db.entries import RecordingEntry
from softcal.db.registry import Registry


def newest_audits(registry: Registry, lot_id: str, serial: str | None = None) -> dict[str, RecordingEntry]:
    """Return the newest audit of each unit of a lot, or of one of them, by serial.

    A golden unit's labelled runs check the station and its day; they are no audits of the lot. Of a run that does not
    say which recording it is, all of its unit's are.
    """
    runs = registry.stations.golden_runs()
    checks = {run.recording_sha256 for run in runs}
    units = {run.serial for run in runs if run.recording_sha256 is None} | {registry.lots.get(lot_id).source}
    entries = registry.recordings.of_lot(lot_id, serial, "audit")
    return {one.serial: one for one in entries if one.serial not in units and one.sha256 not in checks}


def audit_of(registry: Registry, entry: RecordingEntry | None) -> LabelledRecording | None:
    """Read an audit; None where there is none."""
    found = None if entry is None else registry.recordings.get(entry.sha256)
    return found if isinstance(found, LabelledRecording) else None
