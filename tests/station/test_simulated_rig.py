"""The simulated rig computes ahead: it reads as units and an axis that are asked one instant at a time."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from softcal.core.profiles import unit_profile
from softcal.core.simulated_lot import draw_twins
from softcal.core.twin.simulate import EffectSetting, Twin, TwinStream
from softcal.station.bench.bench import open_simulated_bench
from softcal.station.simulated.motion import Axis, QueuedMove
from softcal.station.simulated.rig import PressedUnits
from softcal.station.tasks.acquisition import record

UNITS = (
    Twin(),
    draw_twins(np.random.default_rng(4), 2)[1],
    Twin(effects=(EffectSetting("backlash", {"b": 0.05}), EffectSetting("mullins_softening", {"m": 0.2, "N0": 3.0}))),
    Twin(effects=(EffectSetting("clock_skew", {"epsilon": -0.001}), EffectSetting("readout_lag", {"tau": 0.05}))),
)


class Slow(TwinStream):
    """A unit of which one instant is asked at a time."""

    is_causal = False


@pytest.mark.parametrize("twin", UNITS)
def test_units_that_go_another_way_than_foreseen_read_as_if_nothing_had_been(twin):
    rng = np.random.default_rng(5)
    t_s = np.cumsum(rng.uniform(0.001, 0.02, 600))
    u_mm = np.abs(np.cumsum(rng.normal(0.0, 0.05, 600)))
    ahead = PressedUnits([TwinStream(twin, np.random.default_rng(6))])
    alone = TwinStream(twin, np.random.default_rng(6))
    for k in range(600):
        # Now and then somebody interferes: from there on the way that is foreseen is wrong.
        right = rng.integers(0, 40)
        wrong_mm = np.where(np.arange(599 - k) < right, 0.0, 0.3)
        foreseen = list(zip(t_s[k + 1 :], u_mm[k + 1 :] + wrong_mm, strict=True))
        force_N, output_V = ahead.read(t_s[k], u_mm[k], lambda count, foreseen=foreseen: foreseen[:count])
        expected_N, expected_V = alone.advance(t_s[k : k + 1], u_mm[k : k + 1])
        assert (force_N, output_V) == (expected_N[0], expected_V[0])


@pytest.mark.parametrize("twin", UNITS[1:])
def test_a_recording_is_to_the_bit_that_of_a_unit_asked_row_by_row(twin):
    recordings, streams = [], []
    for kind in (Slow, TwinStream):
        with open_simulated_bench(twin, 7) as (bench, station):
            stream = kind(twin, np.random.default_rng(8))
            station.rig.mount([stream], station.rig.clearance_mm, station.world.now_s())
            recordings.append(record(bench, "U1", unit_profile(np.random.default_rng(9), 8.0), with_reference=True))
            streams.append(stream)
    slow, fast = recordings
    assert len(fast.output) > 300
    assert fast.t_s.tobytes() == slow.t_s.tobytes()
    assert fast.output.tobytes() == slow.output.tobytes()
    assert fast.force_N.tobytes() == slow.force_N.tobytes()
    assert fast.stage_mm.tobytes() == slow.stage_mm.tobytes()


def test_a_unit_is_computed_far_less_often_than_it_is_read(monkeypatch):
    calls, rows, advance = [], [], TwinStream.advance

    def counted(stream, t_s, stage_mm, temperature_C=None):
        calls.append(len(t_s))
        return advance(stream, t_s, stage_mm, temperature_C)

    monkeypatch.setattr(TwinStream, "advance", counted)
    with open_simulated_bench(UNITS[1], 7) as (bench, station):
        read = station.rig.read

        def noted(now_s):
            rows.append(now_s)
            return read(now_s)

        monkeypatch.setattr(station.rig, "read", noted)
        record(bench, "U1", unit_profile(np.random.default_rng(9), 20.0), with_reference=True)
    assert len(set(rows)) > 2000
    assert len(calls) < len(set(rows)) / 16


def moved(asked_s):
    """Positions at 0.7 s, 1.1 s and 1.9 s of an axis that is held and goes on, asked at these times too."""
    axis, positions_mm = Axis(50.0), []
    for target_mm in (2.0, 5.0, 1.0):
        axis.add(QueuedMove(target_mm, 7.0))
    for time_s in sorted({*asked_s, 0.3, 0.5, 0.7, 1.1, 1.9}):
        axis.advance(time_s)
        if time_s == 0.3:
            axis.hold()
        if time_s == 0.5:
            axis.resume()
        if time_s in (0.7, 1.1, 1.9):
            positions_mm.append(axis.position_mm)
    return positions_mm


def test_where_an_axis_is_does_not_depend_on_how_often_it_is_asked():
    rng = np.random.default_rng(1)
    seldom = moved(())
    assert all(moved(rng.uniform(0.0, 1.9, count)) == seldom for count in (1, 10, 500))


def test_an_axis_goes_the_way_that_its_acceleration_integrates_to():
    axis = Axis(50.0)
    axis.add(QueuedMove(4.0, 7.0))
    times_s = np.linspace(0.0, 1.0, 400)
    way_mm = axis.positions_mm(times_s)
    ramp_s, cruise_s = 7.0 / 50.0, (4.0 - 7.0**2 / 50.0) / 7.0

    def acceleration(t):
        return 50.0 if t < ramp_s else -50.0 if ramp_s + cruise_s < t < 2.0 * ramp_s + cruise_s else 0.0

    solved = solve_ivp(
        lambda t, y: (y[1], acceleration(t)), (0.0, 1.0), (0.0, 0.0), t_eval=times_s, max_step=2e-4, rtol=1e-10
    )
    assert way_mm == pytest.approx(solved.y[0], abs=4e-3)
    assert way_mm[-1] == 4.0
    assert axis.position_mm == 0.0  # Looking ahead moves nothing.


@pytest.mark.parametrize("added_s", [0.013, 0.11, 0.19])
def test_a_block_that_is_fed_in_time_leaves_the_way_before_it_to_the_last_digit(added_s):
    whole, fed = Axis(200.0), Axis(200.0)
    for axis in (whole, fed):
        for target_mm in (0.3, 0.6, 0.9):
            axis.add(QueuedMove(target_mm, 3.0))
    whole.add(QueuedMove(1.2, 3.0))
    fed.advance(added_s)
    fed.add(QueuedMove(1.2, 3.0))
    times_s = np.linspace(added_s + 0.001, 0.5, 200).tolist()
    assert fed.positions_mm(times_s) == whole.positions_mm(times_s)
