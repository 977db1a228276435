"""The facts of a lot's statement, gathered from the registry."""

from datetime import UTC, datetime
from importlib.metadata import version

import numpy as np

from softcal.app.batch.audit import lot_audit
from softcal.app.export.certificates.lot_statement import LotStatementFacts, StatementRow
from softcal.core.quality.lot_release import LotRelease, any_form
from softcal.db.registry import Registry


def lot_statement_facts(registry: Registry, lot_id: str, decided: LotRelease) -> LotStatementFacts:
    """Gather what the page on a lot says.

    Args:
        decided: on the units of the lot that nobody measured.
    """
    lot, now, found = registry.lot(lot_id), datetime.now(UTC), decided.found
    record = registry.calibration(_calibrated(registry, lot_id)).record
    has_factor = found is not None and bool(np.isfinite(found.factor))
    return LotStatementFacts(
        lot=lot_id,
        sensor_model=lot.sensor_model,
        source=lot.source,
        quantity=lot.reference_quantity,
        reference_unit=lot.reference_unit,
        limit_rmse=decided.limit.maximum_rmse,
        limit_origin=decided.limit.origin,
        network_id=record.network_id,
        method_id=record.method_id,
        made_on=now.date(),
        software=f"softcal {version('softcal')}",
        statement=decided.statement,
        risk=decided.promise.risk,
        confidence=decided.promise.confidence,
        factor=found.factor if found is not None and has_factor else None,
        any_form=any_form(found) if found is not None and decided.released else None,
        audits=_rows(decided, lot_id),
        drawn=_drawn(registry, lot_id),
        released=decided.released,
        counts=registry.verdict_counts(lot_id),
        identifier=f"{lot_id} {now:%Y-%m-%d %H:%M} UTC",
        is_simulated=record.reference is not None and record.reference.is_simulated,
    )


def _calibrated(registry: Registry, lot_id: str) -> str:
    return next(unit.serial for unit in registry.units(lot_id) if unit.role == "target" and unit.revision is not None)


def _rows(decided: LotRelease, lot_id: str) -> tuple[StatementRow, ...]:
    audits = sorted(decided.audits, key=lambda audit: -audit.ratio)
    return tuple(
        StatementRow(
            a.serial,
            a.lot_id or lot_id,
            a.forecast_rmse,
            a.measured_rmse,
            a.measured_rmse <= decided.limit.maximum_rmse,
        )
        for a in audits
    )


def _drawn(registry: Registry, lot_id: str) -> tuple[int, int] | None:
    plan = lot_audit(registry, lot_id)
    return None if plan is None else (len(plan.plan.random), plan.plan.population)
