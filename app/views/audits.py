"""The audits of a lot: which units were measured, when and with what result, and which are in doubt. No Streamlit."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from softcal.app.registry.audits import newest_audits
from softcal.core.words.reason import DOUBT, Reason
from softcal.db.registry import Registry


@dataclass(frozen=True)
class AuditedRow:
    """One audited unit.

    Args:
        serial: the unit.
        brought_at: when its recording came into the registry, UTC.
        forecast_rmse, measured_rmse: in the reference unit; None where it could not be scored.
        verdict: of the unit as it stands.
        doubt: why it is set aside; None where it counts.
    """

    serial: str
    brought_at: datetime
    forecast_rmse: float | None
    measured_rmse: float | None
    verdict: str
    doubt: Reason | None


def audit_rows_of(registry: Registry, lot_id: str) -> Sequence[AuditedRow]:
    """Return every audited unit of a lot, those in doubt first, then the largest errors."""
    entries = newest_audits(registry, lot_id)
    standings = registry.standings(lot_id, list(entries))
    rows = []
    for serial, entry in entries.items():
        if (standing := standings.get(serial)) is None:
            continue
        made = standing.made
        doubt = next((why for why in standing.reasons if why.code.startswith(DOUBT)), None)
        errors = (None, None) if made is None else (made.forecast_rmse, made.after_rmse)
        rows.append(AuditedRow(serial, entry.added_at, *errors, standing.verdict, doubt))
    return sorted(rows, key=lambda row: (row.doubt is None, -(row.measured_rmse or 0.0), row.serial))
