"""What audited units misread alike is found where it is there, seldom where it is not, and taken off a map as said."""

import numpy as np
import pytest

from softcal.core.unit.calibrate import UnitProblem, calibrate
from softcal.core.unit.calibration import Calibration
from softcal.core.unit.common_misreading import CommonMisreading, LoadLine, common_misreading, corrected, without
from softcal.core.unit.estimate import estimate
from softcal.core.unit.method import ReleaseConfig

UNITS = 10


def lines(rng, gain=1.0, zero_N=0.0, spread=0.04, units=UNITS):
    drawn = zip(rng.normal(0, spread, units), rng.normal(0, 0.02, units), strict=True)
    return {f"U{k}": LoadLine(gain * float(np.exp(one)), zero_N + float(z)) for k, (one, z) in enumerate(drawn)}


def test_lots_that_misread_nothing_alike_are_corrected_by_chance_alone(rng):
    found = sum(common_misreading(lines(rng)) is not None for _ in range(2000))
    # Four sides of 0.25 %: 20 of 2000 are expected, and 40 are four standard deviations beyond.
    assert found <= 40


@pytest.mark.parametrize(("gain", "zero_N"), [(1.08, 0.0), (0.9, 0.0), (1.0, 0.06)])
def test_a_gain_or_a_zero_that_all_share_is_found(rng, gain, zero_N):
    found = [common_misreading(lines(rng, gain, zero_N)) for _ in range(100)]
    assert sum(one is not None for one in found) >= 90
    assert np.median([one.line.gain for one in found if one]) == pytest.approx(gain, rel=0.02)
    assert np.median([one.line.zero for one in found if one]) == pytest.approx(zero_N, abs=0.01)


def test_too_few_audits_and_units_that_read_backwards_correct_nothing(rng):
    assert common_misreading({}) is None
    assert common_misreading(lines(rng, 1.5, units=ReleaseConfig().least_audits - 1)) is None
    assert common_misreading({**lines(rng, 1.5), "U0": LoadLine(-1.2, 0.0)}) is None


def test_an_audited_unit_is_corrected_by_the_others_alone(rng):
    known = lines(rng, 1.1)
    found = common_misreading(known)
    mine = without(known, "U3", found)
    others = {serial: line for serial, line in known.items() if serial != "U3"}
    assert mine.audits == UNITS - 1
    assert mine.line.gain == pytest.approx(np.exp(np.mean([np.log(line.gain) for line in others.values()])))
    assert without({**known, "U3": LoadLine(5.0, 1.0)}, "U3", found).line == mine.line
    assert without(known, "not audited", found) == found


def test_the_map_reads_what_is_left_once_gain_and_zero_are_taken_off(source_model, press):
    model, recordings = source_model, {"A1": press(7, 1.2, 0.03, 80.0, "A1").unlabelled}
    calibration = calibrate(UnitProblem(model, recordings["A1"]))
    record = calibration.to_record("i" * 64, recordings["A1"].sha256)
    common = CommonMisreading(LoadLine(1.1, 0.05), UNITS)
    after = corrected(record, model.source, common)
    assert after.map_sha256 != record.map_sha256 and after.common_line == (1.1, 0.05)
    assert after.recording_sha256 == record.recording_sha256 and after.predicted_rmse == record.predicted_rmse
    read = [
        estimate(model.network, one, recordings["A1"]).estimate for one in (calibration, Calibration.from_record(after))
    ]
    wanted = (read[0] - 0.05) / 1.1
    span = float(np.ptp(model.source.reference))
    rows = np.isfinite(wanted)
    # A straight line behind the map goes through both ends; between them f bends it a little.
    assert np.sqrt(np.mean((read[1][rows] - wanted[rows]) ** 2)) < 0.02 * span
    assert np.allclose(after.arrays["interval.half_width"], record.arrays["interval.half_width"])
