"""What the audited units of a lot misread alike, a gain and a zero: taken off the maps of its units.

A readout of another day, or a press that has moved, changes every unit of a lot by one factor and one zero, or by what
its own output goes with. No unlabelled recording shows it; audits do. What one audited unit is corrected by comes from
the others alone, so that its measured error says what the correction is worth to a unit that nobody measured.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit

from softcal.core.identity import content_sha256
from softcal.core.maps.anchors import AnchoredMap, SourceLevels
from softcal.core.maps.interface import map_sha256
from softcal.core.recording import Array, LabelledRecording
from softcal.core.unit.audit_reading import OutputLevel
from softcal.core.unit.calibration import COMMON_GAIN, COMMON_ZERO, Calibration, CalibrationRecord
from softcal.core.unit.method import Method, ReleaseConfig
from softcal.core.words.reason import reason


@dataclass(frozen=True)
class LoadLine:
    """How a unit reads its loads: estimate = zero + gain x reference (least squares); gain 1 reads them in full."""

    gain: float
    zero: float
    level: OutputLevel | None = None


@dataclass(frozen=True)
class Trend:
    """A number of a unit over a number that its own output shows: mean + slope (x - centre), x within what was seen.

    Args:
        mean: of the audited units.
        slope: 0 where chance explains it.
        centre, low, high: mean and ends of x over the audited units.
        degrees: degrees of freedom behind the spread.
    """

    mean: float
    slope: float
    centre: float
    low: float
    high: float
    spread: float
    degrees: int

    def at(self, x: float | None) -> float:
        """Return the number for one unit; the mean where x is not known."""
        if x is None or not self.slope:
            return self.mean
        return self.mean + self.slope * (min(max(x, self.low), self.high) - self.centre)

    def is_seen(self, count: int, chance: float) -> bool:
        """Return whether the mean of so many units is further from 0 than chance explains (Student's t)."""
        return bool(abs(self.mean) > stdtrit(self.degrees, 1 - chance) * self.spread / np.sqrt(count))


@dataclass(frozen=True)
class CommonMisreading:
    """What is taken off the estimates of a lot's units: (estimate - zero) / gain.

    Another load on the press shows in the span of a unit's output, and another gain of the readout moves a unit by
    its level at rest: units of a lot differ in both. So the gain may go with the one, the zero with the other.

    Args:
        line: what the audited units misread alike, on average.
        gain: natural logarithm of the gain over that of the span.
        zero: in the reference unit, over the output at rest.
    """

    line: LoadLine
    audits: int
    gain: Trend | None = None
    zero: Trend | None = None

    def of(self, level: OutputLevel | None) -> "CommonMisreading":
        """Return what is taken off one unit."""
        if level is None or self.gain is None or self.zero is None:
            return self
        gain, zero = self.gain.at(_span(level)), self.zero.at(level.rest)
        return replace(self, line=LoadLine(float(np.exp(gain)), zero))

    def to_json(self) -> dict[str, float]:
        gain_slope, zero_slope = (0.0 if trend is None else trend.slope for trend in (self.gain, self.zero))
        return {"gain": self.line.gain, "zero": self.line.zero, "gain_slope": gain_slope, "zero_slope": zero_slope}


def common_misreading(lines: Mapping[str, LoadLine]) -> CommonMisreading | None:
    """Return what audited units, drawn at random, misread alike as they were fitted; None where chance explains it.

    Student's t of the slopes of log gains and zeros (simple linear regression), and of their means about what the
    slopes leave. None also where they are too few to tell.
    """
    if len(lines) < ReleaseConfig.least_audits or min((line.gain for line in lines.values()), default=0.0) <= 0:
        return None
    gain, zero = _trends(lines)
    is_seen = any(one.slope or one.is_seen(len(lines), ReleaseConfig.common_chance) for one in (gain, zero))
    return _common(gain, zero, len(lines)) if is_seen else None


def without(lines: Mapping[str, LoadLine], serial: str, common: CommonMisreading) -> CommonMisreading:
    """Return what the other audited units misread alike, where all together do."""
    if serial not in lines:
        return common
    others = {name: line for name, line in lines.items() if name != serial}
    slopes = [bool(trend and trend.slope) for trend in (common.gain, common.zero)]
    return _common(*_trends(others, slopes), len(others))


def _common(gain: Trend, zero: Trend, count: int) -> CommonMisreading:
    return CommonMisreading(LoadLine(float(np.exp(gain.mean)), zero.mean), count, gain, zero)


def _span(level: OutputLevel) -> float | None:
    return float(np.log(level.span)) if level.span > 0 else None


def _trends(lines: Mapping[str, LoadLine], slopes: Sequence[bool | None] = (None, None)) -> tuple[Trend, Trend]:
    """Return how log gain and zero of units go with span and rest; with slopes or without, where that is known."""
    gains, zeros = (np.array(values) for values in zip(*((one.gain, one.zero) for one in lines.values()), strict=True))
    levels = [line.level for line in lines.values()]
    spans = [None if level is None else _span(level) for level in levels]
    rests = [None if level is None else level.rest for level in levels]
    return _trend(np.log(gains), spans, slopes[0]), _trend(zeros, rests, slopes[1])


def _trend(values: Array, at: Sequence[float | None], has_slope: bool | None) -> Trend:
    """Fit a number over another by least squares, with a slope where one is asked for, or where Student's t sees it."""
    count, mean = len(values), float(values.mean())
    flat = Trend(mean, 0.0, 0.0, 0.0, 0.0, float(values.std(ddof=1)), count - 1)
    x = np.array([one for one in at if one is not None])
    away = x - x.mean() if len(x) == count else np.zeros(count)
    if has_slope is False or not np.any(away) or count <= 2:
        return flat
    slope = float(away @ values / (away @ away))
    degrees = count - 2
    spread = float(np.sqrt(np.sum((values - mean - slope * away) ** 2) / degrees))
    seen = abs(slope) * np.sqrt(away @ away) > float(stdtrit(degrees, 1 - ReleaseConfig.common_chance)) * spread
    if has_slope is None and not seen:
        return flat
    return Trend(mean, slope, float(x.mean()), float(x.min()), float(x.max()), spread, degrees)


def corrected(record: CalibrationRecord, source: LabelledRecording, common: CommonMisreading) -> CalibrationRecord:
    """Return a calibration whose map takes off what the lot's audited units misread alike.

    A straight line behind the map, through the source's levels at both ends of its range: a device trims so, too.
    """
    calibration = Calibration.from_record(record)
    levels = SourceLevels.of(source, (calibration.method or Method()).map.anchors)
    read = np.array([calibration.interval.low, calibration.interval.high])
    was, now = levels.at(read), levels.at((read - common.line.zero) / common.line.gain)
    gain = float((now[1] - now[0]) / (was[1] - was[0]))
    unit_map = AnchoredMap(calibration.unit_map, gain, float(now[0] - gain * was[0]))
    arrays = {name: array for name, array in record.arrays.items() if not name.startswith("map.")}
    arrays |= {f"map.{name}": array for name, array in unit_map.arrays().items()}
    line = common.line
    said = reason("common", gain=line.gain, zero=line.zero, audits=common.audits, unit=source.reference_unit)
    grounds = record.grounds
    settings = dict(record.settings)
    if grounds is not None:
        settings["grounds"] = replace(grounds, told=(*grounds.told, said)).to_json()
    return replace(
        record,
        map_sha256=map_sha256(unit_map),
        arrays=arrays,
        settings=settings,
        evidence={**record.evidence, COMMON_GAIN: line.gain, COMMON_ZERO: line.zero},
        input_sha256=content_sha256({}, {"base": record.input_sha256, "common": [line.gain, line.zero, common.audits]}),
    )
