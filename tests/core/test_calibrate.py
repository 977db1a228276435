"""One unit end to end on a sensor that can be checked by hand, with faults planted one by one."""

import json
from dataclasses import replace

import numpy as np
import pytest
from common.planted import FAULTS, planted

from softcal.core.errors import InputError
from softcal.core.maps.config import MapConfig
from softcal.core.metrics import rmse
from softcal.core.recording import OutputRecording
from softcal.core.simulated_lot import LotDesign, simulate_lot
from softcal.core.unit.calibrate import calibrate as calibrate_problem
from softcal.core.unit.estimate import estimate
from softcal.core.unit.explanation import contributions
from softcal.core.unit.findings import opening_findings
from softcal.core.unit.method import Method
from softcal.core.unit.source_model import make_source_model
from softcal.core.unit.state import UnitState
from softcal.core.unit.state_json import adjustments_to_json, fit_from_json, fit_to_json, state_from_json
from softcal.core.unit.unit_problem import UnitProblem
from softcal.core.unit.verdict import Limit

AFFINE, AUTO = Method(map=MapConfig(family="affine")), Method()


@pytest.fixture(scope="module")
def calibrate(source_model):
    def run(unit: OutputRecording, limit: Limit | None = None, method: Method = AFFINE) -> UnitState:
        return calibrate_problem(UnitProblem(replace(source_model, method=method), unit, limit))

    return run


@pytest.fixture(scope="module")
def good(press) -> OutputRecording:
    return press(2, gain=1.3, offset_V=0.05, seconds=120.0).unlabelled


def findings(calibration):
    return ", ".join(finding.kind for finding in calibration.fit.findings)


def test_good_units_are_near_their_forecasts_and_their_intervals_hold(calibrate, linear_network, press):
    covered, ratios = [], []
    for k in range(8):
        gain, offset_V = 0.8 + 0.1 * k, 0.02 * k
        calibration = calibrate(press(20 + k, gain, offset_V, seconds=120.0).unlabelled)
        audit = press(40 + k, gain, offset_V)
        result = estimate(linear_network, calibration, audit.unlabelled)
        rows = np.isfinite(result.estimate)
        covered.append(np.mean(((result.lower <= audit.reference) & (audit.reference <= result.upper))[rows]))
        ratios.append(rmse(result.estimate, audit.reference) / calibration.predicted_rmse)
    assert 0.8 < np.mean(covered) <= 1.0
    assert 0.5 < np.median(ratios) < 1.5 and max(ratios) < 3


def test_equal_input_gives_equal_result(calibrate, good):
    first, second = (fit_to_json(calibrate(good).fit) for _ in range(2))
    assert first.content == second.content
    assert all(np.array_equal(array, second.arrays[name]) for name, array in first.arrays.items())


