"""The decision on one unit: the four words, their order, and what they release.

A limit is agreed before measuring; the guard bands follow ILAC-G8:09/2019. What was measured outranks a forecast.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from softcal.core.errors import InputError
from softcal.core.messages.reason import Reason, Value, reason
from softcal.core.unit.measured_error import Scores
from softcal.core.unit.method import DecisionConfig
from softcal.core.unit.uncertainty import ErrorForecast


class Verdict(StrEnum):
    """The word on a unit, from best to worst.

    A retest outranks a fail: nothing can be said about the unit yet, so nothing may be held against it either.
    """

    PASS = "pass"
    CONDITIONAL = "conditional"
    FAIL = "fail"
    RETEST = "retest"

    @property
    def severity(self) -> int:
        """0 for the best word, more for worse ones."""
        return VERDICTS.index(self)

    @property
    def is_open(self) -> bool:
        """Whether nothing that was found stands against a unit of this word."""
        return self in (Verdict.PASS, Verdict.CONDITIONAL)

    @property
    def conformity(self) -> str:
        """The statement on a certificate (ILAC-G8:09/2019, section 4.2.3); empty where none may be made."""
        if self is Verdict.RETEST:
            return ""
        return "conditional pass" if self is Verdict.CONDITIONAL else str(self)


VERDICTS = tuple(Verdict)


def worst_of(verdicts: Iterable[str]) -> Verdict:
    """Return the most severe of several verdicts; pass where there is none."""
    return max(map(Verdict, verdicts), key=VERDICTS.index, default=Verdict.PASS)


class Release(StrEnum):
    """Which verdicts release a unit's files: those that pass, or conditional ones too where somebody asked for it."""

    PASS = "pass"
    CONDITIONAL = "conditional"

    def releases(self, verdict: str) -> bool:
        """Whether files of a unit with this verdict are written.

        A conditional verdict always has its error, forecast or measured, within the limit: beyond it the word is fail.
        """
        return verdict == Verdict.PASS or (self is Release.CONDITIONAL and verdict == Verdict.CONDITIONAL)


@dataclass(frozen=True)
class Limit:
    """The largest error a unit may have: the tolerance limit TL of ILAC-G8.

    Args:
        maximum_rmse: tolerance limit for the RMSE against the reference, in `unit`.
        origin: where the number comes from, said with every verdict.
        reference_expanded: U (k = 2) of the reference itself, in `unit`; None where nobody stated it.
        full_range: of the source's reference, in `unit`; of a limit that nobody stated.

    Raises:
        InputError: the limit is not a positive number.
    """

    unit: str
    maximum_rmse: float
    origin: Reason = Reason("part.stated")
    reference_expanded: float | None = None
    full_range: float | None = None

    def __post_init__(self) -> None:
        if not 0 < self.maximum_rmse < float("inf"):
            raise InputError(f"limit maximum_rmse = {self.maximum_rmse} {self.unit}; a positive number was expected")

    @property
    def is_stated(self) -> bool:
        """Whether somebody agreed on it; else it follows from the source's own error, and no unit passes by it."""
        return str(self.origin) == str(Limit.origin)

    @property
    def stated_rmse(self) -> float | None:
        """The limit that somebody agreed on; None where nobody did."""
        return self.maximum_rmse if self.is_stated else None

    @property
    def acceptance_rmse(self) -> float:
        """The largest error, with its guard band, that passes: AL of ILAC-G8:09/2019.

        An error r against a reference that is itself wrong by b is an error sqrt(r^2 + b^2) against the truth, so
        AL^2 = TL^2 - U^2. With |b| < U in 95 % of cases, fewer than 5 % of units at AL are beyond TL; 0: none passes.
        """
        return float(np.sqrt(max(self.maximum_rmse**2 - (self.reference_expanded or 0.0) ** 2, 0.0)))

    def to_json(self) -> dict[str, object]:
        return {**vars(self), "origin": self.origin.to_json()}


def stated_limit(unit: str, rmse: float | None) -> Limit | None:
    """Return the limit a lot states; None where it leaves it to the source's own error."""
    return None if rmse is None else Limit(unit, rmse)


def default_limit(
    unit: str,
    source_rmse: float,
    full_range: float,
    config: DecisionConfig,
) -> Limit:
    """Return what units of a lot that states no limit fail by: a multiple of the source's held-out RMSE.

    Args:
        full_range: of the source's reference, in `unit`.
    """
    origin = reason("part.automatic", factor=config.default_factor, rmse=source_rmse, unit=unit)
    return Limit(unit, config.default_factor * source_rmse, origin, full_range=full_range)


@dataclass(frozen=True)
class Finding:
    """Something seen, in a sentence a line operator can act on, and the best verdict a unit can still get with it."""

    reason: Reason
    best: Verdict = Verdict.CONDITIONAL

    @property
    def kind(self) -> str:
        """Short name, for example `too little data`."""
        return self.reason.code.replace("_", " ")


@dataclass(frozen=True)
class Assessment:
    """What one error, forecast or measured, says together with what was found."""

    verdict: Verdict
    reasons: tuple[Reason, ...]


