"""Content hashes: what has the same arrays and settings has the same id, on every machine."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Settings = Mapping[str, object]


def content_sha256(arrays: Mapping[str, NDArray[np.generic]], settings: Settings) -> str:
    """Return the SHA-256 (hex) of named arrays and JSON settings.

    Names are sorted, arrays are taken little-endian in C order with their dtype and shape, settings
    as canonical JSON. So the id depends on the content alone.
    """
    # Settings alone have an id without numpy: whoever lists units does not wait for it.
    digest = hashlib.sha256(json.dumps(settings, sort_keys=True, separators=(",", ":"), allow_nan=False).encode())
    for name in sorted(arrays):
        import numpy as np

        array = np.ascontiguousarray(arrays[name])
        array = array.astype(array.dtype.newbyteorder("<"), copy=False)
        digest.update(f"\n{name}|{array.dtype.str}|{array.shape}|".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
