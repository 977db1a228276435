"""The manifest of an export folder: every file with its hash, every unit; signed.

Files of units that are no longer released are taken back here: a later verdict that is worse wins.
"""

import hashlib
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from datetime import UTC, date, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from softcal.app.export.signature import SigningKey
from softcal.app.files.atomic import write_bytes
from softcal.core.errors import InputError
from softcal.core.export.json_text import json_text
from softcal.core.json_input import parse_json
from softcal.core.lot import UnitKey

SCHEMA = "softcal.export/1"
NAME, SIGNATURE = "manifest.json", "manifest.sig"
PLAIN_NAME = re.compile(r"[^/\\:\x00-\x1f]*[^/\\:\x00-\x1f.][^/\\:\x00-\x1f]*")
"""A name without a folder or drive in it, and not made of dots alone."""


@dataclass(frozen=True)
class FileEntry:
    """One file of the folder; `serial` is None for files that units share."""

    name: str
    sha256: str
    size: int
    serial: str | None

    @classmethod
    def from_content(cls, name: str, content: bytes, serial: str | None) -> "FileEntry":
        return cls(name, hashlib.sha256(content).hexdigest(), len(content), serial)

    @classmethod
    def read(cls, row: Mapping[str, Any]) -> "FileEntry":
        """Return one row; a name must stay in the folder, as a manifest may be foreign."""
        entry = cls(**row)
        if not isinstance(entry.name, str) or not PLAIN_NAME.fullmatch(entry.name) or entry.name in (NAME, SIGNATURE):
            raise ValueError(f"{entry.name!r} is no name of a file in this folder")
        return entry


@dataclass
class Manifest:
    """Files by name and units by serial; `signed_on`, which the signature covers, is None without a signature."""

    files: dict[str, FileEntry]
    units: dict[str, Mapping[str, object]]
    signed_on: date | None = None

    def check_lot(self, unit: UnitKey) -> None:
        """Raise `InputError` if the folder has files of this serial of another lot, as no device distinguishes them."""
        lot_id = self.units.get(unit.serial, {}).get("lot", unit.lot_id)
        if lot_id != unit.lot_id:
            raise InputError(
                f"this folder has files of {lot_id}/{unit.serial}, which look like those of {unit}; nothing was "
                "written; export each lot to a folder of its own"
            )

    def remove(self, folder: Path, names: Collection[str]) -> None:
        """Remove files from the folder and its manifest."""
        for name in names:
            (folder / name).unlink(missing_ok=True)
            del self.files[name]

    def text(self) -> str:
        """Return the manifest's JSON, files and units by name: the same folder, the same text."""
        signed = {} if self.signed_on is None else {"signed_on": self.signed_on.isoformat()}
        return json_text(
            {
                "schema": SCHEMA,
                **signed,
                "softcal": version("softcal"),
                "units": {serial: self.units[serial] for serial in sorted(self.units)},
                "files": [vars(self.files[name]) for name in sorted(self.files)],
            }
        )


def read_manifest(folder: Path) -> Manifest:
    """Return a folder's manifest; an empty one for a new folder.

    `InputError`: no manifest of softcal; it lists a file twice, or one elsewhere.
    """
    path = folder / NAME
    if not path.exists():
        return Manifest({}, {})
    try:
        values: dict[str, Any] = parse_json(path.read_text(encoding="utf-8"))
        if values["schema"] != SCHEMA:
            raise InputError(f"{path}: schema {values['schema']!r}, {SCHEMA!r} was expected; export to another folder")
        entries = [FileEntry.read(row) for row in values["files"]]
        units = dict(values["units"])
        signed_on = date.fromisoformat(values["signed_on"]) if "signed_on" in values else None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: no manifest of softcal ({error}); export to another folder") from error
    names = [entry.name for entry in entries]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"{path}: lists {', '.join(twice[:5])} twice; nothing was read or written; export it again")
    return Manifest({entry.name: entry for entry in entries}, units, signed_on)


def write_manifest(folder: Path, manifest: Manifest, key: SigningKey | None) -> None:
    """Write the manifest and, with a key, its signature; an old one never stays."""
    manifest.signed_on = datetime.now(UTC).date() if key else None
    content = manifest.text().encode()
    signature = key.sign(content) if key else None
    (folder / SIGNATURE).unlink(missing_ok=True)
    write_bytes(folder / NAME, content)
    if signature is not None:
        write_bytes(folder / SIGNATURE, signature)


def withdraw_units(folder: Path, lot_id: str, released: Collection[str], verdicts: Mapping[str, str]) -> list[str]:
    """Remove the files of units of a lot that are not released; return the serials of those that had some.

    Args:
        folder: an export folder; nothing happens without one.
        released: serials whose files stay.
        verdicts: today's word of every unit that may have files here.
    """
    manifest = read_manifest(folder)
    lot_serials = {serial for serial, values in manifest.units.items() if values["lot"] == lot_id}
    withdrawn, previous_units = [], dict(manifest.units)
    for serial in sorted(lot_serials & verdicts.keys() - set(released)):
        names = [name for name, entry in manifest.files.items() if entry.serial == serial]
        manifest.remove(folder, names)
        withdrawn += [serial] if names else []
        is_withdrawn = bool(names) or previous_units[serial].get("withdrawn", False)
        manifest.units[serial] = {**previous_units[serial], "verdict": verdicts[serial], "withdrawn": is_withdrawn}
    if manifest.units != previous_units:
        # A signature of the folder as it was would vouch for files that are gone.
        write_manifest(folder, manifest, None)
    return withdrawn
