"""The results of a lot as a Parquet table, a row a unit; docs/connect.md describes every column."""

import io
from importlib.metadata import version
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from softcal.app.registry.lot_recordings import target_serials
from softcal.db.entries import UnitResult
from softcal.db.registry import Registry

SCHEMA_NAME = "softcal.results/1"
RESULTS = pa.schema(
    [
        pa.field("lot", pa.string(), nullable=False),
        pa.field("serial", pa.string(), nullable=False),
        pa.field("verdict", pa.string()),
        pa.field("reasons", pa.list_(pa.string()), nullable=False),
        pa.field("reason_codes", pa.list_(pa.string()), nullable=False),
        pa.field("released", pa.bool_(), nullable=False),
        pa.field("audited", pa.bool_(), nullable=False),
        pa.field("knowledge", pa.string()),
        pa.field("revision", pa.int32()),
        pa.field("map_family", pa.string()),
        pa.field("map_sha256", pa.string()),
        pa.field("method_id", pa.string()),
        pa.field("predicted_rmse", pa.float64()),
        pa.field("before_rmse", pa.float64()),
        pa.field("after_rmse", pa.float64()),
        pa.field("own_rmse", pa.float64()),
        pa.field("fit_s", pa.float64()),
        pa.field("made_at", pa.timestamp("us", tz="UTC")),
    ]
)
"""Columns in their order. A unit without a result has null where a result would stand."""


def lot_results(registry: Registry, lot_id: str) -> pa.Table:
    """Return the results of a lot's target units by serial.

    Raises:
        InputError: the lot is not in the registry.
    """
    lot = registry.lots.get(lot_id)
    serials = sorted(target_serials(registry, lot_id))
    results = registry.pages.unit_statuses(lot_id, serials)
    rows: list[dict[str, Any]] = []
    for serial in serials:
        unit = results.get(serial, UnitResult(serial))
        stored, state = unit.calibration, unit.state
        rows.append(
            {
                **unit.to_json(),
                "lot": lot_id,
                "verdict": unit.verdict or None,
                "map_family": state and state.fit.family,
                "made_at": unit.made_at,
                "revision": stored and stored.revision,
                "map_sha256": stored and stored.map_sha256,
                "method_id": state and state.fit.method.id,
            }
        )
    metadata = {
        "schema": SCHEMA_NAME,
        "lot": lot_id,
        "source": lot.source,
        "reference_unit": lot.reference_unit,
        "limit_rmse": "" if lot.limit_rmse is None else repr(lot.limit_rmse),
        "softcal": version("softcal"),
    }
    return pa.Table.from_pylist(rows, schema=RESULTS.with_metadata(metadata))


def parquet_bytes(table: pa.Table) -> bytes:
    """Return a table as a Parquet file."""
    content = io.BytesIO()
    pq.write_table(table, content, compression="zstd")
    return content.getvalue()
