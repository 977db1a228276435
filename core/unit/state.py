"""The life of one unit: its fit, what was done to it since, and everything that follows from both.

A state never changes; an act returns another one. Each act fills a slot of its own, and all that is said of a unit is
computed from the slots. So acts on different slots commute, and no two statements about a unit can disagree
(docs/decisions/0144-one-state-of-a-unit.md).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from softcal.core.identity import content_sha256
from softcal.core.maps.anchors import AnchoredMap
from softcal.core.maps.interface import Anchors, UnitMap, map_sha256
from softcal.core.messages.reason import Reason, Value, reason
from softcal.core.recording import Array
from softcal.core.unit.budget import Reference
from softcal.core.unit.calibration import Calibration
from softcal.core.unit.health import OutputLimits
from softcal.core.unit.knowledge import LoadKnowledge
from softcal.core.unit.lot_fit_part import LotFitPart
from softcal.core.unit.measured_error import Scores
from softcal.core.unit.method import Method
from softcal.core.unit.missing import MissingShares
from softcal.core.unit.output_level import LoadLine, OutputLevel
from softcal.core.unit.uncertainty import ErrorForecast, Interval, Widening
from softcal.core.unit.verdict import (
    Decision,
    Finding,
    Judgement,
    Limit,
    Verdict,
    compare_with_audit,
    compare_with_limit,
    worst_of,
)


@dataclass(frozen=True, eq=False)
class FittedMap:
    """The arrays of a fit: the map γ, its 90 % interval, and the limits of the unit's output."""

    unit_map: UnitMap
    interval: Interval
    output_limits: OutputLimits


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """What one recording gave: never changed by anything that comes later. Errors are in the reference unit.

    Args:
        id: content hash of what it was fitted from: recording, network, method, known loads, golden run.
        map_sha256: content hash of the map γ.
        knowledge: how unit and source correspond.
        budget: standard uncertainties u_i of the forecast by term (GUM, JCGM 100:2008).
        own_terms, own_rmse: the same of a calibration with the unit's own labels, and the forecast of its error.
        diagnostics: numbers of the map's family, for people to read.
        findings, rule_findings: what recording and map show against the unit; what rules of other packages say.
        remarks: what is said last beside a forecast.
        blocking_reasons: what keeps the unit from passing whatever its error is.
        rules: identities of the rules of other packages that were asked.
        reference: what the source is traced to; None where nobody said.
        missing: shares of samples and windows that are missing; None where nothing is.
        load_rms, correction_rms: RMS load above rest of the recording; RMS change that the map makes.
        lot_fit: its part in the fit of the lot; None where it was mapped by itself.
        fit_s: how long map and forecast took, in s.
        fitted: its arrays; None where units are listed without them.
    """

    id: str
    serial: str
    network_id: str
    recording_sha256: str
    family: str
    map_sha256: str
    method: Method
    knowledge: LoadKnowledge
    forecast: ErrorForecast
    budget: Mapping[str, float] = field(default_factory=dict)
    own_terms: Mapping[str, float] = field(default_factory=dict)
    own_rmse: float | None = None
    diagnostics: Mapping[str, float | str] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    rule_findings: tuple[Finding, ...] = ()
    remarks: tuple[Reason, ...] = ()
    blocking_reasons: tuple[Reason, ...] = ()
    rules: tuple[str, ...] = ()
    reference: Reference | None = None
    output_level: OutputLevel | None = None
    missing: MissingShares | None = None
    load_rms: float | None = None
    correction_rms: float | None = None
    readout_lag_s: float | None = None
    lot_fit: LotFitPart | None = None
    fit_s: float | None = None
    fitted: FittedMap | None = None

    @property
    def is_open(self) -> bool:
        """Whether no finding stands against the unit: its forecast alone may, and audits can correct that."""
        return worst_of(one.best for one in (*self.findings, *self.rule_findings)).is_open


