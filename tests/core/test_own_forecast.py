"""What a unit's own calibration would leave open: noise in closed form, clipping, and what none of them is."""

from dataclasses import replace

import numpy as np
import pytest

from softcal.core.maps.ends import output_noise
from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.forecast import noise_error
from softcal.core.unit.knowledge import BlindConfig
from softcal.core.unit.unit_problem import UnitProblem


def own_forecast(model, network, unit):
    calibration = calibrate(UnitProblem(model, unit))
    return calibration.fit.own_rmse


def test_noise_is_carried_through_the_slope_of_the_network(linear_network, press):
    unit = press(2, seconds=120.0).unlabelled
    # 10 N/V on the newest sample alone; 2,000 draws know a standard deviation within 1.6 % (one sigma).
    assert noise_error(linear_network, unit, 2000) == pytest.approx(10 * output_noise(unit), rel=0.06)


def test_a_quiet_good_unit_is_forecast_near_its_source(source_model, linear_network, press):
    forecast = own_forecast(source_model, linear_network, press(2, gain=1.3, seconds=120.0).unlabelled)
    assert forecast == pytest.approx(BlindConfig().own[0][1] * source_model.held_out_rmse, rel=0.25)


def test_a_clipped_unit_would_read_badly_with_its_own_calibration_too(source_model, linear_network, press):
    unit = press(2, gain=1.3, seconds=120.0).unlabelled
    clipped = replace(unit, output=np.minimum(unit.output, 0.85))
    whole, cut = (own_forecast(source_model, linear_network, u) for u in (unit, clipped))
    assert cut > 2 * whole
