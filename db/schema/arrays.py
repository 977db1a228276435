"""Named arrays: safetensors bytes addressed by their SHA-256, checked on every read.

A large array is a blob of its own, named by its hash in the blob of the small ones: what all units
of a lot have in common (the source's support model, equal time stamps) is kept once.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import TYPE_CHECKING

from sqlalchemy import bindparam, insert, select

from softcal.core.errors import RegistryDamaged, RegistryError
from softcal.db.schema.column_types import canonical_json
from softcal.db.schema.database import Database
from softcal.db.schema.tables import blobs

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Arrays = Mapping[str, NDArray[np.generic]]

SELECT_BLOB_SIZE = select(blobs.c.size).where(blobs.c.sha256 == bindparam("sha"))
READ_BLOB = select(blobs.c.data).where(blobs.c.sha256 == bindparam("sha"))
INSERT = insert(blobs)
LARGEST_BYTES = 512 * 1024 * 1024
"""Far above any recording or map of a line, below what both databases take as one value."""

SEPARATE_BLOB_BYTES = 4096
"""From this size on an array is a blob of its own; below, a row costs as much as it saves."""

ARRAYS, ARRAY = "arrays", "array"
"""Kinds of blobs: several arrays by name, and one large array that they refer to."""


def put_arrays(database: Database, arrays: Arrays) -> str:
    """Store named arrays once and return the SHA-256 (hex) of the bytes that name and hold them."""
    # Imported here and below: whoever lists units reads no array.
    import numpy as np
    from safetensors.numpy import save

    # safetensors takes the buffer as it lies; a view with strides would be stored wrongly.
    contiguous = {name: np.asarray(array, order="C") for name, array in arrays.items()}
    large = {name: array for name, array in contiguous.items() if array.nbytes >= SEPARATE_BLOB_BYTES}
    parts = {name: put_bytes(database, ARRAY, save({ARRAY: array})) for name, array in large.items()}
    small = {name: array for name, array in contiguous.items() if name not in parts}
    # One entry only: safetensors writes several in no fixed order.
    return put_bytes(database, ARRAYS, save(small, {"parts": canonical_json(parts)} if parts else None))


def get_arrays(database: Database, sha256: str) -> dict[str, NDArray[np.generic]]:
    """Return the named arrays stored under a hash; raise `RegistryError` if they are missing or damaged."""
    from safetensors import SafetensorError
    from safetensors.numpy import load

    content = get_bytes(database, sha256)
    try:
        arrays = dict(load(content))
        for name, part in parts_of(content).items():
            arrays[name] = load(get_bytes(database, part))[ARRAY]
    except SafetensorError as error:
        raise RegistryDamaged(f"blob {sha256[:12]} holds no arrays: {error}") from error
    return arrays


def parts_of(content: bytes) -> dict[str, str]:
    """Return the SHA-256 of every large array, by name, that a blob of named arrays refers to.

    The header of safetensors is eight bytes of length, little-endian, and as many bytes of JSON.
    """
    try:
        header = json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])
        return dict(json.loads(header.get("__metadata__", {}).get("parts", "{}")))
    except (ValueError, AttributeError) as error:
        raise RegistryError(f"a blob of arrays cannot be read: {error}") from error


def put_bytes(database: Database, kind: str, content: bytes) -> str:
    """Store bytes once and return their SHA-256 (hex)."""
    if len(content) > LARGEST_BYTES:
        raise RegistryError(f"{len(content)} bytes are too many for one value; at most {LARGEST_BYTES} are kept")
    sha256 = hashlib.sha256(content).hexdigest()
    stored = database.cache.blobs
    if sha256 not in stored and not has_blob(database, sha256):
        row = {"sha256": sha256, "kind": kind, "size": len(content), "data": content}
        database.change(INSERT, row)
    stored.add(sha256)
    return sha256


def has_blob(database: Database, sha256: str) -> bool:
    """Whether bytes of this hash are stored, without reading them."""
    return database.row(SELECT_BLOB_SIZE, {"sha": sha256}) is not None


def copy_blob(source: Database, target: Database, sha256: str) -> None:
    """Copy a blob, after the blobs that it refers to, into a registry that lacks it."""
    if has_blob(target, sha256):
        return
    content = get_bytes(source, sha256)
    kind = source.value(select(blobs.c.kind).where(blobs.c.sha256 == sha256))
    if kind == ARRAYS:
        for part in parts_of(content).values():
            copy_blob(source, target, part)
    put_bytes(target, kind, content)


def get_bytes(database: Database, sha256: str) -> bytes:
    """Return the bytes stored under a hash, after checking them (`RegistryError`: gone, or damaged)."""
    content = database.value(READ_BLOB, {"sha": sha256})
    if content is None:
        raise RegistryDamaged(f"blob {sha256[:12]} is missing from the registry; restore a backup")
    content = bytes(content)
    if hashlib.sha256(content).hexdigest() != sha256:
        raise RegistryDamaged(f"blob {sha256[:12]} was damaged: its bytes have another SHA-256; restore a backup")
    return content
