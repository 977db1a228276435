"""The manifest of an export folder: every file with its hash, every unit with what it is; signed with a key."""

import hashlib
import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from softcal.app.files.atomic import write_bytes
from softcal.core.errors import InputError
from softcal.core.export.json_text import json_text

SCHEMA = "softcal.export/1"
NAME, SIGNATURE = "manifest.json", "manifest.sig"


@dataclass(frozen=True)
class FileEntry:
    """One file of the folder; `serial` is None for files that units share."""

    name: str
    sha256: str
    size: int
    serial: str | None

    @classmethod
    def of(cls, name: str, content: bytes, serial: str | None) -> "FileEntry":
        """Describe a file by its content."""
        return cls(name, hashlib.sha256(content).hexdigest(), len(content), serial)


@dataclass(frozen=True)
class Manifest:
    """What an export folder holds."""

    files: Mapping[str, FileEntry]
    units: Mapping[str, Mapping[str, object]]

    def with_file(self, entry: FileEntry) -> "Manifest":
        """Return the manifest with one more file, or a newer one of that name."""
        return replace(self, files={**self.files, entry.name: entry})

    def without_files(self, names: Collection[str]) -> "Manifest":
        """Return the manifest without these files."""
        return replace(self, files={name: entry for name, entry in self.files.items() if name not in names})

    def with_unit(self, serial: str, facts: Mapping[str, object]) -> "Manifest":
        """Return the manifest with one more unit, or newer facts of it."""
        return replace(self, units={**self.units, serial: facts})

    def text(self) -> str:
        """Return the manifest's JSON, files and units by name: the same folder always gives the same text."""
        return json_text(
            {
                "schema": SCHEMA,
                "softcal": version("softcal"),
                "units": {serial: self.units[serial] for serial in sorted(self.units)},
                "files": [vars(self.files[name]) for name in sorted(self.files)],
            }
        )


def read_manifest(folder: Path) -> Manifest:
    """Read a folder's manifest; an empty one where there is none yet.

    Raises:
        InputError: what stands there is no manifest of softcal.
    """
    path = folder / NAME
    if not path.exists():
        return Manifest({}, {})
    try:
        values: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if values["schema"] != SCHEMA:
            raise InputError(f"{path}: schema {values['schema']!r}, {SCHEMA!r} was expected; export to another folder")
        return Manifest({row["name"]: FileEntry(**row) for row in values["files"]}, values["units"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: no manifest of softcal ({error}); export to another folder") from error


def write_manifest(folder: Path, manifest: Manifest, signing_key: Path | None) -> None:
    """Write the manifest, and its Ed25519 signature where a key is given; an old signature never stays beside it."""
    content = manifest.text().encode()
    signature = _sign(content, signing_key) if signing_key else None
    (folder / SIGNATURE).unlink(missing_ok=True)
    write_bytes(folder / NAME, content)
    if signature is not None:
        write_bytes(folder / SIGNATURE, signature)


def _sign(content: bytes, key_file: Path) -> bytes:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    try:
        key = load_pem_private_key(key_file.read_bytes(), password=None)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"{key_file}: no unencrypted private key in PEM ({error}); nothing was signed") from error
    if not isinstance(key, Ed25519PrivateKey):
        raise InputError(f"{key_file}: an Ed25519 key was expected; make one: openssl genpkey -algorithm ed25519")
    return key.sign(content)


def check_signature(folder: Path, public_key: Path) -> None:
    """Verify the manifest's signature with an Ed25519 public key (PEM).

    Raises:
        InputError: no signature, no key, or a signature that does not belong to this manifest.
    """
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
    from cryptography.hazmat.primitives.serialization import load_pem_public_key

    try:
        key = load_pem_public_key(public_key.read_bytes())
        content, signature = (folder / NAME).read_bytes(), (folder / SIGNATURE).read_bytes()
    except (OSError, ValueError) as error:
        raise InputError(f"the signature of {folder} cannot be checked: {error}") from error
    if not isinstance(key, Ed25519PublicKey):
        raise InputError(f"{public_key}: an Ed25519 public key was expected")
    try:
        key.verify(signature, content)
    except InvalidSignature as error:
        raise InputError(f"{folder / SIGNATURE}: does not belong to this manifest and key; do not use it") from error
