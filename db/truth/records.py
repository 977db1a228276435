"""Calibrations as columns of a table and back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from sqlalchemy import RowMapping

from softcal.core.words.reason import Reason

if TYPE_CHECKING:
    from softcal.core.identity import Settings
    from softcal.core.unit.calibration import CalibrationRecord

PLAIN_FIELDS = (
    "serial",
    "network_id",
    "family",
    "map_sha256",
    "predicted_rmse",
    "before_rmse",
    "after_rmse",
    "own_rmse",
    "fit_s",
    "verdict",
    "input_sha256",
    "recording_sha256",
)
"""Fields of `CalibrationRecord` that are columns as they are."""


def record_of(row: RowMapping, arrays: Mapping[str, Any], settings: Settings) -> CalibrationRecord:
    """Return the calibration of a row, with the arrays and settings that belong to it."""
    # Whoever lists units needs none.
    from softcal.core.unit.calibration import CalibrationRecord

    return CalibrationRecord(
        **{field: row[field] for field in PLAIN_FIELDS},
        arrays=arrays,
        settings=settings,
        reasons=tuple(map(Reason.of, row["reasons"])),
        evidence=row["evidence"],
    )
