"""Whether units may be released on their forecasts: enough audits of the product and method, none too old or failed.

No I/O here: the caller reads past audits and golden runs from wherever they are kept.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

from softcal.core.messages.reason import Reason, reason
from softcal.core.quality.acceptance import min_units
from softcal.core.quality.release import AuditedUnit
from softcal.core.unit.method import Method, ReleaseConfig

THIS_LOT, EARLIER_LOTS, NONE = "this lot", "earlier lots", "none"


@dataclass(frozen=True)
class PastAudit:
    """An audit as it was kept, with the method of its forecast.

    It has failed where the unit was accepted on its forecast, and its measured error is beyond the limit.
    """

    unit: AuditedUnit
    sensor_model: str
    method_id: str
    made_at: datetime
    has_failed: bool = False


@dataclass(frozen=True)
class Qualification:
    """On which audits units of a lot may be released, and how many of this lot are wanted still."""

    source: str
    audits: tuple[AuditedUnit, ...]
    required: int
    reason: Reason
    lot_audits: tuple[AuditedUnit, ...] = ()

    @property
    def is_given(self) -> bool:
        """Whether units may be released."""
        return self.source != NONE


def qualify(
    lot_audits: Sequence[AuditedUnit],
    past: Sequence[PastAudit],
    now: datetime,
    sensor_model: str,
    method: Method,
    golden_failed_at: datetime | None = None,
    units: int | None = None,
) -> Qualification:
    """Say whether and on what audits the units of a lot may be released.

    Enough audits of the lot itself outrank all others. Audits of earlier lots count where they are of the same product
    and method, not older than `lasts_days`, of `min_lots` lots at least, and no later audit or golden unit failed: a
    failure withdraws everything before it.

    Args:
        past: audits of other lots, of any product, method and age.
        golden_failed_at: when a golden unit last failed on the line that presses this lot.
        units: of this lot, measured or not; None where more may come than anybody knows.
    """
    config = method.release
    required = min_units(config.risk)
    if len(lot_audits) >= required:
        return Qualification(
            THIS_LOT, tuple(lot_audits), 0, reason("part.here", audits=len(lot_audits)), tuple(lot_audits)
        )
    if not sensor_model:
        return _none(lot_audits, reason("part.no_model"), config, units)
    comparable = [audit for audit in past if (audit.sensor_model, audit.method_id) == (sensor_model, method.id)]
    lasts = timedelta(days=config.lasts_days)
    recent = [audit for audit in comparable if now - audit.made_at <= lasts]
    failed = [audit.made_at for audit in recent if audit.has_failed]
    since = max([*failed, *([golden_failed_at] if golden_failed_at else [])], default=None)
    valid = [audit for audit in recent if since is None or audit.made_at > since]
    lots = {audit.unit.lot_id for audit in valid}
    if len(valid) + len(lot_audits) >= required and len(lots) >= config.min_lots:
        audits = (*lot_audits, *(audit.unit for audit in valid))
        evidence = reason("part.of_lots", audits=len(valid), lots=len(lots))
        return Qualification(EARLIER_LOTS, audits, 0, evidence, tuple(lot_audits))
    failing = (
        (not past, reason("part.no_lot")),
        (not comparable, reason("part.other_method")),
        (not recent, reason("part.old_audits", days=config.lasts_days)),
        (len(valid) < len(recent), reason("part.withdrawn")),
        (True, reason("part.few_lots", audits=len(valid), lots=len(lots), least=config.min_lots)),
    )
    return _none(lot_audits, next(cause for applies, cause in failing if applies), config, units)


def small_lot(units: int, config: ReleaseConfig) -> Reason | None:
    """Say what a lot is to do that has no unit left once enough are audited; None for a larger one."""
    required = min_units(config.risk)
    if units > required:
        return None
    return reason("part.small_lot", units=units, wanted=required, least=config.min_lots)


def _none(lot_audits: Sequence[AuditedUnit], cause: Reason, config: ReleaseConfig, units: int | None) -> Qualification:
    missing, small = min_units(config.risk) - len(lot_audits), None if units is None else small_lot(units, config)
    if small is None or units is None:
        missing_reason = reason("part.unqualified", audits=len(lot_audits), why=cause, missing=missing)
        return Qualification(NONE, (), missing, missing_reason, tuple(lot_audits))
    missing_reason = reason("part.unqualified_small", audits=len(lot_audits), why=cause, small=small)
    return Qualification(NONE, (), max(units - len(lot_audits), 0), missing_reason, tuple(lot_audits))
