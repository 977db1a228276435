"""What the audited units of a lot misread alike, a gain and a zero: taken off the maps of its units.

A readout of another day, or a press that has moved, changes every unit of a lot by one factor and one zero, or by what
its own output goes with. No unlabelled recording shows it; audits do. What one audited unit is corrected by comes from
the others alone, so that its measured error says what the correction is worth to a unit that nobody measured.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from softcal.core.maps.anchors import SourceLevels
from softcal.core.recording import Array, LabelledRecording
from softcal.core.unit.adjustments import Correction
from softcal.core.unit.output_level import LoadLine, OutputLevel
from softcal.core.unit.state import UnitState


@dataclass(frozen=True)
class AuditedLine:
    """How an audited unit reads its loads by its map as it was fitted, and where its output stands."""

    line: LoadLine
    level: OutputLevel | None = None


@dataclass(frozen=True)
class Trend:
    """A number of a unit over what its own output shows: mean + slope (x - centre), x within what was observed.

    Args:
        mean, slope: shrunk towards 0 by what chance explains of them.
        centre, low, high: mean and ends of x over the audited units.
        mean_error, slope_error: standard uncertainties of both.
    """

    mean: float
    slope: float
    centre: float
    low: float
    high: float
    mean_error: float
    slope_error: float

    def at(self, x: float | None) -> tuple[float, float]:
        """Return the number for one unit and its standard uncertainty; the mean where x is not known."""
        if x is None or not self.slope:
            return self.mean, self.mean_error
        deviation = min(max(x, self.low), self.high) - self.centre
        return self.mean + self.slope * deviation, float(np.hypot(self.mean_error, self.slope_error * deviation))


@dataclass(frozen=True)
class LotCorrection:
    """A numbered decision of a lot: what its audited units misread alike.

    Another load on the press shows in the span of a unit's output, and another gain of the readout moves a unit by its
    level at rest: units of a lot differ in both. So the gain may go with the one, the zero with the other.

    Args:
        number: 1, 2, 3 ... per lot.
        lines: the audited units it rests on, by serial.
    """

    number: int
    lines: Mapping[str, AuditedLine] = field(default_factory=dict)

    def line_of(self, serial: str, level: OutputLevel | None, min_audits: int) -> Correction | None:
        """Return what is taken off a unit whose output stands at a level: what the other audited units say.

        None where they are fewer than `min_audits`, or where chance explains all of it. `apply` puts it behind a map.
        """
        lines = [line for name, line in self.lines.items() if name != serial]
        if len(lines) < min_audits:
            return None
        gains, zeros = _trends(lines)
        log_gain, gain_error = gains.at(None if level is None else _span(level))
        zero, zero_error = zeros.at(None if level is None else level.rest)
        if not log_gain and not zero:
            return None
        return Correction(
            number=self.number,
            line=LoadLine(float(np.exp(log_gain)), zero),
            gain_error=gain_error,
            zero_error=zero_error,
            audits=len(lines),
        )

    def apply(self, state: UnitState, source: LabelledRecording) -> UnitState:
        """Return the state of a unit with this correction.

        A straight line behind the map, through the source's levels at both ends of its range: a device trims so, too.
        """
        fit = state.fit
        common = self.line_of(state.serial, fit.output_level, fit.method.release.min_correction_audits)
        if common is None or fit.correspondence.is_anchored or fit.rules:
            return replace(state, correction=None)
        levels = SourceLevels.from_source(source, fit.method.map.anchors)
        read = np.array([state.fitted.interval.low, state.fitted.interval.high])
        was, now = levels.at(read), levels.at((read - common.line.zero) / common.line.gain)
        gain = float((now[1] - now[0]) / (was[1] - was[0]))
        return replace(state, correction=replace(common, gain=gain, offset=float(now[0] - gain * was[0])))


def _trends(lines: Sequence[AuditedLine]) -> tuple[Trend, Trend]:
    """Return how log gain and zero of units go with the span and the rest of their outputs."""
    levels = [one.level for one in lines]
    spans = [None if level is None else _span(level) for level in levels]
    rests = [None if level is None else level.rest for level in levels]
    gains = np.array([max(one.line.gain, 1e-6) for one in lines])
    return _trend(np.log(gains), spans), _trend(np.array([one.line.zero for one in lines]), rests)


def _span(level: OutputLevel) -> float | None:
    return float(np.log(level.span)) if level.span > 0 else None


def _trend(values: Array, at: Sequence[float | None]) -> Trend:
    """Fit a number over another by least squares, mean and slope each shrunk by what chance explains of it."""
    count, mean = len(values), float(values.mean())
    x = np.array([one for one in at if one is not None])
    deviation = x - x.mean() if len(x) == count else np.zeros(count)
    slope, slope_error, centre, low, high = 0.0, 0.0, 0.0, 0.0, 0.0
    residuals, degrees = values - mean, count - 1
    if degrees > 2 and np.any(deviation):
        raw = float(deviation @ values / (deviation @ deviation))
        raw_error = float(np.sqrt(np.sum((residuals - raw * deviation) ** 2) / (count - 2) / (deviation @ deviation)))
        slope, slope_error = _shrunk(raw, raw_error), raw_error
        if slope:
            residuals, degrees = residuals - slope * deviation, count - 2
            centre, low, high = float(x.mean()), float(x.min()), float(x.max())
    mean_error = float(np.sqrt(residuals @ residuals / degrees / count))
    return Trend(_shrunk(mean, mean_error), slope, centre, low, high, mean_error, slope_error)


def _shrunk(value: float, error: float) -> float:
    """Return an estimate times the share of its square that chance does not explain, 0 where it explains all.

    value^2 - error^2 estimates the square of the true value (positive part, after James and Stein 1961): no threshold
    decides whether a lot is corrected, and no single audit more or less makes a step.
    """
    return value * max(1.0 - (error / value) ** 2, 0.0) if value else 0.0
