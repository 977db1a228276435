"""The life of one unit: its fit, what was done to it since, and everything that follows from both.

A state never changes; an act returns another one. Each act fills a slot of its own, and all that is said of a unit is
computed from the slots. So acts on different slots commute, and no two statements about a unit can disagree
(docs/decisions/0144-one-state-of-a-unit.md). The slots are in `fit.py`, `adjustments.py` (trim, correction, release),
`measured_error.py` (audit) and `verdict.py` (limit, decision).
"""

from dataclasses import dataclass, replace
from functools import cached_property

from softcal.core.identity import content_sha256
from softcal.core.maps.anchors import AnchoredMap
from softcal.core.maps.interface import UnitMap, map_sha256
from softcal.core.messages.reason import Reason, reason
from softcal.core.unit.adjustments import Correction, SampleRelease, Trim
from softcal.core.unit.correspondence import Correspondence
from softcal.core.unit.fit import Fit, FittedMap
from softcal.core.unit.measured_error import AuditResult, Scores
from softcal.core.unit.uncertainty import ErrorForecast, Interval
from softcal.core.unit.verdict import (
    Assessment,
    Decision,
    Limit,
    Verdict,
    compare_with_audit,
    compare_with_limit,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class UnitState:
    """Where one unit stands: a fit, its adjustments, its audit, and the limit that it is held against.

    Args:
        trim, correction, release: adjustments; each fills a slot of its own.
        audit: what was measured last; `unreadable_audit` why a file that was brought as one cannot be read.
        suspect_audit: why the audit may not be of this unit: nothing is decided before that is known.
    """

    fit: Fit
    limit: Limit
    trim: Trim | None = None
    correction: Correction | None = None
    release: SampleRelease | None = None
    audit: AuditResult | None = None
    unreadable_audit: Reason | None = None
    suspect_audit: Reason | None = None

    @property
    def serial(self) -> str:
        return self.fit.serial

    @property
    def trim_in_force(self) -> Trim | None:
        return None if self.trim is None or self.trim.left_out is not None else self.trim

    @property
    def untrimmed(self) -> "UnitState":
        """As fit and correction read it: what its audit says of other units does not end with a trim of its own."""
        return replace(self, trim=None)

    @property
    def line_behind(self) -> Trim | Correction | None:
        """The straight line behind the fitted map: known loads outrank what the lot's audits say."""
        return self.trim_in_force or self.correction

    @property
    def correspondence(self) -> Correspondence:
        """How unit and source correspond; known loads of a trim count."""
        return replace(self.fit.correspondence, is_anchored=True) if self.trim_in_force else self.fit.correspondence

    @cached_property
    def map_id(self) -> str:
        """Identity of the map in force, known without its arrays."""
        line = self.line_behind
        return content_sha256({}, {"fit": self.fit.id, "line": None if line is None else [line.gain, line.offset]})

    @cached_property
    def map_sha256(self) -> str:
        """Content hash of the map in force."""
        return self.fit.map_sha256 if self.line_behind is None else map_sha256(self.unit_map)

    @cached_property
    def unit_map(self) -> UnitMap:
        """The map γ in force."""
        fitted, line = self.fitted.unit_map, self.line_behind
        return fitted if line is None else _line_behind(fitted, line.gain, line.offset)

    @cached_property
    def measured_interval(self) -> Interval:
        """The 90 % interval of the map in force, before audits of other units widened it."""
        interval, line = self.fitted.interval, self.line_behind
        return interval if line is None else interval.widened(line.variance(interval))

    @cached_property
    def interval(self) -> Interval:
        """The 90 % interval in force."""
        interval = self.measured_interval
        if self.release_in_force is None:
            return interval
        return replace(interval, half_width=self.release_in_force.interval_inflation(interval.half_width))

    @property
    def release_in_force(self) -> SampleRelease | None:
        """What audits of other units say of this one; None once it is measured, or something stands against it."""
        release = self.release
        if release is None or not self.fit.is_open or self._measured or self.blocking_reasons:
            return None
        return release if self.limit.is_stated and release.limit_rmse == self.limit.maximum_rmse else None

    @property
    def forecast(self) -> ErrorForecast:
        """Forecast of the error, as audits of other units scale it."""
        unscaled, release = self.fit.forecast, self.release_in_force
        if release is None or release.withdrawn is not None:
            return unscaled
        # Beyond a finite factor nothing is known; the forecast keeps the end it had.
        upper = unscaled.upper * release.scale if release.factor is None else unscaled.rmse * release.factor
        return ErrorForecast(unscaled.rmse * release.scale, unscaled.lower * release.scale, upper)

    @property
    def predicted_rmse(self) -> float:
        return self.forecast.rmse

    @property
    def scores(self) -> Scores | None:
        """What its audit showed of the map in force; None where nothing did, or the audit is suspect."""
        audit = self.audit
        if audit is None or audit.map_id != self.map_id or self.suspect_audit is not None:
            return None
        return audit.scores

    @property
    def errors(self) -> dict[str, float | None]:
        """Forecast and measured errors in the reference unit, by the names of reports; None where there is none."""
        scores = self.scores
        own_rmse = None if scores is None or scores.own is None else scores.own.own.rmse
        return {
            "predicted_rmse": self.predicted_rmse,
            "before_rmse": None if scores is None else scores.before.rmse,
            "after_rmse": None if scores is None else scores.after.rmse,
            "own_rmse": own_rmse,
        }

    @cached_property
    def blocking_reasons(self) -> tuple[Reason, ...]:
        """What keeps the unit from passing whatever its error is."""
        trim, audit, reasons = self.trim, self.audit, list[Reason]()
        is_measured = audit is not None and audit.map_id == self.map_id
        if trim is not None and trim.left_out is not None:
            is_older = audit is None or audit.recording_sha256 == trim.audit_sha256
            reasons += [trim.left_out] if trim.is_blocking and is_older else []
        elif trim is not None and not is_measured:
            reasons.append(reason("trimmed", loads=len(trim.output), before=trim.before_rmse, after=trim.after_rmse))
        if audit is not None and not is_measured:
            reasons.append(reason("audited_before_trim"))
        unreadable = () if self.unreadable_audit is None else (self.unreadable_audit,)
        return (*reasons, *unreadable, *self.fit.blocking_reasons)

    @cached_property
    def _measured(self) -> Assessment | None:
        if self.audit is None:
            return None
        assessment = compare_with_audit(self.audit.scores, self.limit, self.fit.rule_findings)
        # A measured fail stays: known loads say nothing about what lies between and beyond them.
        is_of_this_map = self.audit.map_id == self.map_id
        return assessment if is_of_this_map or assessment.verdict is Verdict.FAIL else None

    @cached_property
    def decision(self) -> Decision:
        """The one decision on the unit, and what it rests on."""
        fit, release = self.fit, self.release_in_force
        predicted = compare_with_limit(fit.forecast, self.limit, (*fit.findings, *fit.rule_findings))
        predicted = replace(predicted, reasons=(*predicted.reasons, *fit.remarks, *self._remarks))
        return Decision(
            predicted=predicted,
            measured=self._measured,
            sampled=None if release is None else release.assess(fit.forecast.rmse, self.limit),
            blocking_reasons=self.blocking_reasons,
            suspect_audit=self.suspect_audit,
        )

    @property
    def verdict(self) -> Verdict:
        return self.decision.verdict

    @property
    def is_released(self) -> bool:
        return self.verdict is Verdict.PASS

    @property
    def _remarks(self) -> tuple[Reason, ...]:
        trim, line = self.trim, self.line_behind
        if isinstance(line, Correction):
            numbers = {"gain": line.line.gain, "zero": line.line.zero, "audits": line.audits}
            return (reason("common", **numbers, unit=self.limit.unit),)
        return (trim.left_out,) if trim and trim.left_out and not trim.is_blocking else ()

    @property
    def fitted(self) -> FittedMap:
        """The arrays of the fit (`ValueError`: the unit was listed without them)."""
        if self.fit.fitted is None:
            raise ValueError(f"unit {self.serial} was listed without its arrays; ask for the unit itself")
        return self.fit.fitted


def _line_behind(unit_map: UnitMap, gain: float, offset: float) -> AnchoredMap:
    """Return a map followed by a straight line; one line in place of two behind one another."""
    if isinstance(unit_map, AnchoredMap):
        return AnchoredMap(unit_map.inner, gain * unit_map.gain, offset + gain * unit_map.offset)
    return AnchoredMap(unit_map, gain, offset)
