"""The decision on the units of a lot that nobody measured: qualification, bound, unit assessments, one statement."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from softcal.core.messages.reason import Reason, Value, reason, several
from softcal.core.quality.qualification import Qualification
from softcal.core.quality.release import AuditedUnit, ReleaseDecision, release
from softcal.core.quality.sittings import SampledUnits, sampled_units
from softcal.core.unit.adjustments import SampleRelease
from softcal.core.unit.line_spread import EstimatedGains
from softcal.core.unit.method import ReleaseConfig
from softcal.core.unit.uncertainty import IntervalInflation
from softcal.core.unit.verdict import Limit


@dataclass(frozen=True)
class LotRelease:
    """What is decided on the unmeasured units of a lot, and what is promised about those released.

    Args:
        decision: which of them are released; None without a qualification.
        gains: gains that audited units of this lot read their loads with; None where too few were audited.
        day_errors: by serial, the error that another day adds as golden runs show it; empty without them.
        corrected_by: number of audited units behind the correction of the lot's maps; 0 where there is none.
        sampled: for which units the audits speak, where units of one sitting share an error.
    """

    qualification: Qualification
    limit: Limit
    config: ReleaseConfig
    forecasts: Mapping[str, float]
    decision: ReleaseDecision | None
    interval_inflation: IntervalInflation
    gains: EstimatedGains | None = None
    day_errors: Mapping[str, float] = field(default_factory=dict)
    suspects: Mapping[str, Reason] = field(default_factory=dict)
    corrected_by: int = 0
    sampled: SampledUnits | None = None

    @property
    def audits(self) -> tuple[AuditedUnit, ...]:
        """The audited units it rests on; where they do not suffice, those of the lot."""
        return self.qualification.audits or self.qualification.lot_audits

    @property
    def released(self) -> tuple[str, ...]:
        """Serials released on the audits of others."""
        return () if self.decision is None else self.decision.released

    @property
    def forecast_scale(self) -> float:
        """Mean of measured over forecast error: what a forecast of this lot is to be multiplied with; 1 if unknown."""
        return 1.0 if self.decision is None else float(np.exp(self.decision.ratios.centre))

    @cached_property
    def statement(self) -> Reason:
        """The promise, or why there is none, and what the audits show beside it."""
        parts, unit = [self._criterion_statement()], self.limit.unit
        if self.gains is not None:
            parts.append(reason("release.gains", centre=self.gains.centre, spread=self.gains.spread))
        if self.sampled is not None and self.sampled.reason is not None:
            parts.append(self.sampled.reason)
        if self.day_errors:
            parts.append(reason("release.days", day=max(self.day_errors.values()), unit=unit))
        if self.corrected_by:
            parts.append(reason("release.common", audits=self.corrected_by))
        if self.suspects:
            parts.append(reason("release.doubts", serials=", ".join(self.suspects)))
        return several(parts)

    def _criterion_statement(self) -> Reason:
        decision, lot_audits, which = self.decision, self.qualification.lot_audits, self.qualification.reason
        if not self.limit.is_stated:
            return reason("release.no_limit")
        bound: Mapping[str, Value] = {"limit": self.limit.maximum_rmse, "unit": self.limit.unit}
        if not self.forecasts and lot_audits:
            return reason(
                "release.none_left", seen=_audited(lot_audits, reason("part.here", audits=len(lot_audits)), bound)
            )
        if decision is None:
            return reason("release.unqualified", why=which)
        observed = _audited(self.qualification.audits, which, bound)
        if not self.forecasts:
            return reason("release.none_left", seen=observed)
        count = len(self.forecasts)
        if not decision.released:
            part, factor = self.config.min_part, decision.factor
            return reason("release.poor", seen=observed, part=part, open=count, factor=factor)
        return reason(
            "release.promised",
            seen=observed,
            risk=self.config.risk,
            confidence=self.config.confidence,
            released=len(decision.released),
            open=count,
            any_form=any_form(decision),
            **bound,
        )

    def sample_release(self, serial: str, number: int) -> SampleRelease | None:
        """Return what this decision says of one of the units decided on; None where nothing is promised.

        Args:
            number: of the statement.
        """
        if self.decision is None or serial not in self.forecasts:
            return None
        return self._sample_release(number, self.decision, serial in self.released, self.day_errors.get(serial, 0.0))

    def next_unit(self, number: int) -> SampleRelease | None:
        """Return what this decision says of a unit that is to come; None where nothing is released on it."""
        return (
            None
            if self.decision is None or not self.released
            else self._sample_release(number, self.decision, False, 0.0)
        )

    def _sample_release(
        self, number: int, decision: ReleaseDecision, is_released: bool, day_rmse: float
    ) -> SampleRelease:
        return SampleRelease(
            number=number,
            limit_rmse=self.limit.maximum_rmse,
            is_released=is_released,
            scale=self.forecast_scale,
            factor=decision.factor if np.isfinite(decision.factor) else None,
            interval_inflation=self.interval_inflation,
            day_rmse=day_rmse,
            audits=self._audits(decision),
            risk=self.config.risk,
            confidence=self.config.confidence,
            sitting="" if self.sampled is None else self.sampled.sitting,
        )

    def _audits(self, decision: ReleaseDecision) -> Reason:
        ratios = decision.ratios
        if ratios.lots > 1:
            return reason("part.of_lots", audits=ratios.audits, lots=ratios.lots)
        return reason("part.here", audits=ratios.audits)

    def to_json(self) -> dict[str, object]:
        """Return it as the JSON of `softcal batch --json` and `softcal lot release --json`."""
        decision = self.decision
        ratios = None if decision is None else {**vars(decision.ratios)}
        return {
            "audits": len(self.qualification.audits),
            "audited": len(self.qualification.lot_audits),
            "risk": self.config.risk,
            "confidence": self.config.confidence,
            "statement": str(self.statement),
            "statement_reason": self.statement.to_json(),
            "qualification": self.qualification.source,
            "reason": str(self.qualification.reason),
            "wanted": self.qualification.required,
            "considered": len(self.forecasts),
            "released": list(self.released),
            "factor": None if decision is None or not np.isfinite(decision.factor) else decision.factor,
            "ratios": ratios,
            "share_any_form": None if decision is None else decision.share_any_form,
            "risk_any_form": None if decision is None else decision.risk_any_form,
            "interval_scale": self.interval_inflation.scale,
            "interval_added": self.interval_inflation.added,
            "gains": None if self.gains is None else vars(self.gains),
            "day_rmse": max(self.day_errors.values(), default=None),
            "limit": self.limit.to_json(),
            "corrected_by": self.corrected_by,
            "set_aside": {serial: str(cause) for serial, cause in self.suspects.items()},
        }


def release_lot(
    forecasts: Mapping[str, float],
    qualification: Qualification,
    limit: Limit,
    config: ReleaseConfig,
    inflation: IntervalInflation = IntervalInflation(),  # noqa: B008 - frozen
    min_count: float = 0.0,
    gains: EstimatedGains | None = None,
    day_errors: Mapping[str, float] | None = None,
    suspects: Mapping[str, Reason] | None = None,
    corrected_by: int = 0,
    sittings: Mapping[str, str] | None = None,
    candidates: Collection[str] | None = None,
) -> LotRelease:
    """Decide on the units of a lot that nobody measured.

    Args:
        forecasts: forecast RMSE by serial of the units no finding stands against.
        min_count: number of units that must pass, or none is released.
        day_errors: by serial, the error that another day adds as golden runs show it, in the forecasts' unit.
        sittings: by serial, of the units that share an error with those of their sitting.
        candidates: serials that may be released; None for all.
    """
    sampled = sampled_units(
        qualification.audits, {serial: (sittings or {}).get(serial, "") for serial in forecasts}, config
    )
    forecasts = {serial: rmse for serial, rmse in forecasts.items() if serial in sampled.serials}
    may_release = qualification.is_given and limit.is_stated
    decided = (
        release(forecasts, sampled.audits, limit, config, min_count, day_errors, candidates) if may_release else None
    )
    day_errors, suspects = day_errors or {}, suspects or {}
    return LotRelease(
        qualification, limit, config, forecasts, decided, inflation, gains, day_errors, suspects, corrected_by, sampled
    )


def _audited(audits: Sequence[AuditedUnit], which: Reason, bound: Mapping[str, Value]) -> Reason:
    nonconforming = sum(audit.measured_rmse > float(bound["limit"]) for audit in audits)  # type: ignore[arg-type]
    return reason("part.audits_beyond", audits=which, beyond=nonconforming, **bound)


def any_form(decision: ReleaseDecision) -> Reason:
    """Return what holds for the released units for ratios of any distribution."""
    if decision.share_any_form < 1:
        return reason("part.any_form", share=decision.share_any_form, risk=decision.risk_any_form)
    return reason("part.any_form_mean", risk=decision.risk_any_form)
