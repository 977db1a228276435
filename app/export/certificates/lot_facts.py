"""The facts of a lot's statement, gathered from the registry."""

from datetime import UTC, datetime
from importlib.metadata import version

from softcal.app.batch.audit import lot_audit
from softcal.app.export.certificates.lot_statement import LotStatementFacts
from softcal.core.quality.lot_release import LotRelease
from softcal.core.quality.lot_standing import LotStanding
from softcal.db.registry import Registry


def lot_statement_facts(registry: Registry, standing: LotStanding, decided: LotRelease) -> LotStatementFacts:
    """Gather what the page on a lot says.

    Args:
        decided: on its units that nobody measured.
    """
    lot_id, now, plan = standing.lot_id, datetime.now(UTC), lot_audit(registry, standing.lot_id)
    calibrated = next(u.serial for u in registry.lots.units(lot_id) if u.role == "target" and u.revision is not None)
    record = registry.calibrations.get(calibrated, lot_id=lot_id).record
    return LotStatementFacts(
        lot=registry.lots.get(lot_id),
        standing=standing,
        decided=decided,
        network_id=record.network_id,
        method_id=record.method_id,
        made_on=now.date(),
        software=f"softcal {version('softcal')}",
        drawn=None if plan is None else (len(plan.plan.random), plan.plan.population),
        identifier=f"{lot_id} {now:%Y-%m-%d %H:%M} UTC",
        is_simulated=record.reference is not None and record.reference.is_simulated,
    )
