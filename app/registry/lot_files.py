"""A lot of the registry as a lot folder, in files that people and `batch` take."""

from pathlib import Path

from softcal.app.files.anchors import write_anchors
from softcal.app.files.atomic import atomic_folder
from softcal.app.files.lot_folder import ANCHOR_FILES, FOLDER_OF, GOLDEN
from softcal.app.files.lot_toml import write_lot_toml
from softcal.app.files.recording_file import write_recording
from softcal.app.registry.golden import find_golden_runs
from softcal.app.registry.known_loads import known_loads
from softcal.app.registry.reference import lot_reference
from softcal.core.errors import InputError
from softcal.db.registry import Registry


def write_lot_folder(registry: Registry, lot_id: str, folder: Path) -> dict[str, list[str]]:
    """Write the newest recording of each unit and kind with its known loads as a lot folder, or nothing.

    The golden run is written where every unit belongs to the same one: a folder has one. Of several sittings the
    registry alone knows which unit belongs to which.

    Raises:
        InputError: no such lot, its source has no recording, or the folder exists and is not empty.
    """
    lot = registry.lots.get(lot_id)
    entries = {(entry.kind, entry.serial): entry for entry in registry.recordings.of_lot(lot_id)}
    newest = {key: entry.sha256 for key, entry in entries.items()}
    audits = {s: one.observed_at for (kind, s), one in entries.items() if kind == "audit" and s != lot.source}
    if ("source", lot.source) not in newest:
        raise InputError(f"lot {lot_id!r}: its source {lot.source} has no recording yet; press it first")
    paths_by_part: dict[str, list[str]] = {part: [] for part in FOLDER_OF.values()}
    with atomic_folder(folder) as part:
        write_lot_toml(part, lot, lot_reference(registry, lot_id), measured_at=audits)
        for (kind, serial), sha256 in newest.items():
            if (kind, serial) == ("audit", lot.source):
                continue
            write_recording(part / FOLDER_OF[kind] / f"{serial}.csv", registry.recordings.get(sha256))
            paths_by_part[FOLDER_OF[kind]].append(serial)
        unit_serials = {sha256: serial for (kind, serial), sha256 in newest.items() if kind == "unit"}
        golden_runs = find_golden_runs(registry, lot_id, set(unit_serials.values()))
        golden, *others = {golden_runs[sha256][1] if sha256 in golden_runs else None for sha256 in unit_serials} or {
            None
        }
        if golden is not None and not others:
            write_recording(part / GOLDEN / f"{lot.source}.csv", registry.recordings.get(golden))
            paths_by_part[GOLDEN] = [lot.source]
        stored_loads = known_loads(registry, lot_id, set(unit_serials.values()))
        loads = {
            s: stored_loads[sha].loads for (kind, s), sha in newest.items() if kind == "unit" and sha in stored_loads
        }
        if loads:
            write_anchors(part / ANCHOR_FILES[0], loads)
    return paths_by_part
