"""Calibration files of units: one folder with a manifest, and the same bytes every time."""

import json
import socket
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from softcal.app.export.calibrated_unit import CalibratedUnit, ExportOptions, UnitLoader
from softcal.app.export.formats import Writer, device_summary, find_writer
from softcal.app.export.manifest import NAME, FileEntry, Manifest, read_manifest, withdraw_units, write_manifest
from softcal.app.export.names import AUDIT, DETACHED_PREFIXES, DETACHED_SUFFIX, DEVICE_FORMATS, DOCUMENT_FORMATS
from softcal.app.export.names import formats as list_formats
from softcal.app.export.signature import SigningKey
from softcal.app.files.atomic import write_bytes, write_text
from softcal.app.registry.anchors import anchor_json, record_heads
from softcal.app.registry.exported_files import Recall, list_recalls, record_exported_files
from softcal.core.errors import InputError, UnitRefused
from softcal.core.export.blob import serial_field
from softcal.db.registry import Registry


@dataclass(frozen=True, eq=False)
class ExportedUnit:
    """Written files of one unit, or the reason for their absence.

    Args:
        files: names of the files in the folder.
        refusal: why files that give numbers were not written; None where all were.
        device: sizes and errors of the device form; empty without one.
    """

    serial: str
    revision: int
    verdict: str
    files: tuple[str, ...]
    refusal: str | None = None
    device: Mapping[str, object] = field(default_factory=dict)


def export_units(
    registry: Registry,
    serials: Sequence[str],
    formats: Sequence[str],
    out: Path,
    options: ExportOptions = ExportOptions(),  # noqa: B008
    on_unit: Callable[[ExportedUnit], object] = lambda _: None,
    folder_name: str | None = None,
) -> list[ExportedUnit]:
    """Write the calibration files of units and the manifest of the folder.

    A unit whose device form is refused (its verdict, its map) still gets and keeps its documents, and
    the reason stands in the manifest; an older device file of it is taken out of the folder. A unit
    that was refused after its calibration was made gets no file at all. The other units go on.

    Args:
        formats: names of `softcal.app.export.names.formats`.
        out: folder; files of other units in it stay, and stay in its manifest.
        on_unit: called after each unit.
        folder_name: where the files go, as the registry remembers it; None: this folder.

    Raises:
        InputError: an unknown format or serial, serials a device could not tell apart, also one of another lot that
            is in the folder already, or a folder that cannot be written.
    """
    if not formats:
        raise InputError(f"no format is given; known: {', '.join(list_formats())}")
    writers = {name: find_writer(name) for name in dict.fromkeys(formats)}
    by_field: dict[str, str] = {}
    for serial in serials:
        for device_name in {serial.casefold(), serial_field(serial).rstrip(b"\0").decode().casefold()}:
            if device_name in by_field:
                raise InputError(
                    f"serials {by_field[device_name]} and {serial} look the same to a device; export one of them"
                )
            by_field[device_name] = serial
    if len(serials) > 1:
        calibrated = {unit.serial for unit in registry.lots.units(options.lot_id) if unit.revision is not None}
        if unknown := [serial for serial in serials if serial not in calibrated]:
            raise InputError(f"the registry has no calibration of {', '.join(unknown[:5])}; nothing was written")
    key = options.signing_key
    manifest, loader = read_manifest(out), UnitLoader(registry, options)
    for serial in serials:
        manifest.check_lot(registry.calibrations.unit_key(serial, options.lot_id))
    exported, file_records = [], {}
    for serial in serials:
        unit = loader.load(serial)
        exported.append(_export(unit, writers, out, manifest, key))
        if exported[-1].refusal is None and not DOCUMENT_FORMATS.issuperset(writers):
            file_records[unit.stored.key] = exported_file_record(unit)
        on_unit(exported[-1])
    write_manifest(out, manifest, key)
    record_exported_files(registry, file_records, str(out.absolute()) if folder_name is None else folder_name)
    record_heads(registry, f"export {out.absolute()}")
    write_text(out / AUDIT, json.dumps(anchor_json(registry, "export"), indent=2, sort_keys=True) + "\n")
    return exported


