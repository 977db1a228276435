"""What every machine-readable result says of one unit."""

from dataclasses import dataclass
from typing import Any

from softcal.core.messages.reason import Reason
from softcal.core.unit.state import UnitState
from softcal.core.unit.verdict import Verdict
from softcal.db.entries import UNIT_ERRORS, CalibrationSummary


@dataclass(frozen=True)
class UnitResult:
    """One row of the report, reasons most important first. A unit that could not be read or mapped
    has no `summary`. `is_new`: this batch fitted it, else the registry had it.
    """

    serial: str
    verdict: str
    reasons: tuple[Reason, ...]
    summary: CalibrationSummary | None = None
    is_new: bool = True

    @property
    def state(self) -> UnitState | None:
        return None if self.summary is None else self.summary.state

    @property
    def is_audited(self) -> bool:
        return self.state is not None and self.state.decision.is_audited

    @property
    def errors(self) -> dict[str, float | None]:
        """Its errors in the lot's reference unit, by `UNIT_ERRORS`; None where there is none."""
        return dict.fromkeys(UNIT_ERRORS) if self.state is None else self.state.errors

    def to_json(self) -> dict[str, Any]:
        """Return what every machine-readable result says of the unit."""
        state = self.state
        return {
            "serial": self.serial,
            "verdict": self.verdict,
            "reasons": [str(why) for why in self.reasons],
            "reason_codes": [why.code for why in self.reasons],
            "released": self.verdict == Verdict.PASS,
            "audited": self.is_audited,
            "knowledge": state and str(state.knowledge),
            "fit_s": state and state.fit.fit_s,
            **self.errors,
        }
