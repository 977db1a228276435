"""What audited units of a lot misread alike: taken off where it is there, little where it is not, by others alone."""

from dataclasses import replace

import numpy as np
import pytest

from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.estimate import estimate
from softcal.core.unit.lot_correction import AuditedLine, LotCorrection
from softcal.core.unit.output_level import LoadLine, OutputLevel
from softcal.core.unit.unit_problem import UnitProblem

UNITS = 10


@pytest.fixture(scope="module")
def unit(press):
    return press(7, 1.2, 0.03, 80.0, "A1").unlabelled


@pytest.fixture(scope="module")
def state(source_model, unit):
    return calibrate(UnitProblem(source_model, unit))


def lines(rng, gain=1.0, zero_N=0.0, spread=0.04, units=UNITS):
    line_errors = zip(rng.normal(0, spread, units), rng.normal(0, 0.02, units), strict=True)
    return {
        f"U{k}": AuditedLine(LoadLine(gain * float(np.exp(one)), zero_N + float(z)))
        for k, (one, z) in enumerate(line_errors)
    }


def taken_off(state, source, lines, level=None):
    """The line that is taken off a unit whose output stands at a level."""
    state_at_level = replace(state, fit=replace(state.fit, output_level=level))
    correction = LotCorrection(1, lines).apply(state_at_level, source).correction
    return LoadLine(1.0, 0.0) if correction is None else correction.line


@pytest.mark.parametrize(("gain", "zero_N"), [(1.08, 0.0), (0.9, 0.0), (1.0, 0.06)])
def test_a_gain_or_a_zero_that_all_share_is_taken_off(rng, source_model, state, gain, zero_N):
    corrections = [taken_off(state, source_model.source, lines(rng, gain, zero_N)) for _ in range(60)]
    assert np.median([one.gain for one in corrections]) == pytest.approx(gain, rel=0.02)
    assert np.median([one.zero for one in corrections]) == pytest.approx(zero_N, abs=0.01)


def test_a_lot_that_misreads_nothing_alike_is_changed_by_less_than_the_mean_of_its_audits(rng, source_model, state):
    line_errors = [lines(rng) for _ in range(300)]
    log_gains = [np.log(taken_off(state, source_model.source, one).gain) for one in line_errors]
    means = [np.mean([np.log(each.line.gain) for each in one.values()]) for one in line_errors]
    assert np.sqrt(np.mean(np.square(log_gains))) < 0.8 * np.sqrt(np.mean(np.square(means)))
    # Chance alone leaves most of them as they are: |mean| is within one standard error in two of three.
    assert np.mean([one == 0 for one in log_gains]) > 0.5


def test_no_audit_more_or_less_makes_a_step(rng, source_model, state):
    """A gain that grows evenly from none is taken off more and more, without a jump."""
    scatter, gains = rng.normal(0, 0.04, UNITS), np.linspace(0.0, 0.2, 401)
    log_gains = np.array(
        [
            np.log(
                taken_off(
                    state,
                    source_model.source,
                    {f"U{k}": AuditedLine(LoadLine(float(np.exp(g + s)), 0.0)) for k, s in enumerate(scatter)},
                ).gain
            )
            for g in gains
        ]
    )
    assert np.all(np.diff(log_gains) >= 0) and np.diff(log_gains).max() < 3 * (gains[1] - gains[0])


def read_by_output(rng, load_spread=0.0, readout_gain=1.0, units=UNITS):
    """Units of 0.1 V/N that differ by 5 % in sensitivity and 20 mV at rest, pressed and read as said."""
    readings = {}
    for k in range(units):
        rest_V, sensitive, load = 0.5 + 0.02 * rng.normal(), 1 + 0.05 * rng.normal(), 1 + load_spread * rng.normal()
        level = OutputLevel(rest_V, 0.5 * sensitive * load)
        zero_N = (1 - readout_gain) * (rest_V - 0.5) / 0.1 + 0.01 * rng.normal()
        line = LoadLine(float(np.exp(0.004 * rng.normal())) / load / readout_gain, zero_N)
        readings[f"U{k}"] = AuditedLine(line, level)
    return readings


def left_over(state, source, lot):
    """Gains and zeros of units that nobody audited, with what the first ten misread taken off."""
    audited, others = dict(list(lot.items())[:UNITS]), list(lot.values())[UNITS:]
    corrections = [taken_off(state, source, audited, one.level) for one in others]
    return np.array(
        [(one.line.gain / line.gain, one.line.zero - line.zero) for one, line in zip(others, corrections, strict=True)]
    )


