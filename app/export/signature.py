"""The Ed25519 signature beside a manifest: made with a key that may be encrypted, checked with its public half."""

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path

from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    PublicFormat,
    load_pem_private_key,
    load_pem_public_key,
)

from softcal.core.errors import InputError

PASSPHRASE_VARIABLE = "SOFTCAL_SIGNING_PASSPHRASE"
MAKE_ONE = "make one: openssl genpkey -algorithm ed25519"


@dataclass(frozen=True)
class SigningKey:
    """A private key that has been opened, so that signing cannot fail once files are written."""

    key: Ed25519PrivateKey

    def sign(self, content: bytes) -> bytes:
        """Return the 64 bytes of the signature."""
        return self.key.sign(content)


def open_signing_key(key_file: Path) -> SigningKey:
    """Open a private key (PEM); the passphrase of an encrypted one is in SOFTCAL_SIGNING_PASSPHRASE.

    Raises:
        InputError: no key, another kind of key, or a passphrase that is missing or wrong.
    """
    passphrase = os.environ.get(PASSPHRASE_VARIABLE)
    try:
        content = key_file.read_bytes()
        is_encrypted = b"ENCRYPTED" in content
        key = load_pem_private_key(content, passphrase.encode() if passphrase and is_encrypted else None)
    except TypeError as error:
        raise InputError(
            f"{key_file}: is encrypted; put its passphrase into {PASSPHRASE_VARIABLE}; nothing was written"
        ) from error
    except (OSError, ValueError, UnsupportedAlgorithm) as error:
        what = "the passphrase does not open it" if passphrase else "no private key in PEM"
        raise InputError(f"{key_file}: {what} ({error}); nothing was written") from error
    if not isinstance(key, Ed25519PrivateKey):
        raise InputError(f"{key_file}: an Ed25519 key was expected; {MAKE_ONE}; nothing was written")
    return SigningKey(key)


def check_signature(content: bytes, signature: bytes, public_key: Path) -> str:
    """Verify a signature with an Ed25519 public key (PEM) and return the key's fingerprint.

    Raises:
        InputError: no such key, or the signature is not this key's under this content.
    """
    try:
        key = load_pem_public_key(public_key.read_bytes())
    except (OSError, ValueError, UnsupportedAlgorithm) as error:
        raise InputError(f"{public_key}: no public key in PEM ({error}); nothing was checked") from error
    if not isinstance(key, Ed25519PublicKey):
        raise InputError(f"{public_key}: an Ed25519 public key was expected; nothing was checked")
    name = fingerprint(key)
    try:
        key.verify(signature, content)
    except InvalidSignature as error:
        raise InputError(f"is not that of key {name} under this manifest; do not use the folder") from error
    return name


def fingerprint(key: Ed25519PublicKey) -> str:
    """Return the first 16 hex digits of the SHA-256 of the raw public key."""
    return hashlib.sha256(key.public_bytes(Encoding.Raw, PublicFormat.Raw)).hexdigest()[:16]
