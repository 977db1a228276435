"""What audited units misread alike is found where it is there, seldom where it is not, and taken off a map as said."""

import numpy as np
import pytest

from softcal.core.unit.audit_reading import OutputLevel
from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.calibration import Calibration
from softcal.core.unit.common_misreading import CommonMisreading, LoadLine, common_misreading, corrected, without
from softcal.core.unit.estimate import estimate
from softcal.core.unit.method import ReleaseConfig
from softcal.core.unit.unit_problem import UnitProblem

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


def seen_by_output(rng, load_spread=0.0, readout_gain=1.0, units=UNITS):
    """Units of 0.1 V/N that differ by 5 % in sensitivity and 20 mV at rest, pressed and read as said."""
    found = {}
    for k in range(units):
        rest_V, sensitive, load = 0.5 + 0.02 * rng.normal(), 1 + 0.05 * rng.normal(), 1 + load_spread * rng.normal()
        level = OutputLevel(rest_V, 0.5 * sensitive * load)
        zero_N = (1 - readout_gain) * (rest_V - 0.5) / 0.1 + 0.01 * rng.normal()
        found[f"U{k}"] = LoadLine(float(np.exp(0.004 * rng.normal())) / load / readout_gain, zero_N, level)
    return found


def left_over(known, units):
    """Gains and zeros of units that nobody audited, with what the audited ones misread taken off."""
    found = common_misreading(known)
    taken = [LoadLine(1.0, 0.0) if found is None else found.of(unit.level).line for unit in units]
    return np.array([(unit.gain / line.gain, unit.zero - line.zero) for unit, line in zip(units, taken, strict=True)])


def test_a_readout_of_another_day_is_taken_off_each_unit_by_its_level_at_rest(rng):
    lots = [seen_by_output(rng, readout_gain=1.08, units=30) for _ in range(50)]
    left = [left_over(dict(list(lot.items())[:UNITS]), list(lot.values())[UNITS:]) for lot in lots]
    before = np.std([unit.zero for lot in lots for unit in lot.values()])
    assert np.sqrt(np.mean([np.mean(one[:, 1] ** 2) for one in left])) < before
    assert np.median([np.sqrt(np.mean(one[:, 1] ** 2)) for one in left]) < 0.015


def test_a_load_that_differs_from_unit_to_unit_is_taken_off_as_far_as_the_span_shows_it(rng):
    lots = [seen_by_output(rng, load_spread=0.12, units=30) for _ in range(50)]
    left = [left_over(dict(list(lot.items())[:UNITS]), list(lot.values())[UNITS:]) for lot in lots]
    # The span shows the load but for the 5 % that the units differ by themselves.
    assert np.median([np.std(np.log(one[:, 0])) for one in left]) < 0.07


def test_what_no_output_shows_is_seldom_taken_off_by_it(rng):
    found = [common_misreading(seen_by_output(rng)) for _ in range(1000)]
    # Eight sides of 0.25 %: 20 of 1000 are expected, and 40 are four standard deviations beyond.
    assert sum(one is not None for one in found) <= 40


def test_an_audited_unit_is_corrected_over_the_levels_of_the_others_alone(rng):
    known = seen_by_output(rng, load_spread=0.12, readout_gain=1.08)
    found = common_misreading(known)
    others = {serial: line for serial, line in known.items() if serial != "U3"}
    far = {**known, "U3": LoadLine(3.0, 2.0, OutputLevel(0.9, 3.0))}
    mine = without(far, "U3", found)
    assert mine == without(known, "U3", found)
    # Beyond what the others showed nothing is extrapolated.
    widest = max(others.values(), key=lambda line: line.level.span).level
    highest = max(others.values(), key=lambda line: line.level.rest).level
    assert mine.of(OutputLevel(0.9, 3.0)).line == mine.of(OutputLevel(highest.rest, widest.span)).line


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
