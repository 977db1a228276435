"""Sensor, load cell and stage meet within ten milliseconds, whatever the lines do."""

import numpy as np
import pytest

from softcal.core.profiles import unit_profile
from softcal.core.twin.simulate import Twin, simulate
from softcal.station.bench.bench import open_simulated_bench
from softcal.station.clock import residual_offset_s
from softcal.station.tasks.acquisition import record
from tests.layers import layered


@pytest.mark.parametrize(
    "delays", layered([(0.00004, 0.0, 0.0), (0.001, 0.002, 0.1), (0.001, 0.010, 0.1)], [(0.001, 0.010, 0.1)])
)
def test_channels_meet_within_ten_milliseconds_on_lines_that_are_late(delays):
    with open_simulated_bench(Twin(), seed=6) as (bench, station):
        for wire in (station.stage_wire, station.force_wire, station.readout_wire):
            wire.delay_s, wire.jitter_s, wire.stall_s = delays
        station.readout.device_ms = 2.0**32 - 20_000  # millis() wraps in the run
        recording = record(bench, "A1", unit_profile(np.random.default_rng(2), 20.0), with_reference=True)
        surface_mm = recording.contact_mm - bench.config.fixture.clearance_mm - station.rig.clearance_mm
    force_N, output_V = simulate(Twin(), recording.t_s, recording.stage_mm + surface_mm)
    assert abs(residual_offset_s(force_N, recording.force_N, 50.0)) < 0.01
    assert abs(residual_offset_s(output_V, recording.output[:, 0], 50.0)) < 0.01
