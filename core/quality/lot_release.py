"""The decision on the units of a lot that nobody measured: qualification, bound, a judgement a unit, one statement."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from softcal.core.quality.acceptance import Promise
from softcal.core.quality.qualification import Qualification
from softcal.core.quality.release import AuditedUnit, PromisedRelease, release
from softcal.core.unit.line_spread import SeenGains
from softcal.core.unit.method import ReleaseConfig
from softcal.core.unit.verdict import Judgement, Limit, Verdict
from softcal.core.words.reason import Reason, Value, reason


@dataclass(frozen=True)
class LotRelease:
    """What is decided on the unmeasured units of a lot, and what is promised about those released.

    Args:
        qualification: whether units may be released, and on which audits.
        limit: of the lot.
        promise: asked for.
        forecasts: forecast RMSE by serial of the units decided on.
        found: which of them are released; None without a qualification.
        interval_scale: factor on the half-width of their 90 % intervals.
        statement: the promise, or why there is none, in one sentence.
        seen: gains that audited units of this lot read their loads with; None where too few were audited.
        days: by serial, the error that another day adds as golden runs show it; empty without them.
    """

    qualification: Qualification
    limit: Limit
    promise: Promise
    forecasts: Mapping[str, float]
    found: PromisedRelease | None
    interval_scale: float
    statement: str
    seen: SeenGains | None = None
    days: Mapping[str, float] = field(default_factory=dict)

    @property
    def released(self) -> tuple[str, ...]:
        """Serials released on the audits of others."""
        return () if self.found is None else self.found.released

    @property
    def forecast_scale(self) -> float:
        """Mean of measured over forecast error: what a forecast of this lot is to be multiplied with; 1 if unknown."""
        return 1.0 if self.found is None else float(np.exp(self.found.ratios.centre))

    def judgement(self, serial: str) -> Judgement:
        """Return what the audits of the lot say about one of the units decided on."""
        if self.found is None:
            return Judgement(Verdict.CONDITIONAL, (reason("not_qualified", why=self.qualification.reason),))
        rmse, limit, unit = self.forecasts[serial], self.limit.maximum_rmse, self.limit.unit
        facts: Mapping[str, Value] = {"rmse": rmse, "limit": limit, "unit": unit, "audits": self._audits(self.found)}
        factor, centre = self.found.factor, self.forecast_scale
        if serial in self.released:
            risks = {"risk": self.promise.risk, "confidence": self.promise.confidence}
            return Judgement(Verdict.PASS, (reason("sampled.released", factor=factor, **facts, **risks),))
        if rmse * centre > limit:
            return Judgement(Verdict.FAIL, (reason("sampled.beyond", centre=centre, **facts),))
        day, accepted = self.days.get(serial, 0.0), self.limit.acceptance_rmse
        if rmse * factor <= accepted < float(np.hypot(rmse * factor, day)):
            return Judgement(Verdict.CONDITIONAL, (reason("sampled.day", factor=factor, day=day, **facts),))
        if rmse * factor <= accepted:
            return Judgement(
                Verdict.CONDITIONAL, (reason("sampled.part", centre=centre, audits=self._audits(self.found)),)
            )
        return Judgement(Verdict.CONDITIONAL, (reason("sampled.open", factor=factor, **facts),))

    def _audits(self, found: PromisedRelease) -> Reason:
        ratios = found.ratios
        if ratios.lots > 1:
            return reason("part.of_lots", audits=ratios.audits, lots=ratios.lots)
        return reason("part.here", audits=ratios.audits)

    def to_json(self) -> dict[str, object]:
        """Return it as the JSON of `softcal batch --json` and `softcal lot release --json`."""
        found = self.found
        ratios = None if found is None else {**vars(found.ratios)}
        return {
            "audits": len(self.qualification.audits),
            "risk": self.promise.risk,
            "confidence": self.promise.confidence,
            "statement": self.statement,
            "qualification": self.qualification.source,
            "reason": str(self.qualification.reason),
            "wanted": self.qualification.wanted,
            "considered": len(self.forecasts),
            "released": list(self.released),
            "factor": None if found is None or not np.isfinite(found.factor) else found.factor,
            "ratios": ratios,
            "share_any_form": None if found is None else found.share_any_form,
            "risk_any_form": None if found is None else found.risk_any_form,
            "interval_scale": self.interval_scale,
            "gains": None if self.seen is None else vars(self.seen),
            "day_rmse": max(self.days.values(), default=None),
            "limit": self.limit.to_json(),
        }


def release_lot(
    forecasts: Mapping[str, float],
    qualification: Qualification,
    limit: Limit,
    promise: Promise,
    interval_scale: float = 1.0,
    least: float = 0.0,
    seen: SeenGains | None = None,
    days: Mapping[str, float] | None = None,
) -> LotRelease:
    """Decide on the units of a lot that nobody measured.

    Args:
        forecasts: forecast RMSE by serial of the units no finding stands against.
        qualification: on which audits, if any.
        limit: of the lot, in the forecasts' unit.
        promise: what is to hold for the released units.
        interval_scale: factor on their intervals, from the same audits.
        least: number of units that must pass, or none is released.
        seen: gains that audited units of this lot read their loads with.
        days: by serial, the error that another day adds as golden runs show it, in the forecasts' unit.
    """
    found = release(forecasts, qualification.audits, limit, promise, least, days) if qualification.is_given else None
    statement = _statement(forecasts, qualification.audits, found, qualification, limit, promise)
    statement += _seen(seen) + _told_days(days or {}, limit.unit)
    return LotRelease(qualification, limit, promise, forecasts, found, interval_scale, statement, seen, days or {})


def _seen(seen: SeenGains | None) -> str:
    if seen is None:
        return ""
    return f"; the audited units read {seen.centre:.1%} of their loads, with a spread of {seen.spread:.1%} between them"


def _told_days(days: Mapping[str, float], unit: str) -> str:
    if not days:
        return ""
    return f"; up to {max(days.values()):.3g} {unit} is kept for another day, as golden runs show it"


def _statement(
    forecasts: Mapping[str, float],
    audits: Sequence[AuditedUnit],
    found: PromisedRelease | None,
    qualification: Qualification,
    limit: Limit,
    promise: Promise,
) -> str:
    bound = f"{limit.maximum_rmse:.3g} {limit.unit}"
    if found is None:
        return f"no unit is released by sample: {qualification.reason}"
    beyond = sum(audit.measured_rmse > limit.maximum_rmse for audit in audits)
    seen = f"{qualification.reason}, {beyond} of them beyond {bound}"
    if not forecasts:
        return f"no unit is left to release by sample: {seen}"
    if not found.released:
        return (
            f"no unit is released by sample: {seen}; fewer than {ReleaseConfig.least_part:.0%} of the lot, or of the "
            f"other {len(forecasts)} units, would pass at {found.factor:.2g} x their forecast"
        )
    return (
        f"with {seen}: at most {promise.risk:.0%} of the {len(found.released)} units released by sample (of "
        f"{len(forecasts)} unmeasured) are beyond {bound}, {promise.confidence:.0%} confidence; {any_form(found)}"
    )


def any_form(found: PromisedRelease) -> str:
    """Return what holds for the released units whatever form the ratios have."""
    share = f"{found.share_any_form:.1%} at that confidence and " if found.share_any_form < 1 else ""
    return f"whatever form the ratios have, at most {share}{found.risk_any_form:.1%} on average"
