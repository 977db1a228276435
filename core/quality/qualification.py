"""Whether units may be released on their forecasts: enough audits of the product and method, none too old or failed.

No I/O here: the caller reads past audits and golden runs from wherever they are kept.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

from softcal.core.quality.acceptance import Promise
from softcal.core.quality.release import LEAST_LOTS, AuditedUnit, audits_wanted

THIS_LOT, EARLIER_LOTS, NONE = "this lot", "earlier lots", "none"


@dataclass(frozen=True)
class PastAudit:
    """An audit as it was kept.

    Args:
        unit: forecast and measured error.
        sensor_model: product of its lot.
        method_id: what made the forecast: map and forecast configuration, and their version.
        made_at: when it was measured.
        has_failed: the unit was accepted on its forecast, and its measured error is beyond the limit.
    """

    unit: AuditedUnit
    sensor_model: str
    method_id: str
    made_at: datetime
    has_failed: bool = False


@dataclass(frozen=True)
class QualificationRules:
    """What a qualification takes.

    Args:
        promise: what released units are to keep to.
        lasts: how long an audit of an earlier lot counts.
    """

    promise: Promise = Promise()
    lasts: timedelta = timedelta(days=365)


@dataclass(frozen=True)
class Qualification:
    """On which audits units of a lot may be released.

    Args:
        source: `this lot`, `earlier lots` or `none`.
        audits: the audited units that count; empty where there is none.
        wanted: audits of this lot that are still missing; 0 where it is qualified.
        reason: why, in one sentence.
    """

    source: str
    audits: tuple[AuditedUnit, ...]
    wanted: int
    reason: str

    @property
    def is_given(self) -> bool:
        """Whether units may be released."""
        return self.source != NONE


def qualify(
    here: Sequence[AuditedUnit],
    past: Sequence[PastAudit],
    now: datetime,
    sensor_model: str,
    method_id: str,
    golden_failed_at: datetime | None = None,
    rules: QualificationRules = QualificationRules(),  # noqa: B008 - frozen
) -> Qualification:
    """Say whether and on what audits the units of a lot may be released.

    Enough audits of the lot itself outrank all others. Audits of earlier lots count where they are of the same product
    and method, not older than `rules.lasts`, of three lots at least, and no later audit or golden unit failed: a
    failure withdraws everything before it.

    Args:
        here: audits of this lot.
        past: audits of other lots, of any product, method and age.
        now: the time of the decision.
        sensor_model, method_id: of this lot.
        golden_failed_at: when a golden unit last failed on the line that presses this lot.
    """
    wanted = audits_wanted(rules.promise)
    if len(here) >= wanted:
        return Qualification(THIS_LOT, tuple(here), 0, f"{len(here)} audited units of this lot")
    missing = wanted - len(here)
    if not sensor_model:
        return _none(missing, len(here), "the lot names no sensor_model, so no earlier lot counts for it")
    same = [audit for audit in past if (audit.sensor_model, audit.method_id) == (sensor_model, method_id)]
    fresh = [audit for audit in same if now - audit.made_at <= rules.lasts]
    failed = [audit.made_at for audit in fresh if audit.has_failed]
    since = max([*failed, *([golden_failed_at] if golden_failed_at else [])], default=None)
    standing = [audit for audit in fresh if since is None or audit.made_at > since]
    lots = {audit.unit.lot_id for audit in standing}
    if len(standing) + len(here) >= wanted and len(lots) >= LEAST_LOTS:
        audits = (*here, *(audit.unit for audit in standing))
        return Qualification(EARLIER_LOTS, audits, 0, f"{len(standing)} audited units of {len(lots)} earlier lots")
    return _none(missing, len(here), _why(past, same, fresh, standing, rules))


def _none(missing: int, here: int, why: str) -> Qualification:
    wanted = f"audit {missing} more units of this lot, drawn by its audit plan"
    return Qualification(NONE, (), missing, f"{here} audited units of this lot; {why}; {wanted}")


def _why(
    past: Sequence[PastAudit],
    same: Sequence[PastAudit],
    fresh: Sequence[PastAudit],
    standing: Sequence[PastAudit],
    rules: QualificationRules,
) -> str:
    if not past:
        return "no earlier lot was audited"
    if not same:
        return "the audits of earlier lots are of another sensor model or method"
    if not fresh:
        return f"the audits of earlier lots are older than {rules.lasts.days} days"
    if len(standing) < len(fresh):
        return "a failed audit or golden unit withdrew what earlier lots had shown"
    lots = len({audit.unit.lot_id for audit in standing})
    return f"{len(standing)} audited units of {lots} earlier lots are too few ({LEAST_LOTS} lots are needed)"
