"""States of units read back from their rows: each fit and each method once."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import sqlalchemy as sa
from sqlalchemy import select

from softcal.core.identity import content_sha256
from softcal.db.repositories.registry_base import damaged
from softcal.db.schema.arrays import get_arrays
from softcal.db.schema.column_types import canonical_json
from softcal.db.schema.database import Database, parts
from softcal.db.schema.tables import fits, methods

if TYPE_CHECKING:
    from softcal.core.unit.fit import Fit
    from softcal.core.unit.method import Method
    from softcal.core.unit.state import UnitState

FIT_SHA256: WeakKeyDictionary[Fit, str] = WeakKeyDictionary()
"""Hashes of fits that were stored or read: a fit is hashed once, and one without its arrays is never stored again."""

FitRows = Mapping[tuple[str, str], tuple[sa.RowMapping, "Method"]]
"""Lot and hash of a fit → its row and its method."""


def fits_of(database: Database, rows: Sequence[sa.RowMapping]) -> FitRows:
    """Return the fits that rows of `calibrations` rest on.

    Raises:
        RegistryError: a fit or its method differs from its hash.
    """
    wanted = sorted({(row["lot_id"], row["fit_sha256"]) for row in rows})
    found: list[sa.RowMapping] = []
    for part in parts(wanted):
        found += database.rows(select(fits).where(sa.tuple_(fits.c.lot_id, fits.c.sha256).in_(part)))
    of_method = {id_: canonical_json(kept) for id_, kept in database.tuples(select(methods.c.id, methods.c.numbers))}
    read = {}
    for row in found:
        if content_sha256({}, {"content": row["content"], "blob": row["blob_sha256"]}) != row["sha256"]:
            raise damaged(f"unit {row['serial']} of lot {row['lot_id']}: its fit is not what was stored")
        method = _method(row["method_id"], of_method.get(row["method_id"], "null"))
        read[(row["lot_id"], row["sha256"])] = (row, method)
    return read


def state_of(database: Database, row: sa.RowMapping, of: FitRows, *, has_arrays: bool = True) -> UnitState:
    """Return the state of a row of `calibrations`; without arrays it can be listed and decided on.

    Raises:
        RegistryError: its fit is missing, or cannot be read.
    """
    import msgspec

    from softcal.core.unit.state_json import fit_from_json, state_from_json

    found = of.get((row["lot_id"], row["fit_sha256"]))
    if found is None:
        raise damaged(f"unit {row['serial']} of lot {row['lot_id']}: the fit of revision {row['revision']} is missing")
    fit, method = found
    arrays: Any = get_arrays(database, fit["blob_sha256"]) if has_arrays else None
    try:
        read = fit_from_json(fit["content"], method, arrays)
        FIT_SHA256[read] = row["fit_sha256"]
        return state_from_json(read, row["state"])
    except (msgspec.ValidationError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise damaged(f"unit {row['serial']}: revision {row['revision']} cannot be read ({error})") from error


@lru_cache(maxsize=32)
def _method(method_id: str, numbers: str) -> Method:
    from softcal.core.unit.method import Method

    kept = json.loads(numbers)
    if content_sha256({}, kept) != method_id:
        raise damaged(f"method {method_id} is not what was stored")
    return Method.of(kept)
