"""A whole run on the simulated rig: what is recorded is what happened."""

from dataclasses import replace

import numpy as np
import pytest

from softcal.core.errors import CommandRefused
from softcal.core.profiles import ramps, unit_profile
from softcal.core.simulated_lot import draw_lot
from softcal.core.twin.simulate import Twin, simulate
from softcal.station.bench.bench import open_simulated_bench
from softcal.station.tasks.acquisition import record


@pytest.fixture(scope="module")
def source_run():
    with open_simulated_bench(seed=3) as (bench, station):
        recording = record(bench, "A0", unit_profile(np.random.default_rng(1), 40.0), with_reference=True)
        yield recording, station


@pytest.mark.long
def test_time_axis_is_the_sensor_clock(source_run):
    recording, _ = source_run
    np.testing.assert_allclose(np.diff(recording.t_s), 0.02, atol=1e-9)
    assert recording.lost == 0


def test_the_source_recording_is_accepted_by_core(source_run):
    labelled = source_run[0].labelled_recording()
    assert labelled.unlabelled.sample_rate_Hz == 50.0
    assert labelled.unlabelled.stage_mm is not None


def test_force_and_output_are_those_of_the_twin_at_the_recorded_stage_position(source_run):
    recording, station = source_run
    surface_mm = recording.contact_mm - 0.3 - station.rig.clearance_mm
    force_N, output_V = simulate(Twin(), recording.t_s, recording.stage_mm + surface_mm)
    # 20 N/s at most, so 2 ms of delay and 5 µm of stage are 0.06 N at the worst instant.
    assert np.sqrt(np.mean((recording.force_N - force_N) ** 2)) < 0.04
    assert np.sqrt(np.mean((recording.output[:, 0] - output_V) ** 2)) < 0.008


def test_the_profile_reaches_its_depth_and_returns(source_run):
    recording, _ = source_run
    # Half a sample beside the turning point, and 5 ms of the track: 0.5 · 200 mm/s² · (15 ms)².
    assert recording.stage_mm.max() == pytest.approx(3.5, abs=0.0225)
    assert recording.stage_mm[-1] == pytest.approx(0.0, abs=0.01)


def test_a_target_unit_keeps_no_reference():
    with open_simulated_bench(seed=12) as (bench, _):
        recording = record(bench, "A1", ramps([2.0], 4.0, rest_s=0.5), with_reference=False)
    assert recording.force_N is None
    with pytest.raises(ValueError):
        recording.labelled_recording()


@pytest.mark.parametrize(
    ("stage", "force"),
    [("zaber", "hx711"), ("grbl", "mark10"), ("zaber", "indicator"), ("grbl", "loadstar"), ("esm", "esm")],
)
def test_every_dialect_records_the_same_unit(stage, force):
    with open_simulated_bench(seed=3, stage_kind=stage, force_kind=force) as (bench, station):
        recording = record(bench, "A0", ramps([2.0, 3.0], 3.0, rest_s=0.5), with_reference=True)
        surface_mm = recording.contact_mm - 0.3 - station.rig.clearance_mm
    force_N, output_V = simulate(Twin(), recording.t_s, recording.stage_mm + surface_mm)
    assert np.sqrt(np.mean((recording.force_N - force_N) ** 2)) < 0.06
    assert np.sqrt(np.mean((recording.output[:, 0] - output_V) ** 2)) < 0.01


@pytest.mark.parametrize(
    ("profile", "message"), [(ramps([2.0], 11.0), "11 mm/s.* 10 mm/s"), (ramps([9.0], 2.0), " 9 mm.* 8 mm")]
)
def test_a_profile_beyond_the_bounds_moves_nothing(profile, message):
    with open_simulated_bench(seed=1) as (bench, station):
        at_mm = station.axis.position_mm
        with pytest.raises(CommandRefused, match=message):
            record(bench, "A0", profile, with_reference=True)
        station.world.sleep_s(1.0)
        assert station.axis.position_mm == at_mm


def test_a_unit_is_found_without_a_load_cell():
    with open_simulated_bench(seed=1) as (bench, station):
        blind = replace(bench, force=None)
        with pytest.raises(CommandRefused, match="without_cell"):
            record(blind, "A0", ramps([2.0], 4.0, rest_s=0.5), with_reference=False)
        allowed = replace(bench.config, force=None, safety=replace(bench.config.safety, without_cell=True))
        blind = replace(blind, config=allowed)
        recording = record(blind, "A0", ramps([2.0], 4.0, rest_s=0.5), with_reference=False)
        assert recording.contact_mm == pytest.approx(station.rig.clearance_mm + 0.3, abs=0.4)
        with pytest.raises(CommandRefused) as refused:
            record(blind, "A0", ramps([2.0], 4.0), with_reference=True)
        assert refused.value.reason.code == "rig.needs_cell"


def test_bursts_lost_and_repeated_lines_and_a_wrap_do_no_harm():
    with open_simulated_bench(seed=5) as (bench, station):
        station.readout_wire.loss = station.readout_wire.repeat = 0.005
        station.readout.device_ms = 2.0**32 - 15_000
        recording = record(bench, "A0", ramps([2.0, 3.0], 3.0), with_reference=True)
    assert np.all(np.diff(recording.t_s) > 0)
    assert recording.t_s[-1] < 60.0
    assert recording.labelled_recording().unlabelled.windows.shape[1] == 15


def test_several_units_are_pressed_at_once_each_on_its_channel():
    units = draw_lot(np.random.default_rng(1), 3)
    with open_simulated_bench(units[0], seed=1, other_units=units[1:]) as (bench, station):
        recording = record(bench, "SUB1", ramps([2.0], 3.0, rest_s=0.5), with_reference=True)
        surface_mm = recording.contact_mm - 0.3 - station.rig.clearance_mm
    assert recording.output.shape[1] == 3
    # Contact was searched with the first unit, so the true surface is a little off for all of them alike.
    for channel, unit in enumerate(units):
        _, output_V = simulate(unit, recording.t_s, recording.stage_mm + surface_mm)
        unit_recording = recording.output_recording(channel, f"U{channel}")
        assert unit_recording.serial == f"U{channel}"
        assert np.sqrt(np.mean((unit_recording.output - output_V) ** 2)) < 0.01