def test_a_readout_of_another_day_is_taken_off_each_unit_by_its_level_at_rest(rng, source_model, state):
    lots = [read_by_output(rng, readout_gain=1.08, units=20) for _ in range(25)]
    remaining = [left_over(state, source_model.source, lot) for lot in lots]
    before = np.std([one.line.zero for lot in lots for one in lot.values()])
    assert np.sqrt(np.mean([np.mean(one[:, 1] ** 2) for one in remaining])) < before
    assert np.median([np.sqrt(np.mean(one[:, 1] ** 2)) for one in remaining]) < 0.016


def test_a_load_that_differs_from_unit_to_unit_is_taken_off_as_far_as_the_span_shows_it(rng, source_model, state):
    lots = [read_by_output(rng, load_spread=0.12, units=20) for _ in range(25)]
    remaining = [left_over(state, source_model.source, lot) for lot in lots]
    # The span shows the load but for the 5 % that the units differ by themselves.
    assert np.median([np.std(np.log(one[:, 0])) for one in remaining]) < 0.075


def test_an_audited_unit_is_corrected_by_the_others_alone(rng, source_model, state):
    audited_lines = {**lines(rng, 1.1), "A1": AuditedLine(LoadLine(5.0, 1.0))}
    mine = LotCorrection(3, audited_lines).apply(state, source_model.source).correction
    others = LotCorrection(3, {name: line for name, line in audited_lines.items() if name != "A1"})
    assert mine == others.apply(state, source_model.source).correction
    assert (mine.number, mine.audits) == (3, UNITS)


def test_beyond_the_levels_of_the_audited_units_nothing_is_extrapolated(rng, source_model, state):
    audited_lines = read_by_output(rng, load_spread=0.12, readout_gain=1.08)
    widest = max(audited_lines.values(), key=lambda one: one.level.span).level.span
    highest = max(audited_lines.values(), key=lambda one: one.level.rest).level.rest
    far = taken_off(state, source_model.source, audited_lines, OutputLevel(highest + 1, widest + 3))
    assert far == taken_off(state, source_model.source, audited_lines, OutputLevel(highest, widest))


def test_fewer_than_three_other_audits_and_units_with_known_loads_are_left_alone(rng, source_model, state):
    assert taken_off(state, source_model.source, {}) == taken_off(state, source_model.source, lines(rng, 1.5, units=2))
    anchored = replace(
        state, fit=replace(state.fit, correspondence=replace(state.fit.correspondence, is_anchored=True))
    )
    assert LotCorrection(1, lines(rng, 1.5)).apply(anchored, source_model.source).correction is None


def test_the_map_reads_what_is_left_once_gain_and_zero_are_taken_off(rng, source_model, state, unit):
    corrected = LotCorrection(2, lines(rng, 1.1, 0.05, spread=0.01)).apply(state, source_model.source)
    line = corrected.correction.line
    assert corrected.map_sha256 != state.map_sha256 and corrected.map_id != state.map_id
    assert corrected.predicted_rmse == state.predicted_rmse
    read = [estimate(source_model.network, one, unit).estimate for one in (state, corrected)]
    expected_N = (read[0] - line.zero) / line.gain
    span, rows = float(np.ptp(source_model.source.reference)), np.isfinite(expected_N)
    # A straight line behind the map goes through both ends; between them f bends it a little.
    assert np.sqrt(np.mean((read[1][rows] - expected_N[rows]) ** 2)) < 0.02 * span


def test_what_a_correction_leaves_open_is_in_the_interval(rng, source_model, state):
    """The standard error of the mean of ten audits, at rest and in proportion to the load, in quadrature."""
    audited_lines = lines(rng, 1.1, 0.05)
    corrected = LotCorrection(2, audited_lines).apply(state, source_model.source)
    gains, zeros = (
        np.array(each)
        for each in zip(*((np.log(o.line.gain), o.line.zero) for o in audited_lines.values()), strict=True)
    )
    errors = [each.std(ddof=1) / np.sqrt(UNITS) for each in (gains, zeros)]
    added = np.sqrt(corrected.interval.half_width**2 - state.interval.half_width**2)
    levels = state.interval.levels
    np.testing.assert_allclose(added, np.tile(1.645 * np.hypot(errors[0] * levels, errors[1]), (3, 1)), rtol=1e-6)
