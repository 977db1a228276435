"""Named arrays in the registry: safetensors bytes addressed by their SHA-256, checked on every read. No pickle."""

import hashlib
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load, save
from sqlalchemy import Connection, bindparam, insert, select

from softcal.core.errors import RegistryError
from softcal.db.tables import blobs

Arrays = Mapping[str, NDArray[np.generic]]

KNOWN_BLOB = select(blobs.c.size).where(blobs.c.sha256 == bindparam("sha"))
LARGEST_BYTES = 512 * 1024 * 1024
"""Far above any recording or map of a line, below what both databases take as one value."""


def put_arrays(connection: Connection, arrays: Arrays) -> str:
    """Store named arrays once and return the SHA-256 (hex) of their bytes."""
    # safetensors takes the buffer as it lies; a view with strides would be stored wrongly.
    content = save({name: np.asarray(array, order="C") for name, array in arrays.items()})
    return put_bytes(connection, "arrays", content)


def get_arrays(connection: Connection, sha256: str) -> dict[str, NDArray[np.generic]]:
    """Return the named arrays stored under a hash.

    Raises:
        RegistryError: nothing is stored there, or its bytes are not the ones that were stored.
    """
    try:
        return dict(load(get_bytes(connection, sha256)))
    except SafetensorError as error:
        raise RegistryError(f"blob {sha256[:12]} holds no arrays: {error}") from error


def put_bytes(connection: Connection, kind: str, content: bytes) -> str:
    """Store bytes once and return their SHA-256 (hex)."""
    if len(content) > LARGEST_BYTES:
        raise RegistryError(f"{len(content)} bytes are too many for one value; at most {LARGEST_BYTES} are kept")
    sha256 = hashlib.sha256(content).hexdigest()
    if not has_blob(connection, sha256):
        row = {"sha256": sha256, "kind": kind, "size": len(content), "data": content}
        connection.execute(insert(blobs), row)
    return sha256


def has_blob(connection: Connection, sha256: str) -> bool:
    """Whether bytes of this hash are stored, without reading them."""
    return connection.execute(KNOWN_BLOB, {"sha": sha256}).first() is not None


def get_bytes(connection: Connection, sha256: str) -> bytes:
    """Return the bytes stored under a hash, after checking them.

    Raises:
        RegistryError: nothing is stored there, or its bytes are not the ones that were stored.
    """
    content = connection.execute(select(blobs.c.data).where(blobs.c.sha256 == sha256)).scalar_one_or_none()
    if content is None:
        raise RegistryError(f"blob {sha256[:12]} is missing from the registry; restore a backup")
    content = bytes(content)
    if hashlib.sha256(content).hexdigest() != sha256:
        raise RegistryError(f"blob {sha256[:12]} was damaged: its bytes have another SHA-256; restore a backup")
    return content
