"""What the audited units of a lot misread alike, a gain and a zero: taken off the maps of its units.

A readout of another day, or a press that has moved, changes every unit of a lot by one factor and one zero. No
unlabelled recording shows it; audits do. What one audited unit is corrected by comes from the others alone, so that its
measured error says what the correction is worth to a unit that nobody measured.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit

from softcal.core.identity import content_sha256
from softcal.core.maps.anchors import AnchoredMap, SourceLevels
from softcal.core.maps.interface import map_sha256
from softcal.core.recording import LabelledRecording
from softcal.core.unit.calibration import COMMON_GAIN, COMMON_ZERO, Calibration, CalibrationRecord
from softcal.core.unit.method import Method, ReleaseConfig
from softcal.core.words.reason import reason


@dataclass(frozen=True)
class LoadLine:
    """How a unit reads its loads: estimate = zero + gain x reference (least squares).

    Args:
        gain: 1 where it reads them in full.
        zero: in the reference unit.
    """

    gain: float
    zero: float


@dataclass(frozen=True)
class CommonMisreading:
    """What is taken off the estimates of a lot's units: (estimate - zero) / gain.

    Args:
        line: what the audited units misread alike.
        audits: how many they are.
    """

    line: LoadLine
    audits: int


def common_misreading(
    lines: Mapping[str, LoadLine],
    rules: ReleaseConfig = ReleaseConfig(),  # noqa: B008 - frozen
) -> CommonMisreading | None:
    """Return what audited units misread alike; None where chance explains it, or they are too few to tell.

    Student's t of the log gains, and of the zeros, about their means.

    Args:
        lines: of audited units drawn at random, by serial, as their maps were fitted.
        rules: how many, and how sure.
    """
    if len(lines) < rules.least_audits or min((line.gain for line in lines.values()), default=0.0) <= 0:
        return None
    gains, zeros = (np.array([getattr(line, name) for line in lines.values()]) for name in ("gain", "zero"))
    logs = np.log(gains)
    count = len(lines)
    far = float(stdtrit(count - 1, 1 - rules.common_chance)) / np.sqrt(count)
    if all(abs(values.mean()) <= far * values.std(ddof=1) for values in (logs, zeros)):
        return None
    return CommonMisreading(LoadLine(float(np.exp(logs.mean())), float(zeros.mean())), count)


def without(lines: Mapping[str, LoadLine], serial: str, found: CommonMisreading) -> CommonMisreading:
    """Return what the other audited units misread alike, where all together do."""
    if serial not in lines:
        return found
    others = [line for name, line in lines.items() if name != serial]
    gain = float(np.exp(np.mean([np.log(line.gain) for line in others])))
    return CommonMisreading(LoadLine(gain, float(np.mean([line.zero for line in others]))), len(others))


def corrected(record: CalibrationRecord, source: LabelledRecording, found: CommonMisreading) -> CalibrationRecord:
    """Return a calibration whose map takes off what the lot's audited units misread alike.

    A straight line behind the map, through the source's levels at both ends of its range: a device trims so, too.

    Args:
        record: as it was fitted.
        source: labelled recording of the source that f was trained on.
    """
    calibration = Calibration.from_record(record)
    levels = SourceLevels.of(source, (calibration.method or Method()).map.anchors)
    read = np.array([calibration.interval.low, calibration.interval.high])
    was, now = levels.at(read), levels.at((read - found.line.zero) / found.line.gain)
    gain = float((now[1] - now[0]) / (was[1] - was[0]))
    unit_map = AnchoredMap(calibration.unit_map, gain, float(now[0] - gain * was[0]))
    arrays = {name: array for name, array in record.arrays.items() if not name.startswith("map.")}
    arrays |= {f"map.{name}": array for name, array in unit_map.arrays().items()}
    line = found.line
    said = reason("common", gain=line.gain, zero=line.zero, audits=found.audits, unit=source.reference_unit)
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
        input_sha256=content_sha256({}, {"base": record.input_sha256, "common": [line.gain, line.zero, found.audits]}),
    )