@dataclass(frozen=True, kw_only=True)
class Trim:
    """Known loads at the place of use, and the straight line behind the map that reads them.

    Args:
        output, reference: (k,) of the loads, in their units.
        recording_sha256: of the recording whose map was trimmed.
        audit_sha256: of the unit's audit of then; empty where it had none.
        gain, offset: of the line behind γ, in the source's output unit.
        covariance: (2, 2) of zero and gain of the estimates, in the reference unit and in its share.
        before_rmse, after_rmse: error of the estimates at the loads without and with the trim.
        left_out: why the loads are not behind this fit's map; None where they are.
        is_blocking: whether the unit cannot pass while they are left out.
    """

    output: tuple[float, ...]
    reference: tuple[float, ...]
    recording_sha256: str
    audit_sha256: str = ""
    gain: float = 1.0
    offset: float = 0.0
    covariance: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (0.0, 0.0))
    before_rmse: float = 0.0
    after_rmse: float = 0.0
    left_out: Reason | None = None
    is_blocking: bool = False

    @property
    def loads(self) -> Anchors:
        return Anchors(np.array(self.output), np.array(self.reference))

    @property
    def gain_error(self) -> float:
        """Standard uncertainty of the gain, as a share of it."""
        return float(np.sqrt(self.covariance[1][1]))

    @property
    def rest_error(self) -> float:
        """Standard uncertainty of an estimate without load, in the reference unit."""
        return float(np.sqrt(self.covariance[0][0]))

    def variance(self, interval: Interval) -> Array:
        """Return the (LEVELS,) variance of the trim at the load levels of an interval, in squares of the reference.

        The errors at the loads are independent, and run on in a straight line between and beyond them.
        """
        line = np.stack([np.ones(len(interval.levels)), interval.levels], axis=1)
        return np.asarray(np.sum((line @ np.array(self.covariance)) * line, axis=1))


@dataclass(frozen=True, kw_only=True)
class Correction:
    """A gain and a zero that audited units of the lot read alike, taken off this unit's map.

    Args:
        number: of the decision of the lot that it rests on, 1, 2, 3 ...
        line: what is taken off: corrected estimate = (estimate - zero) / gain.
        gain_error, zero_error: standard uncertainties, as a share and in the reference unit.
        audits: number of audited units behind it.
        gain, offset: of the line behind γ that does it, in the source's output unit.
    """

    number: int
    line: LoadLine
    gain_error: float
    zero_error: float
    audits: int
    gain: float = 1.0
    offset: float = 0.0

    def variance(self, interval: Interval) -> Array:
        """Return the (LEVELS,) variance of the correction at the load levels, in squares of the reference unit."""
        return np.asarray((self.gain_error * interval.levels) ** 2 + self.zero_error**2)


@dataclass(frozen=True, kw_only=True)
class SampleRelease:
    """What the statement on a lot says of a unit that nobody measured.

    Args:
        number: of the statement, 1, 2, 3 ...
        limit_rmse: limit that the statement was made for; for another one it says nothing.
        is_released: whether this unit is among the released ones.
        scale: mean of measured over forecast error of the audited units.
        factor: largest ratio reckoned with; None where it has no bound.
        widening: what becomes of the unit's 90 % intervals.
        day_rmse: error that another day adds to this unit, as golden runs show it.
        audits: which audits it rests on.
        risk, confidence: of the promise.
        sitting: whose units it speaks for alone; empty where it speaks for any.
        withdrawn: why the statement holds no more; None while it does.
    """

    number: int
    limit_rmse: float
    is_released: bool
    scale: float
    factor: float | None
    widening: Widening
    day_rmse: float
    audits: Reason
    risk: float
    confidence: float
    sitting: str = ""
    withdrawn: Reason | None = None

    def judgement(self, rmse: float, limit: Limit) -> Judgement:
        """Return what the statement says of a unit with this forecast RMSE."""
        if self.withdrawn is not None:
            word = Verdict.FAIL if rmse > limit.maximum_rmse else Verdict.CONDITIONAL
            return Judgement(word, (reason("not_qualified", why=self.withdrawn),))
        inputs: dict[str, Value] = {
            "rmse": rmse,
            "limit": limit.maximum_rmse,
            "unit": limit.unit,
            "audits": self.audits,
        }
        factor = float("inf") if self.factor is None else self.factor
        if self.is_released:
            risks: dict[str, Value] = {"risk": self.risk, "confidence": self.confidence}
            return Judgement(Verdict.PASS, (reason("sampled.released", factor=factor, **inputs, **risks),))
        if rmse * self.scale > limit.maximum_rmse:
            return Judgement(Verdict.FAIL, (reason("sampled.beyond", centre=self.scale, **inputs),))
        if rmse * factor > limit.acceptance_rmse:
            return Judgement(Verdict.CONDITIONAL, (reason("sampled.open", factor=factor, **inputs),))
        if float(np.hypot(rmse * factor, self.day_rmse)) > limit.acceptance_rmse:
            said = reason("sampled.day", factor=factor, day=self.day_rmse, **inputs)
            return Judgement(Verdict.CONDITIONAL, (said,))
        return Judgement(Verdict.CONDITIONAL, (reason("sampled.part", centre=self.scale, audits=self.audits),))


