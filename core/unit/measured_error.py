"""What an audit measured: errors with the rows they were made from, and the map that they are errors of."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from softcal.core.metrics import rmse
from softcal.core.recording import Array
from softcal.core.unit.budget import COVERAGE
from softcal.core.unit.output_level import LoadLine
from softcal.core.unit.uncertainty import ErrorForecast
from softcal.core.windows import TAPS


@dataclass(frozen=True)
class MeasuredError:
    """RMSE of estimates against a reference, in the reference unit, and the number of rows with an estimate."""

    rmse: float
    rows: int

    @classmethod
    def from_estimates(cls, estimate: Array, reference: Array) -> "MeasuredError":
        """Compare (n,) estimates, NaN where there is none, with the reference beside them."""
        return cls(rmse(estimate, reference), int(np.count_nonzero(np.isfinite(estimate))))

    @property
    def independent_rows(self) -> float:
        """Rows whose windows do not overlap: errors of neighbouring rows are alike."""
        return max(self.rows / TAPS, 1.0)

    @property
    def interval(self) -> ErrorForecast:
        """The error with its 95 % interval: the standard deviation of an RMSE of n errors is RMSE / sqrt(2 n)."""
        guard = COVERAGE * self.rmse / float(np.sqrt(2 * self.independent_rows))
        return ErrorForecast(self.rmse, self.rmse - guard, self.rmse + guard)


@dataclass(frozen=True)
class OwnCalibrationScores:
    """The unit's own network beside f and the map on the rows that it was tested on (Kim et al. 2020, Table 1)."""

    before: MeasuredError
    after: MeasuredError
    own: MeasuredError

    @property
    def after_ratio(self) -> float:
        """Error with the map over that of the own calibration, on the same rows."""
        return self.after.rmse / self.own.rmse

    @property
    def before_ratio(self) -> float:
        """Error of f on raw windows over that of the own calibration, on the same rows."""
        return self.before.rmse / self.own.rmse


@dataclass(frozen=True)
class Scores:
    """What one audit shows of a unit.

    Args:
        before, after: of f on raw and on mapped windows, over all rows of the audit that have an estimate.
        own: of the unit's own network, where one was trained.
        unscored: rows without an estimate by the flag that `estimate` gives them.
    """

    before: MeasuredError
    after: MeasuredError
    own: OwnCalibrationScores | None = None
    unscored: Mapping[str, int] = field(default_factory=dict)


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
