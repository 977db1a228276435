"""States of units read back from their rows: each fit and each method once."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import sqlalchemy as sa
from sqlalchemy import select

from softcal.core.identity import content_sha256
from softcal.db.repositories.registry_base import damage_error
from softcal.db.schema.arrays import get_arrays
from softcal.db.schema.column_types import canonical_json
from softcal.db.schema.database import Database, parts
from softcal.db.schema.tables import STATE_PARTS, fits, methods

if TYPE_CHECKING:
    from softcal.core.unit.fit import Fit
    from softcal.core.unit.method import Method
    from softcal.core.unit.state import UnitState

FIT_SHA256: WeakKeyDictionary[Fit, str] = WeakKeyDictionary()
"""Hashes of fits that were stored or read: a fit is hashed once, and one without its arrays is never stored again."""


@dataclass(frozen=True)
class StoredParts:
    """What rows of `calibrations` rest on.

    Args:
        fits: row of a fit, with its method, by lot and hash.
        parts: a part of states as JSON values, by its field, lot and hash.
    """

    fits: Mapping[tuple[str, str], tuple[sa.RowMapping, Method]]
    parts: Mapping[tuple[str, str, str], Mapping[str, Any]]


def read_parts(database: Database, rows: Sequence[sa.RowMapping]) -> StoredParts:
    """Return what rows of `calibrations` rest on.

    Raises:
        RegistryError: a fit, its method or another part differs from its hash.
    """
    from softcal.core.unit.state_json import part_from_columns

    read = dict[tuple[str, str, str], Mapping[str, Any]]()
    for field, table in STATE_PARTS.items():
        keys = {(row["lot_id"], row[f"{field}_sha256"]) for row in rows if row[f"{field}_sha256"] is not None}
        for some in parts(sorted(keys)):
            query = select(table).where(sa.tuple_(table.c.lot_id, table.c.sha256).in_(some))
            for row in database.rows(query):
                part = part_from_columns(field, dict(row))
                if content_sha256({}, part) != row["sha256"]:
                    raise damage_error(
                        f"{table.name} {row['sha256'][:12]} of lot {row['lot_id']} is not what was stored"
                    )
                read[(field, row["lot_id"], row["sha256"])] = part
    return StoredParts(_fits_of(database, rows), read)


def _fits_of(
    database: Database, rows: Sequence[sa.RowMapping]
) -> Mapping[tuple[str, str], tuple[sa.RowMapping, Method]]:
    keys = sorted({(row["lot_id"], row["fit_sha256"]) for row in rows})
    fit_rows: list[sa.RowMapping] = []
    for part in parts(keys):
        fit_rows += database.rows(select(fits).where(sa.tuple_(fits.c.lot_id, fits.c.sha256).in_(part)))
    of_method = {
        id_: canonical_json(numbers) for id_, numbers in database.tuples(select(methods.c.id, methods.c.numbers))
    }
    read = {}
    for row in fit_rows:
        if content_sha256({}, {"content": row["content"], "blob": row["blob_sha256"]}) != row["sha256"]:
            raise damage_error(f"unit {row['serial']} of lot {row['lot_id']}: its fit is not what was stored")
        method = _method(row["method_id"], of_method.get(row["method_id"], "null"))
        read[(row["lot_id"], row["sha256"])] = (row, method)
    return read


def state_of(database: Database, row: sa.RowMapping, from_json: StoredParts, *, has_arrays: bool = True) -> UnitState:
    """Return the state of a row of `calibrations`; without arrays it can be listed and decided on.

    Raises:
        RegistryError: its fit is missing, or cannot be read.
    """
    import msgspec

    from softcal.core.unit.state_json import fit_from_json, state_from_json

    entry = from_json.fits.get((row["lot_id"], row["fit_sha256"]))
    if entry is None:
        raise damage_error(
            f"unit {row['serial']} of lot {row['lot_id']}: the fit of revision {row['revision']} is missing"
        )
    fit, method = entry
    arrays: Any = get_arrays(database, fit["blob_sha256"]) if has_arrays else None
    try:
        read = replace(fit_from_json(fit["content"], method, arrays), fit_s=row["fit_s"])
        FIT_SHA256[read] = row["fit_sha256"]
        return state_from_json(read, _adjustments_of(row, from_json))
    except (msgspec.ValidationError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise damage_error(f"unit {row['serial']}: revision {row['revision']} cannot be read ({error})") from error


def _adjustments_of(row: sa.RowMapping, from_json: StoredParts) -> dict[str, Any]:
    limit = {name: row[f"limit_{name}"] for name in ("unit", "origin", "reference_expanded", "full_range")}
    values = {name: row[name] for name in ("unreadable_audit", "suspect_audit")}
    for field in STATE_PARTS:
        sha256 = row[f"{field}_sha256"]
        values[field] = None if sha256 is None else from_json.parts[(field, row["lot_id"], sha256)]
    return {"limit": limit | {"maximum_rmse": row["limit_rmse"]}, **values}


@lru_cache(maxsize=32)
def _method(method_id: str, numbers: str) -> Method:
    from softcal.core.unit.method import Method

    content = json.loads(numbers)
    if content_sha256({}, content) != method_id:
        raise damage_error(f"method {method_id} is not what was stored")
    return Method.from_json(content)