@dataclass(frozen=True, kw_only=True)
class AuditResult:
    """What a labelled recording of the unit showed: an error with its rows, and the map that it is the error of.

    Args:
        map_id: of the state that was measured; another map has no measured error.
        recording_sha256, output_sha256: of the audit, and of its output alone.
        scores: errors of f on raw and mapped windows, with their rows.
        line: of the estimates over the reference (least squares): gain 1 reads the loads in full.
        fitted_line: the same of the map as it was fitted, before anything was taken off it.
        unit_rest, audit_rest, span: output at rest in the unit's recording and in the audit, span of the former.
        residual, half: (k,) |residual| and half-width of the 90 % interval at evenly spaced instants, before audits of
            other units widened it, in the reference unit.
    """

    map_id: str
    recording_sha256: str
    output_sha256: str
    scores: Scores
    line: LoadLine
    fitted_line: LoadLine
    unit_rest: float
    audit_rest: float
    span: float
    residual: tuple[float, ...]
    half: tuple[float, ...]


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
    def line_behind(self) -> Trim | Correction | None:
        """The straight line behind the fitted map: known loads outrank what the lot's audits say."""
        return self.trim_in_force or self.correction

    @property
    def knowledge(self) -> LoadKnowledge:
        """How unit and source correspond; known loads of a trim count."""
        return replace(self.fit.knowledge, is_anchored=True) if self.trim_in_force else self.fit.knowledge

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

    @property
    def interval(self) -> Interval:
        """The 90 % interval in force."""
        interval = self.measured_interval
        if self.release_in_force is None:
            return interval
        return replace(interval, half_width=self.release_in_force.widening(interval.half_width))

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
        own, release = self.fit.forecast, self.release_in_force
        if release is None or release.withdrawn is not None:
            return own
        # Beyond a finite factor nothing is known; the forecast keeps the end it had.
        upper = own.upper * release.scale if release.factor is None else own.rmse * release.factor
        return ErrorForecast(own.rmse * release.scale, own.lower * release.scale, upper)

    @property
    def predicted_rmse(self) -> float:
        return self.forecast.rmse

    @property
    def calibration(self) -> Calibration:
        """All that an estimate f∘γ needs."""
        return Calibration(
            serial=self.serial,
            network_id=self.fit.network_id,
            unit_map=self.unit_map,
            interval=self.interval,
            output_limits=self.fitted.output_limits,
            method=self.fit.method,
            predicted_rmse=self.predicted_rmse,
        )

    @property
    def scores(self) -> Scores | None:
        """What its audit showed of the map in force; None where nothing did, or the audit is suspect."""
        return None if self.audit is None or self._measured is None else self.audit.scores

    @property
    def errors(self) -> dict[str, float | None]:
        """Forecast and measured errors in the reference unit, by the names of reports; None where there is none."""
        scores = self.scores
        own = None if scores is None or scores.own is None else scores.own.own.rmse
        return {
            "predicted_rmse": self.predicted_rmse,
            "before_rmse": None if scores is None else scores.before.rmse,
            "after_rmse": None if scores is None else scores.after.rmse,
            "own_rmse": own,
        }

    @cached_property
    def blocking_reasons(self) -> tuple[Reason, ...]:
        """What keeps the unit from passing whatever its error is."""
        trim, audit, said = self.trim, self.audit, list[Reason]()
        is_measured = audit is not None and audit.map_id == self.map_id
        if trim is not None and trim.left_out is not None:
            is_older = audit is None or audit.recording_sha256 == trim.audit_sha256
            said += [trim.left_out] if trim.is_blocking and is_older else []
        elif trim is not None and not is_measured:
            said.append(reason("trimmed", loads=len(trim.output), before=trim.before_rmse, after=trim.after_rmse))
        if audit is not None and not is_measured:
            said.append(reason("audited_before_trim"))
        unreadable = () if self.unreadable_audit is None else (self.unreadable_audit,)
        return (*said, *unreadable, *self.fit.blocking_reasons)

    @cached_property
    def _measured(self) -> Judgement | None:
        if self.audit is None:
            return None
        judged = compare_with_audit(self.audit.scores, self.limit, self.fit.rule_findings)
        # A measured fail stays: known loads say nothing about what lies between and beyond them.
        is_of_this_map = self.audit.map_id == self.map_id
        return judged if is_of_this_map or judged.verdict is Verdict.FAIL else None

    @cached_property
    def decision(self) -> Decision:
        """The one decision on the unit, and what it rests on."""
        fit, release = self.fit, self.release_in_force
        predicted = compare_with_limit(fit.forecast, self.limit, (*fit.findings, *fit.rule_findings))
        predicted = replace(predicted, reasons=(*predicted.reasons, *fit.remarks, *self._remarks))
        return Decision(
            predicted=predicted,
            measured=self._measured,
            sampled=None if release is None else release.judgement(fit.forecast.rmse, self.limit),
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