def lot_serials(registry: Registry, lot_id: str, options: ExportOptions) -> list[str]:
    """Return the released calibrated units of a lot; raise `InputError` without any."""
    units = [unit for unit in registry.lots.units(lot_id) if unit.revision is not None]
    serials = [unit.serial for unit in units if unit.verdict and options.releases(unit.verdict)]
    if not serials:
        raise InputError(f"lot {lot_id!r} has no unit to export: {len(units)} are calibrated, none of them is released")
    return serials


def exported_file_record(unit: CalibratedUnit) -> Mapping[str, object]:
    """Return the registry's record of the exported files of a unit."""
    return {"revision": unit.stored.revision, "map_sha256": unit.state.map_sha256, "verdict": unit.verdict}


def withdraw_recalled_files(registry: Registry, lot_ids: Sequence[str]) -> list[Recall]:
    """Remove files that are no longer valid from the folders of this computer; return the recalled ones."""
    recalls, hostname = list_recalls(registry, lot_ids), socket.gethostname()
    for folder_name, lot_id in sorted({(one.place, one.lot) for one in recalls if one.host == hostname}):
        if not (Path(folder_name) / NAME).is_file():
            continue
        verdicts = {
            one.serial: one.verdict
            for one in recalls
            if (one.place, one.lot, one.host) == (folder_name, lot_id, hostname)
        }
        withdraw_units(Path(folder_name), lot_id, (), verdicts)
    return recalls


def _export(
    unit: CalibratedUnit, writers: Mapping[str, Writer], out: Path, manifest: Manifest, key: SigningKey | None
) -> ExportedUnit:
    """Write the files of a unit in each format, and remove files that it no longer has."""
    fit, serial = unit.state.fit, unit.serial
    contents: dict[str, bytes] = {}
    refusal, documents = None, list[str]()
    for write in writers.values():
        try:
            contents |= write(unit)
        except UnitRefused as error:
            refusal = str(error)
    detached = [name for name in contents if name.startswith(DETACHED_PREFIXES)]
    contents |= {f"{name}{DETACHED_SUFFIX}": key.sign(contents[name]) for name in detached if key is not None}
    for name, content in contents.items():
        write_bytes(out / name, content)
        is_shared = name.startswith("network-") or name == "softsensor.h"
        manifest.files[name] = FileEntry.from_content(name, content, None if is_shared else serial)
    older = manifest.files.keys() - contents.keys()
    manifest.remove(out, older & {f"{name}{DETACHED_SUFFIX}" for name in contents})
    if refusal is not None:
        listed = manifest.units.get(serial, {})
        # A document states this verdict, whatever it is; what a device could load goes.
        is_stated = (listed.get("revision"), listed.get("verdict")) == (unit.stored.revision, unit.verdict)
        of_unit = [name for name in older & manifest.files.keys() if manifest.files[name].serial == serial]
        documents = [name for name in of_unit if is_stated and name.startswith(DETACHED_PREFIXES)]
        manifest.remove(out, set(of_unit) - set(documents))
    device = device_summary(unit) if refusal is None and any(name in writers for name in DEVICE_FORMATS) else {}
    exported = ExportedUnit(serial, unit.stored.revision, unit.verdict, tuple(contents), refusal, device)
    manifest.units[serial] = {
        "revision": exported.revision,
        "verdict": exported.verdict,
        "lot": unit.lot.id,
        "network": fit.network_id,
        "map": unit.state.map_sha256,
        "recording": fit.recording_sha256,
        "refused": refusal,
        "device": dict(device),
        "provenance": unit.provenance.to_json(),
        # What was refused altogether is complete without a file.
        **({} if contents or documents else {"withdrawn": True}),
    }
    return exported
