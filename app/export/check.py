"""Read an export folder back: hashes, CRCs, self-tests and twins must agree before anything is shipped."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from softcal.app.export.manifest import FileEntry, Manifest, check_signature, read_manifest
from softcal.core.errors import InputError
from softcal.core.export.blob import NetworkFile, UnitFile, serial_field
from softcal.core.export.blob_reader import read_network, read_unit
from softcal.core.export.json_text import network_from_values, unit_from_values
from softcal.core.export.loader import join


@dataclass(frozen=True)
class FolderCheck:
    """What was read back.

    Args:
        files: files whose hash was checked.
        opened: units whose device files were opened with all self-tests.
        problems: one line each; empty for a folder that may be shipped.
    """

    files: int
    opened: int
    problems: tuple[str, ...]


def check_folder(folder: Path, public_key: Path | None = None) -> FolderCheck:
    """Check every file of a folder against its manifest, and every device file by opening it.

    Raises:
        InputError: there is no manifest, or its signature does not verify.
    """
    manifest = read_manifest(folder)
    if not manifest.files:
        raise InputError(f"{folder}: no manifest.json; export into it first")
    if public_key is not None:
        check_signature(folder, public_key)
    problems = [text for entry in manifest.files.values() for text in _file_problems(folder, entry)]
    opened = 0
    if not problems:
        found, opened = _device_problems(folder, manifest)
        problems += found
    return FolderCheck(len(manifest.files), opened, (*problems, *_duplicates(manifest)))


def _file_problems(folder: Path, entry: FileEntry) -> Iterator[str]:
    try:
        content = (folder / entry.name).read_bytes()
    except OSError as error:
        yield f"{entry.name}: {error.strerror}; export it again"
        return
    if FileEntry.of(entry.name, content, entry.serial) != entry:
        yield f"{entry.name}: is not what was exported (SHA-256 differs); export it again"


def _device_problems(folder: Path, manifest: Manifest) -> tuple[list[str], int]:
    networks: dict[bytes, NetworkFile] = {}
    units: list[UnitFile] = []
    problems: list[str] = []
    for name in sorted(manifest.files):
        try:
            file = _device_file(folder / name)
        except InputError as error:
            problems.append(f"{name}: {error}")
            continue
        if isinstance(file, NetworkFile):
            networks[file.id] = file
        elif file is not None:
            units.append(file)
    for unit in units:
        network = networks.get(unit.network_id)
        if network is None:
            problems.append(f"unit {unit.serial}: its network file {unit.network_id.hex()} is not in the folder")
            continue
        try:
            join(network, unit)
        except InputError as error:
            problems.append(str(error))
    return problems, len({unit.serial for unit in units})


def _device_file(path: Path) -> NetworkFile | UnitFile | None:
    """Return what a .ssc file or its JSON twin holds; None for other formats."""
    is_network = path.name.startswith("network-")
    if path.suffix == ".ssc":
        return read_network(path.read_bytes()) if is_network else read_unit(path.read_bytes())
    if path.suffix == ".json":
        values = json.loads(path.read_text(encoding="utf-8"))
        if is_network:
            return network_from_values(values)
        return unit_from_values(values["device"]) if values.get("device") else None
    return None


def _duplicates(manifest: Manifest) -> Iterator[str]:
    seen: dict[bytes, str] = {}
    for serial in manifest.units:
        other = seen.setdefault(serial_field(serial), serial)
        if other != serial:
            yield f"units {other} and {serial} look the same to a device; export them into separate folders"
