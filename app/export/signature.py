"""Ed25519 signatures of manifest and certificates: signed by one key, checked against several."""

import hashlib
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path

from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    PublicFormat,
    load_pem_private_key,
    load_pem_public_key,
)

from softcal.app.files.toml_file import read_toml
from softcal.core.errors import InputError

PASSPHRASE_VARIABLE = "SOFTCAL_SIGNING_PASSPHRASE"
MAKE_ONE = "make one: openssl genpkey -algorithm ed25519"
SigningKey = Ed25519PrivateKey
"""A private key that has been opened, so that signing cannot fail once files are written."""

RING_KEYS = {"name", "file", "valid_from", "valid_until"}


@dataclass(frozen=True)
class TrustedKey:
    """A trusted public key with its validity (`valid_from`; `valid_until` is the first day after it)."""

    key: Ed25519PublicKey
    name: str
    valid_from: date | None = None
    valid_until: date | None = None

    @property
    def label(self) -> str:
        return f"{self.name} ({fingerprint(self.key)})"

    def signs_on(self, day: date) -> bool:
        is_early = self.valid_from is not None and day < self.valid_from
        return not is_early and (self.valid_until is None or day < self.valid_until)


def open_signing_key(
    key_file: Path, passphrase_file: Path | None = None, ask: Callable[[str], str] | None = None
) -> SigningKey:
    """Open a private key (PEM).

    Args:
        key_file: the key, encrypted or not.
        passphrase_file: its first line opens the key, else SOFTCAL_SIGNING_PASSPHRASE.
        ask: asks a person for the passphrase if neither source has it; None: no person to ask.

    Raises:
        InputError: no key, another kind of key, or a passphrase that is missing or wrong.
    """
    try:
        content = key_file.read_bytes()
        passphrase = None
        if b"ENCRYPTED" in content and passphrase_file is not None:
            passphrase = next(iter(passphrase_file.read_bytes().splitlines()), None)
        elif b"ENCRYPTED" in content:
            phrase = os.environ.get(PASSPHRASE_VARIABLE) or (ask(f"passphrase of {key_file}: ") if ask else "")
            passphrase = phrase.encode() or None
        key = load_pem_private_key(content, passphrase)
    except TypeError as error:
        raise InputError(
            f"{key_file}: is encrypted; put its passphrase into {PASSPHRASE_VARIABLE} or give --passphrase-file; "
            "nothing was written"
        ) from error
    except (OSError, ValueError, UnsupportedAlgorithm) as error:
        raise InputError(
            f"{key_file}: cannot be opened as a private key in PEM ({error}); nothing was written"
        ) from error
    if not isinstance(key, Ed25519PrivateKey):
        raise InputError(f"{key_file}: an Ed25519 key was expected; {MAKE_ONE}; nothing was written")
    return key


def read_trusted_keys(files: Sequence[Path]) -> list[TrustedKey]:
    """Read public keys (PEM), and key rings (TOML) that name several with the time each is valid.

    `InputError`: a file that is neither, or another kind of key.
    """
    keys = []
    for file in files:
        if file.suffix != ".toml":
            keys.append(_read_trusted_key(file, file.stem))
            continue
        ring = read_toml(file)
        try:
            for row in ring["key"]:
                if unknown := set(row) - RING_KEYS:
                    raise ValueError(f"{', '.join(sorted(unknown))} unknown")
                days = {name: row.get(name) for name in ("valid_from", "valid_until")}
                if any(day is not None and type(day) is not date for day in days.values()):
                    raise ValueError("valid_from and valid_until are dates such as 2026-01-31")
                keys.append(_read_trusted_key(file.parent / row["file"], str(row["name"]), **days))
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(
                f"{file}: no key ring ({error}); [[key]] with name, file, valid_from and valid_until was expected; "
                "nothing was checked"
            ) from error
    return keys


def _read_trusted_key(
    file: Path, name: str, valid_from: date | None = None, valid_until: date | None = None
) -> TrustedKey:
    try:
        key = load_pem_public_key(file.read_bytes())
    except (OSError, ValueError, UnsupportedAlgorithm) as error:
        raise InputError(f"{file}: no public key in PEM ({error}); nothing was checked") from error
    if not isinstance(key, Ed25519PublicKey):
        raise InputError(f"{file}: an Ed25519 public key was expected; nothing was checked")
    return TrustedKey(key, name, valid_from, valid_until)


def check_signature(content: bytes, signature: bytes, trusted: Sequence[TrustedKey], signed_on: date | None) -> str:
    """Return name and fingerprint of the signing key.

    Args:
        signed_on: date in the signed content, or None.

    Raises:
        InputError: it is of none of the keys, or its key was not valid on that day.
    """
    for one in trusted:
        try:
            one.key.verify(signature, content)
        except InvalidSignature:
            continue
        if signed_on is None and (one.valid_from is not None or one.valid_until is not None):
            raise InputError(f"is by {one.label}, but does not say when; its key is not valid at all times")
        if signed_on is not None and not one.signs_on(signed_on):
            period = f"{one.valid_from or 'ever'} until {one.valid_until or 'ever'}"
            raise InputError(
                f"is by {one.label} of {signed_on}, whose key is valid from {period}; do not use the folder"
            )
        return one.label
    names = ", ".join(one.label for one in trusted)
    raise InputError(f"is not that of {names} under this content; do not use the folder")


def fingerprint(key: Ed25519PublicKey) -> str:
    """Return the first 16 hex digits of the SHA-256 of the raw public key."""
    return hashlib.sha256(key.public_bytes(Encoding.Raw, PublicFormat.Raw)).hexdigest()[:16]
