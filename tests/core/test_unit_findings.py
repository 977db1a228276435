"""What is wrong with a unit is named for what it is, on recordings drawn on the twin; no label of the unit is seen."""

from dataclasses import replace

import numpy as np
import pytest
from common.planted import planted

from softcal.core.network.config import NetworkConfig
from softcal.core.network.training import fit_network
from softcal.core.recording import OutputRecording
from softcal.core.simulated_lot import LotDesign, SimulatedLot, simulate_lot
from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.findings import contradictions
from softcal.core.unit.health import output_limits
from softcal.core.unit.method import Method
from softcal.core.unit.source_model import SourceModel, make_source_model
from softcal.core.unit.state import UnitState
from softcal.core.unit.unit_problem import UnitProblem
from tests.layers import layered

NETWORK = NetworkConfig(hidden=(24, 12), max_epochs=20, batch=128)


@pytest.fixture(scope="module", params=[2, 4])
def seed(request: pytest.FixtureRequest) -> int:
    return int(request.param)


@pytest.fixture(scope="module")
def model(seed: int) -> SourceModel:
    source = simulate_lot(seed, LotDesign(good=1)).source
    return make_source_model(source, fit_network(source, NETWORK).network, method=Method())


def lot(seed: int, **design: object) -> SimulatedLot:
    return simulate_lot(seed, LotDesign(**design))  # type: ignore[arg-type]


def calibrate_and_list_findings(model: SourceModel, recording: OutputRecording) -> tuple[UnitState, set[str]]:
    calibration = calibrate(UnitProblem(model, recording))
    return calibration, {finding.kind for finding in calibration.fit.findings}


def test_a_unit_pressed_over_half_the_range_is_a_retest_and_says_so(seed: int, model: SourceModel) -> None:
    for unit in lot(seed, good=3, shift="half range").units:
        calibration, names = calibrate_and_list_findings(model, unit.recording)
        assert "stretched" in names and calibration.decision.verdict == "retest"


def test_the_forecast_of_half_a_range_includes_the_uncertainty_of_its_gain(seed: int, model: SourceModel) -> None:
    (unit,) = lot(seed, good=1, shift="half range").units
    calibration, _ = calibrate_and_list_findings(model, unit.recording)
    assert calibration.fit.budget["gain"] > 0.5 * calibration.fit.load_rms


def test_a_good_unit_with_a_programme_of_its_own_is_not_told_it_was_pressed_lightly(
    seed: int, model: SourceModel
) -> None:
    for unit in lot(seed, good=3, shift="own programme").units:
        assert "stretched" not in calibrate_and_list_findings(model, unit.recording)[1]


@pytest.mark.parametrize("shift", ["none", "own programme"])
def test_wrong_polarity_is_named_alone(seed: int, model: SourceModel, shift: str) -> None:
    for unit in lot(seed, good=0, bad=planted(["reversed"], 2), shift=shift).units:
        calibration, names = calibrate_and_list_findings(model, unit.recording)
        assert names == {"reversed"} and calibration.decision.verdict == "fail"


@pytest.mark.parametrize("shift", layered(("none", "own programme"), ("own programme",)))
def test_twice_the_noise_is_not_clipping(seed: int, model: SourceModel, shift: str) -> None:
    (unit,) = lot(seed, good=1, shift=shift).units
    noise_V = float(np.median(np.abs(np.diff(unit.recording.output, 2)))) / 0.6745 / np.sqrt(6)
    for draw in range(5):
        more = np.random.default_rng(draw).normal(0, np.sqrt(3) * noise_V, len(unit.recording.output))
        noisy = replace(unit.recording, output=unit.recording.output + more)
        assert "saturated" not in calibrate_and_list_findings(model, noisy)[1]


def test_a_readout_that_clips_is_named_for_it_and_not_for_a_light_press(seed: int, model: SourceModel) -> None:
    for unit in lot(seed, good=0, bad=planted(["saturated"], 3), shift="own programme").units:
        names = calibrate_and_list_findings(model, unit.recording)[1]
        assert "saturated" in names and "stretched" not in names


def test_a_map_fitted_to_the_sources_programme_does_not_hide_that_the_programme_differs(
    seed: int, model: SourceModel
) -> None:
    (unit,) = lot(seed, good=1, shift="other dwell").units
    line = replace(model.method, map=replace(model.method.map, family="two_point"))
    linear_model = replace(model, method=line)
    bent, rigid = (calibrate(UnitProblem(one, unit.recording)) for one in (model, linear_model))
    assert bent.unit_map.family == "averaged"
    for name in ("shift", "overlap"):
        assert bent.fit.budget[name] == pytest.approx(rigid.fit.budget[name])


def lagging(recording: OutputRecording, lag_s: float) -> OutputRecording:
    """The recording behind a readout with this time constant: y' = (x - y) / lag."""
    output, decay = np.empty_like(recording.output), np.exp(-1 / (recording.sample_rate_Hz * lag_s))
    output[0] = recording.output[0]
    for k in range(1, len(output)):
        output[k] = decay * output[k - 1] + (1 - decay) * recording.output[k]
    return replace(recording, output=output)


@pytest.mark.parametrize("lag_s", layered((0.3, 0.5), (0.5,)))
def test_a_readout_that_lags_beside_a_shared_clock_is_named_for_it(seed: int, model: SourceModel, lag_s: float) -> None:
    (unit,) = lot(seed, good=1).units
    calibration, names = calibrate_and_list_findings(model, lagging(unit.recording, lag_s))
    assert "lagging" in names and "wrong programme" not in names
    assert calibration.fit.readout_lag_s == pytest.approx(lag_s, rel=0.3)
    assert calibration.decision.verdict != "pass"


@pytest.mark.long
def test_a_clock_that_is_ahead_and_creep_are_no_lag(seed: int, model: SourceModel) -> None:
    for unit in lot(seed, good=2, bad=planted(["extra creep"], 2)).units:
        ahead = replace(unit.recording, t_s=unit.recording.t_s + 0.2)
        for recording in (unit.recording, ahead):
            assert "lagging" not in calibrate_and_list_findings(model, recording)[1]


def test_without_a_shared_load_no_lag_is_claimed(seed: int, model: SourceModel) -> None:
    (unit,) = lot(seed, good=1, shift="own programme").units
    for recording in (unit.recording, lagging(unit.recording, 0.5)):
        assert "lagging" not in calibrate_and_list_findings(model, recording)[1]


@pytest.mark.parametrize(("apart_V", "is_elsewhere"), [(0.4, False), (0.6, True)])
def test_an_output_is_elsewhere_when_half_of_the_wider_range_parts_it_from_the_source(
    model: SourceModel, apart_V: float, is_elsewhere: bool
) -> None:
    t_s = np.arange(1500) / 50.0
    press = np.sin(np.pi * t_s) ** 2 + 1e-3 * np.random.default_rng(1).normal(size=1500)
    source = OutputRecording("S0", t_s, press - 0.5, 50.0)
    unit = OutputRecording("U1", t_s, 0.5 + apart_V + 0.2 * press, 50.0)
    limits = output_limits(unit, source, True, model.method)
    codes = [finding.reason.code for finding in contradictions(source, unit, limits, model.method)]
    assert codes == (["elsewhere"] if is_elsewhere else [])
