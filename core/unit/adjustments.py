"""What is done to a fitted unit: known loads, a correction of its lot, what a statement on its lot says of it."""

from dataclasses import dataclass

import numpy as np

from softcal.core.maps.interface import Anchors
from softcal.core.messages.reason import Reason, Value, reason
from softcal.core.recording import Array
from softcal.core.unit.output_level import LoadLine
from softcal.core.unit.uncertainty import Interval, IntervalInflation
from softcal.core.unit.verdict import Assessment, Limit, Verdict


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
        interval_inflation: what becomes of the unit's 90 % intervals.
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
    interval_inflation: IntervalInflation
    day_rmse: float
    audits: Reason
    risk: float
    confidence: float
    sitting: str = ""
    withdrawn: Reason | None = None

    def assess(self, rmse: float, limit: Limit) -> Assessment:
        """Return what the statement says of a unit with this forecast RMSE."""
        if self.withdrawn is not None:
            verdict = Verdict.FAIL if rmse > limit.maximum_rmse else Verdict.CONDITIONAL
            return Assessment(verdict, (reason("not_qualified", why=self.withdrawn),))
        inputs: dict[str, Value] = {
            "rmse": rmse,
            "limit": limit.maximum_rmse,
            "unit": limit.unit,
            "audits": self.audits,
        }
        factor = float("inf") if self.factor is None else self.factor
        if self.is_released:
            risks: dict[str, Value] = {"risk": self.risk, "confidence": self.confidence}
            return Assessment(Verdict.PASS, (reason("sampled.released", factor=factor, **inputs, **risks),))
        if rmse * self.scale > limit.maximum_rmse:
            return Assessment(Verdict.FAIL, (reason("sampled.beyond", centre=self.scale, **inputs),))
        if rmse * factor > limit.acceptance_rmse:
            return Assessment(Verdict.CONDITIONAL, (reason("sampled.open", factor=factor, **inputs),))
        if float(np.hypot(rmse * factor, self.day_rmse)) > limit.acceptance_rmse:
            day_reason = reason("sampled.day", factor=factor, day=self.day_rmse, **inputs)
            return Assessment(Verdict.CONDITIONAL, (day_reason,))
        return Assessment(Verdict.CONDITIONAL, (reason("sampled.part", centre=self.scale, audits=self.audits),))
