"""A golden run carries units of another day and programme to the source; a wrong one is refused before any fit."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from softcal.app.texts.catalogue import text
from softcal.app.texts.reasons import render_reason
from softcal.core.errors import InputError
from softcal.core.metrics import rmse
from softcal.core.recording import LabelledRecording
from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.day_correction import fit_day_correction
from softcal.core.unit.unit_problem import UnitProblem

DAY_GAIN, DAY_ZERO_V = 1.08, 0.01


def on_another_day(recording: LabelledRecording) -> LabelledRecording:
    raw = recording.unlabelled
    return replace(recording, unlabelled=replace(raw, output=0.5 + DAY_GAIN * (raw.output - 0.5) + DAY_ZERO_V))


def lighter(recording: LabelledRecording, rest_V: float, share: float = 0.6) -> LabelledRecording:
    """Return the recording of the same presses at a share of their loads."""
    raw = recording.unlabelled
    output = rest_V + share * (raw.output - rest_V)
    return replace(recording, unlabelled=replace(raw, output=output), reference=share * recording.reference)


@pytest.fixture(scope="module")
def sitting(press):
    """The golden unit and a unit of 1.3 times its gain, pressed by one programme that the source never had."""
    golden, unit = press(9, serial="S0", seconds=60.0), press(9, gain=1.3, offset_V=0.05, seconds=60.0)
    return golden, unit


def reads(model, calibration, recording):
    estimate = model.network.evaluate(calibration.unit_map.apply(recording.windows))
    return rmse(estimate, recording.window_reference)


def codes(calibration):
    """Codes of the reasons, each of which can be said in both languages."""
    reasons = calibration.decision.reasons
    assert all(str(why) and render_reason(why, partial(text, "ko")) for why in reasons)
    return [why.code for why in reasons]


def test_the_day_of_a_measured_golden_run_is_found(source_model, sitting):
    correction = fit_day_correction(source_model, on_another_day(sitting[0]))
    assert correction.day_map.gain == pytest.approx(1 / DAY_GAIN, rel=0.01)
    load = 10 * sitting[0].reference / 10
    expected = rmse(10 * (0.5 + DAY_GAIN * 0.1 * load + DAY_ZERO_V - 0.5), load)
    assert correction.day_rmse == pytest.approx(expected, rel=0.05)


def test_the_same_day_is_left_alone(source_model, sitting):
    correction = fit_day_correction(source_model, sitting[0])
    assert correction.day_map.gain == pytest.approx(1.0, abs=0.005) and correction.day_rmse < source_model.held_out_rmse


def test_a_unit_of_another_programme_reads_its_loads_by_the_day_correction(source_model, sitting, press):
    # Pressed lighter than the source: from its output alone it is a less sensitive one.
    golden, unit = (on_another_day(lighter(r, rest)) for r, rest in zip(sitting, (0.5, 0.7), strict=True))
    correction = fit_day_correction(source_model, golden)
    bridged = calibrate(UnitProblem(source_model, unit.unlabelled, day_correction=correction))
    blind = calibrate(UnitProblem(source_model, unit.unlabelled))
    assert bridged.correspondence.kind == "paired" and blind.correspondence.kind == "blind"
    later = on_another_day(press(11, gain=1.3, offset_V=0.05, seconds=60.0))
    assert reads(source_model, bridged, later) < 0.06 < 0.4 < reads(source_model, blind, later)
    assert "bridge.measured" in codes(bridged)


def test_an_unmeasured_golden_run_carries_the_unit_to_the_day_of_the_source(source_model, sitting, press):
    golden, unit = map(on_another_day, sitting)
    correction = fit_day_correction(source_model, golden.unlabelled)
    bridged = calibrate(UnitProblem(source_model, unit.unlabelled, day_correction=correction))
    direct = calibrate(UnitProblem(source_model, unit.unlabelled))
    on_day_of_source = press(11, gain=1.3, offset_V=0.05, seconds=60.0)
    assert reads(source_model, bridged, on_day_of_source) < 0.6 * reads(source_model, direct, on_day_of_source)
    assert "bridge.read" in codes(bridged) and not correction.is_measured


def test_what_the_day_changes_is_in_forecast_and_interval(source_model, sitting):
    golden, unit = map(on_another_day, sitting)
    correction = fit_day_correction(source_model, golden)
    whole, without = (
        calibrate(UnitProblem(source_model, unit.unlabelled, day_correction=b))
        for b in (correction, replace(correction, day_rmse=0.0))
    )
    assert whole.forecast.rmse == pytest.approx(np.hypot(without.forecast.rmse, correction.day_rmse))
    assert (whole.interval.half_width > without.interval.half_width).all()


def test_a_golden_run_of_other_loads_is_reported_and_not_used(source_model, sitting, press):
    correction = fit_day_correction(source_model, press(77, serial="S0", seconds=60.0))
    bridged = calibrate(UnitProblem(source_model, sitting[1].unlabelled, day_correction=correction))
    alone = calibrate(UnitProblem(source_model, sitting[1].unlabelled))
    assert "bridge.unused" in codes(bridged)
    assert bridged.forecast == alone.forecast


def test_the_golden_run_is_part_of_what_a_result_depends_on(source_model, sitting):
    problem = UnitProblem(source_model, sitting[1].unlabelled)
    assert (
        replace(problem, day_correction=fit_day_correction(source_model, sitting[0])).input_sha256
        != problem.input_sha256
    )


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda golden, source: replace(golden.unlabelled, serial="U7"), "U7.*S0"),
        (lambda golden, source: source, "S0"),
        (lambda golden, source: replace(golden, reference=101.97 * golden.reference), "S0.* N RMS"),
        (lambda golden, source: replace(golden, reference=golden.reference[::-1]), "S0.* N RMS"),
    ],
)
def test_a_golden_run_that_cannot_be_of_the_source_is_refused(source_model, sitting, spoil, message):
    with pytest.raises(InputError, match=message):
        fit_day_correction(source_model, spoil(sitting[0], source_model.source))
