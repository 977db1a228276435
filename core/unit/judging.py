"""What a unit is judged by, kept with its calibration: another limit or a doubt about its audit needs no new fit."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from softcal.core.unit.measured_error import Scores
from softcal.core.unit.uncertainty import ErrorForecast
from softcal.core.unit.verdict import Decision, Finding, Limit, Verdict, decide, decide_audited, worst_of
from softcal.core.words.reason import Reason


@dataclass(frozen=True)
class Grounds:
    """All that a unit's verdict rests on but the limit.

    Args:
        forecast: of its error, in the reference unit, before audits of other units scaled it.
        findings: what recording and map show against it.
        held: what rules of other packages have against it; they looked at the limit of then.
        told: what is said last beside a forecast.
        measured: what its audit showed.
        bars: what keeps it from passing whatever was found.
    """

    forecast: ErrorForecast
    findings: tuple[Finding, ...] = ()
    held: tuple[Finding, ...] = ()
    told: tuple[Reason, ...] = ()
    measured: Scores | None = None
    bars: tuple[Reason, ...] = ()
    rules: tuple[str, ...] = ()

    @property
    def is_open(self) -> bool:
        """Whether nothing that was found stands against it: its forecast alone may, and audits can correct that."""
        return worst_of(one.best for one in (*self.findings, *self.held)).is_open

    def decide(self, limit: Limit) -> Decision:
        """Decide against a limit in the unit of the errors."""
        predicted = decide(self.forecast, limit, (*self.findings, *self.held))
        predicted = replace(predicted, reasons=(*predicted.reasons, *self.told))
        if self.measured is None:
            return Decision(predicted, bars=self.bars)
        return Decision(predicted, decide_audited(self.measured, limit, self.held), bars=self.bars)

    def to_json(self) -> dict[str, object]:
        return {
            "forecast": vars(self.forecast),
            "findings": [_finding_json(one) for one in self.findings],
            "held": [_finding_json(one) for one in self.held],
            "told": [one.to_json() for one in self.told],
            "measured": self.measured and self.measured.to_json(),
            "bars": [one.to_json() for one in self.bars],
            "rules": list(self.rules),
        }

    @classmethod
    def of(cls, kept: Mapping[str, Any]) -> "Grounds":
        """Read what `to_json` wrote."""
        measured = kept["measured"]
        return cls(
            forecast=ErrorForecast(**kept["forecast"]),
            findings=tuple(map(_finding_of, kept["findings"])),
            held=tuple(map(_finding_of, kept["held"])),
            told=tuple(map(Reason.of, kept["told"])),
            measured=measured and Scores.from_json(measured),
            bars=tuple(map(Reason.of, kept["bars"])),
            rules=tuple(map(str, kept["rules"])),
        )


def _finding_json(finding: Finding) -> dict[str, object]:
    return {"reason": finding.reason.to_json(), "best": str(finding.best)}


def _finding_of(kept: Mapping[str, Any]) -> Finding:
    return Finding(Reason.of(kept["reason"]), Verdict(kept["best"]))


AUDITED_BEFORE_TRIM = "audited_before_trim"
"""Code of the reason that a unit was audited with another map than it has now."""

TRIMMED, TRIM_OLDER, TRIM_LEFT_OUT = "trimmed", "trim.older", "trim.left_out"
"""Codes of the reasons that a unit was trimmed and not measured since; that its trim is older than its recording; and
that its new map cannot take it."""

TRIM_BARS = (TRIMMED, TRIM_OLDER, TRIM_LEFT_OUT, AUDITED_BEFORE_TRIM)
"""Codes that stand until a new trim replaces them or a new audit decides."""

UNREADABLE = "audit.unreadable"
"""Code of the reason that a file that was brought as an audit cannot be read."""

LIMIT_EVIDENCE = ("limit_rmse", "limit_origin", "reference_expanded", "limit_range")
"""Names under which a calibration keeps, among its numbers, the limit it was judged against."""


def limit_evidence(limit: Limit) -> dict[str, float | str | None]:
    """Return a limit as a calibration keeps it among its numbers."""
    values = (limit.maximum_rmse, str(limit.origin), limit.reference_expanded, limit.full_range)
    return dict(zip(LIMIT_EVIDENCE, values, strict=True))