@dataclass(frozen=True)
class Decision:
    """What is decided on one unit, and on what.

    Args:
        predicted: from the forecast and the findings; alone it is conditional at best.
        measured: from an audit; it counts wherever there is one.
        sampled: from audits of other units of the lot; it counts where the unit itself was not measured.
        blocking_reasons: what keeps the unit from passing whatever its error is.
        suspect_audit: why its audit may not be of this unit: nothing is decided before that is known.
    """

    predicted: Assessment
    measured: Assessment | None = None
    sampled: Assessment | None = None
    blocking_reasons: tuple[Reason, ...] = ()
    suspect_audit: Reason | None = None

    @property
    def verdict(self) -> Verdict:
        if self.suspect_audit is not None:
            return Verdict.RETEST
        assessed = self.measured or self.sampled
        best = Verdict.CONDITIONAL if assessed is None or self.blocking_reasons else Verdict.PASS
        return worst_of([(assessed or self.predicted).verdict, best])

    @property
    def is_audited(self) -> bool:
        """Whether its error was measured, and nothing speaks against that."""
        return self.measured is not None and self.suspect_audit is None

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """Why, most important first; where an audit changed the word, what was predicted stands behind it."""
        if self.suspect_audit is not None:
            return (self.suspect_audit, *self._assessment_reasons, *self.blocking_reasons)
        if self.verdict.severity > Verdict.CONDITIONAL.severity:
            return (*self._assessment_reasons, *self.blocking_reasons)
        return (*self.blocking_reasons, *self._assessment_reasons)

    @property
    def _assessment_reasons(self) -> tuple[Reason, ...]:
        if self.measured is None and self.sampled is not None:
            return (*self.sampled.reasons, *self.predicted.reasons)
        if self.measured is None and self.predicted.verdict is Verdict.PASS:
            return (reason("forecast_only"), *self.predicted.reasons)
        if self.measured is None and self.predicted.verdict is Verdict.CONDITIONAL:
            return (*self.predicted.reasons, reason("forecast_only"))
        if self.measured is None or self.measured.verdict == self.predicted.verdict:
            return (self.measured or self.predicted).reasons
        cause = self.predicted.reasons[0]
        overruled = reason("predicted_otherwise", verdict=str(self.predicted.verdict), why=cause)
        return (*self.measured.reasons, overruled)


_STATED = {
    "pass": ("part.within", Verdict.PASS),
    "conditional pass": ("part.within_close", Verdict.CONDITIONAL),
    "conditional fail": ("part.above_close", Verdict.FAIL),
    "fail": ("part.above", Verdict.FAIL),
}
"""How each statement is said, and the word it leaves."""


def statement(error: ErrorForecast, limit: Limit) -> str:
    """Place an error against the limit with the guard band w = upper - error, ILAC-G8:09/2019 section 4.2.3.

    Pass: upper <= AL, so the probability of a false accept is below 2.5 % (5 % where the reference's own uncertainty
    counts). Conditional pass: the error itself is within TL. Conditional fail: lower <= TL. Fail: even the lower end is
    above TL.
    """
    if error.upper <= limit.acceptance_rmse:
        return "pass"
    if error.rmse <= limit.maximum_rmse:
        return "conditional pass"
    return "conditional fail" if error.lower <= limit.maximum_rmse else "fail"


def compare_with_limit(
    error: ErrorForecast, limit: Limit, findings: tuple[Finding, ...] = (), source: str = "predicted"
) -> Assessment:
    """Combine an error, `predicted` or `measured`, with what was found; the worse of the words stands.

    Nothing passes by a limit that nobody stated.
    """
    relation, stated_verdict = _STATED[statement(error, limit)]
    ordered = sorted(findings, key=lambda finding: -finding.best.severity)
    reasons, bounds = [finding.reason for finding in ordered], [finding.best for finding in findings]
    numbers: dict[str, Value] = {"source": Reason(f"part.{source}"), **vars(error), "unit": limit.unit}
    if not limit.is_stated and stated_verdict is not Verdict.FAIL:
        limit_reason = reason("no_limit", share=error.rmse / (limit.full_range or np.nan), **numbers)
        return Assessment(worst_of([Verdict.CONDITIONAL, *bounds]), (*reasons, limit_reason))
    numbers |= {"relation": Reason(relation), "limit": limit.maximum_rmse, "origin": limit.origin}
    limit_reason, verdict = reason("statement", **numbers), worst_of([stated_verdict, *bounds])
    # An error beyond the limit is the first thing to say; else what was found is.
    if limit.acceptance_rmse < error.upper <= limit.maximum_rmse:
        reasons.append(reason("reference_uncertain", expanded=limit.reference_expanded or 0.0, unit=limit.unit))
    return Assessment(
        verdict,
        (limit_reason, *reasons)
        if stated_verdict is Verdict.FAIL and verdict is Verdict.FAIL
        else (*reasons, limit_reason),
    )


def compare_with_audit(scores: Scores, limit: Limit, findings: tuple[Finding, ...] = ()) -> Assessment:
    """Decide on a unit by what its audit showed of f before and after its map, in the limit's unit."""
    before, after = scores.before.rmse, scores.after.rmse
    harm = reason("harmful", after=after, before=before, unit=limit.unit)
    harmful = (Finding(harm, Verdict.FAIL),) if after > before else ()
    return compare_with_limit(scores.after.interval, limit, (*harmful, *findings), source="measured")