def test_a_state_is_read_back_as_it_was_written(calibrate, linear_network, good):
    state = calibrate(good)
    stored = fit_to_json(state.fit)
    content, adjustments = (json.loads(json.dumps(one)) for one in (stored.content, adjustments_to_json(state)))
    again = state_from_json(fit_from_json(content, state.fit.method, stored.arrays), adjustments)
    assert (again.decision, again.forecast, again.limit) == (state.decision, state.forecast, state.limit)
    assert (again.map_id, again.map_sha256) == (state.map_id, state.map_sha256)
    assert again.fit.fitted.output_limits == state.fit.fitted.output_limits
    one, two = (estimate(linear_network, each, good) for each in (state, again))
    for name in ("estimate", "lower", "upper", "flag"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    # Without its arrays it is decided on alike, and estimates nothing.
    listed = state_from_json(fit_from_json(content, state.fit.method), adjustments)
    assert listed.decision == state.decision
    with pytest.raises(ValueError, match="arrays"):
        _ = listed.unit_map


def test_without_a_limit_nothing_passes_and_the_error_stands_beside_the_range(calibrate, good, source_model):
    (statement,) = [one for one in calibrate(good, Limit("N", 0.5)).decision.reasons if one.code == "statement"]
    assert statement.values["origin"].code == "part.stated"
    calibration = calibrate(good, None)
    assert calibration.decision.verdict == "conditional"
    (reason,) = [one for one in calibration.decision.reasons if one.code == "no_limit"]
    loads = source_model.source.reference
    assert reason.values["share"] == pytest.approx(calibration.predicted_rmse / np.ptp(loads), rel=0.05)


def test_a_generous_limit_is_held_by_the_forecast_alone_and_a_strict_one_fails(calibrate, good):
    generous = calibrate(good, Limit("N", 1.0)).decision
    assert generous.predicted.verdict == "pass"
    # Nobody has measured this unit, nor others of its lot.
    assert generous.verdict == "conditional" and generous.reasons[0].code == "forecast_only"
    assert calibrate(good, Limit("N", 0.001)).decision.verdict == "fail"


def test_a_limit_in_another_unit_is_refused(calibrate, good):
    with pytest.raises(InputError, match="kPa.* N"):
        calibrate(good, Limit("kPa", 0.3))


def test_reversed_wiring_fails(calibrate, good):
    calibration = calibrate(replace(good, output=1.5 - good.output), Limit("N", 10.0))
    assert "reversed" in findings(calibration) and calibration.decision.verdict == "fail"
    assert "reversed" in {why.code for why in calibration.decision.reasons}


def test_a_clipped_unit_never_passes(calibrate, good):
    calibration = calibrate(replace(good, output=np.minimum(good.output, 0.85)), Limit("N", 10.0))
    assert "saturated" in findings(calibration) and calibration.decision.verdict in ("fail", "retest")


def test_drift_inside_the_recording_is_distinguished_from_creep(calibrate, good):
    drifting = replace(good, output=good.output + np.linspace(0, 0.12, len(good)))
    assert "drift" in findings(calibrate(drifting))


def test_another_sensor_type_is_unfamiliar(calibrate, good, rng):
    chatter = replace(good, output=good.output + rng.normal(0, 0.03, len(good)))
    assert "unfamiliar" in findings(calibrate(chatter))


def test_too_little_data_never_passes(calibrate, press):
    calibration = calibrate(press(2, gain=1.3, seconds=8.0).unlabelled, Limit("N", 10.0))
    assert "too little data" in findings(calibration) and calibration.decision.verdict in ("conditional", "retest")


def test_a_slow_programme_without_known_positions_asks_for_a_retest(calibrate, good, press):
    slow = np.interp(np.arange(6000) / 4, np.arange(len(good)), good.output)
    calibration = calibrate(replace(press(2, seconds=120.0).unlabelled, output=slow), Limit("N", 10.0))
    assert "wrong programme" in findings(calibration) and calibration.decision.verdict == "retest"


def test_a_unit_pressed_below_half_the_range_says_so(calibrate, press):
    unit = press(2, seconds=120.0)
    lighter = replace(unit.unlabelled, output=0.5 + (unit.unlabelled.output - 0.5) * 0.25)
    calibration = calibrate(lighter, Limit("N", 10.0))
    assert "stretched" in findings(calibration) and calibration.decision.predicted.verdict == "retest"
    assert "stretched" in {why.code for why in calibration.decision.reasons}


def test_a_unit_a_third_less_sensitive_is_not_called_badly_pressed(calibrate, press):
    unit = press(2, seconds=120.0)
    weaker = replace(unit.unlabelled, output=0.5 + (unit.unlabelled.output - 0.5) * 0.67)
    assert "stretched" not in findings(calibrate(weaker, Limit("N", 10.0)))


def test_a_mix_of_loads_that_only_widens_the_forecast_does_not_veto(calibrate, good):
    slower = np.interp(np.arange(9000) / 2, np.arange(len(good)), good.output)
    record = replace(good, t_s=np.arange(9000) / 50.0, output=slower)
    calibration = calibrate(record, Limit("N", 10.0))
    assert "wrong programme" in findings(calibration) and calibration.decision.verdict == "conditional"


def test_known_positions_reveal_a_gain_error_the_output_hides(source_model, linear_network, press):
    """A unit pressed to two thirds of the depth looks exactly like one with two thirds of the gain."""
    source, unit = source_model.source, press(2, seconds=120.0)
    lighter = replace(unit.unlabelled, output=0.5 + (unit.unlabelled.output - 0.5) * 2 / 3)
    depth_mm = unit.reference * 2 / 3
    blind = calibrate_problem(UnitProblem(replace(source_model, method=AFFINE), lighter))
    staged_source = replace(source, unlabelled=replace(source.unlabelled, stage_mm=source.reference))
    model = make_source_model(staged_source, linear_network, np.arange(0, len(staged_source.windows), 4), method=AFFINE)
    staged = calibrate_problem(UnitProblem(model, replace(lighter, stage_mm=depth_mm)))
    assert staged.predicted_rmse > 4 * blind.predicted_rmse


def test_the_parts_of_a_forecast_add_up_to_it(calibrate, good):
    calibration = calibrate(good)
    total = np.sqrt(sum(part**2 for part in contributions(calibration.fit).values()))
    assert total == pytest.approx(calibration.predicted_rmse)


def test_a_simulated_lot_depends_on_its_seed_alone_and_holds_every_fault():
    design = LotDesign(good=2, bad=planted(FAULTS), source_s=60.0, unit_s=20.0, audit_s=20.0)
    one, two = simulate_lot(5, design), simulate_lot(5, design)
    assert {u.kind for u in one.units} == {"good", *FAULTS}
    for a, b in zip(one.units, two.units, strict=True):
        np.testing.assert_array_equal(a.recording.output, b.recording.output)
    assert not np.array_equal(one.source.reference, simulate_lot(6, design).source.reference)


def test_an_unknown_shift_lists_the_known_ones():
    with pytest.raises(InputError, match="'haunted'.*none, short profile"):
        LotDesign(shift="haunted")


def test_unit_pressed_at_once_with_the_source_is_measured_against_its_reference(calibrate, linear_network, press):
    unit = press(1, gain=1.3, offset_V=0.05, seconds=120.0)
    calibration = calibrate(unit.unlabelled, method=AUTO)
    assert calibration.unit_map.family == "synchronous"
    audit = press(41, gain=1.3, offset_V=0.05)
    true = rmse(estimate(linear_network, calibration, audit.unlabelled).estimate[14:], audit.reference[14:])
    assert calibration.fit.budget["paired"] == pytest.approx(true, rel=0.25)
    assert calibration.predicted_rmse == pytest.approx(true, rel=0.35)
    assert "wrong programme" not in findings(calibration)


def test_a_dull_unit_shows_in_its_corners(calibrate, press):
    sharp = press(2, gain=1.3, seconds=120.0).unlabelled
    response = np.exp(-np.arange(200) / 25.0)
    rest_V = sharp.output[0]
    lagging_V = rest_V + np.convolve(sharp.output - rest_V, response / response.sum())[: len(sharp)]
    dull = replace(sharp, output=lagging_V)
    corners = [calibrate(unit).fit.budget["corners"] for unit in (sharp, dull)]
    assert corners[1] > 5 * max(corners[0], 0.01)


def creeping(output: np.ndarray, share: float = 0.25, seconds: float = 6.0) -> np.ndarray:
    """Return the output with a slow part that follows the fast one late."""
    slow, decay = np.empty_like(output), np.exp(-1 / (50.0 * seconds))
    slow[0] = output[0]
    for k in range(1, len(output)):
        slow[k] = decay * slow[k - 1] + (1 - decay) * output[k]
    return np.asarray((1 - share) * output + share * slow)


def test_known_positions_tell_creep_from_good_order(source_model, linear_network, press):
    source = source_model.source
    staged_source = replace(source, unlabelled=replace(source.unlabelled, stage_mm=source.reference))
    model = make_source_model(
        staged_source, linear_network, np.arange(0, len(staged_source.windows), 4), method=Method()
    )
    unit = press(2, gain=1.3, seconds=120.0)
    sound = replace(unit.unlabelled, stage_mm=unit.reference)
    kinds = [
        findings(calibrate_problem(UnitProblem(model, recording, Limit("N", 10.0))))
        for recording in (sound, replace(sound, output=creeping(sound.output)))
    ]
    assert "misread" not in kinds[0] and "misread" in kinds[1]


def test_an_opening_is_scored_on_presses_its_map_has_not_read(calibrate, press):
    source, other = press(1, gain=1.3, offset_V=0.05, seconds=120.0), press(7, gain=1.3, offset_V=0.05, seconds=120.0)
    shared = 1500
    output = np.concatenate([source.unlabelled.output[:shared], other.unlabelled.output[shared:]])
    calibration = calibrate(replace(source.unlabelled, output=output), method=AUTO)
    true = rmse(10 * (output - 0.05) / 1.3 - 5.0, np.concatenate([source.reference[:shared], other.reference[shared:]]))
    assert calibration.unit_map.family == "synchronous"
    assert calibration.predicted_rmse == pytest.approx(true, rel=0.5)


@pytest.mark.parametrize(("lag_s", "count"), [(0.0, 0), (0.12, 1)])
def test_a_unit_that_follows_late_in_a_shared_opening_is_reported(lag_s, count):
    assert len(opening_findings({"lag_s": lag_s, "shared_until_s": 40.0}, AUTO.findings)) == count
    assert opening_findings({"lag_s": lag_s}, AUTO.findings) == ()


def test_what_an_audit_takes_is_no_part_of_what_the_map_took(source_model, good, press, monkeypatch):
    import softcal.core.unit.audit as measuring
    from softcal.app.calibration import unit_calibration

    now_s, score = [0.0], measuring.score_map

    def slow_score(*arguments):
        now_s[0] += 100.0
        return score(*arguments)

    monkeypatch.setattr(measuring, "score_map", slow_score)
    monkeypatch.setattr(unit_calibration.time, "perf_counter", lambda: now_s[0])
    audit = press(3, gain=1.3, offset_V=0.05, seconds=120.0)
    calibration = unit_calibration.calibrated(UnitProblem(replace(source_model, method=AFFINE), good, audit=audit))
    assert now_s[0] == 100.0 and calibration.state.fit.fit_s == 0.0
