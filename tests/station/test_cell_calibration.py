"""Dead weights give the scale of a load cell back, and refuse what is no scale."""

import numpy as np
import pytest

from softcal.core.errors import BadReply, InputError
from softcal.station.bench.bench import open_simulated_bench
from softcal.station.devices.cell_calibration import fit_cell, read_steady

MASSES = (0.0, 0.1, 0.2, 0.5)


def test_weights_on_the_simulated_cell_give_its_counts_per_newton_back():
    with open_simulated_bench(seed=1) as (bench, station):
        station.axis.position_mm = 0.0
        readings = []
        for mass_kg in MASSES:
            station.rig.force_fault = lambda now_s, force_N, mass_kg=mass_kg: force_N + mass_kg * 9.80665
            bench.force.counts_per_N, bench.force.zero_counts = 1.0, 0.0
            readings.append(read_steady(bench.force, bench.clock))
    calibration = fit_cell(MASSES, *zip(*readings, strict=True))
    assert calibration.per_N == pytest.approx(station.counts_per_N, rel=2e-3)
    assert calibration.zero == pytest.approx(station.zero_counts, abs=100)
    assert calibration.largest_error_N < 0.01


def test_the_scale_of_two_points_is_the_quotient_of_their_differences():
    calibration = fit_cell((0.0, 1.0), (500.0, -9306.65), (1.0, 1.0))
    assert calibration.per_N == pytest.approx(-1000.0)
    assert calibration.zero == pytest.approx(500.0)


def test_a_nonlinear_cell_shows_in_the_largest_error():
    masses = np.array([0.0, 0.5, 1.0])
    force_N = masses * 9.80665
    calibration = fit_cell(masses, 1000 * (force_N + 0.01 * force_N**2), np.ones(3))
    assert calibration.largest_error_N > 0.1


def test_one_weight_or_a_dead_cell_is_no_scale():
    with pytest.raises(InputError):
        fit_cell((0.5, 0.5), (1.0, 1.0), (0.1, 0.1))
    with pytest.raises(BadReply):
        fit_cell((0.0, 0.5), (100.0, 100.5), (1.0, 1.0))
