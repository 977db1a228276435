"""The sensor read at rest under a weight: nothing is told to the stage; what is read is the unit under that load."""

import numpy as np
import pytest

from softcal.core.errors import CommandRefused, NoReply
from softcal.core.simulated_lot import draw_lot
from softcal.station.bench.bench import open_simulated_bench
from softcal.station.interfaces import Move
from softcal.station.tasks.at_rest import read_at_rest

SETTLE_S, READING_S = 2.0, 3.0


@pytest.fixture
def rig():
    """A homed bench and the simulated station behind it."""
    (unit,) = draw_lot(np.random.default_rng(3), 1)
    with open_simulated_bench(unit, 3) as (bench, station):
        bench.stage.home()
        yield bench, station


@pytest.mark.parametrize("weight_N", [0.0, 0.5, 2.0])
def test_a_weight_is_read_while_nothing_moves(rig, weight_N):
    bench, station = rig
    before_mm, reports, readings = station.axis.position_mm, [], []
    bench.stage.begin = reports.append
    bench.stage.home = lambda *_: reports.append("home")
    station.rig.weight_N = weight_N
    reading = read_at_rest(
        bench, "A1", SETTLE_S, READING_S, lambda fractions, remaining_s: readings.append((fractions, remaining_s))
    )
    bears_N = np.mean([station.rig.read(station.world.now_s() + k * 0.02)[0] for k in range(20)])
    assert (reports, station.axis.position_mm) == ([], before_mm)
    assert bears_N == pytest.approx(weight_N, abs=0.05), "the unit does not bear the weight"
    assert len(reading.output) == pytest.approx(READING_S * bench.readout.rate_Hz, rel=0.1)
    assert np.std(reading.output) < 0.01 and reading.output_unit == bench.readout.unit
    fractions, remaining_s = zip(*readings, strict=True)
    assert list(fractions) == sorted(fractions) and list(remaining_s) == sorted(remaining_s, reverse=True)


def test_heavier_is_further_from_the_output_without_a_load(rig):
    (bench, station), levels = rig, []
    for weight_N in (0.0, 1.0, 2.0):
        station.rig.weight_N = weight_N
        levels.append(float(np.mean(read_at_rest(bench, "A1", SETTLE_S, READING_S, lambda *_: None).output)))
    steps = np.diff(levels)
    assert np.all(steps > 0) or np.all(steps < 0)


def test_a_readout_that_falls_silent_ends_the_reading(rig):
    bench, station = rig
    with pytest.raises(NoReply):
        read_at_rest(bench, "A1", SETTLE_S, READING_S, lambda done, _: done > 0.5 and station.readout_wire.unplug())


def test_a_stage_that_moves_is_not_read_under(rig):
    bench, _ = rig
    bench.stage.begin(Move(2.0, 0.5))
    with pytest.raises(CommandRefused):
        read_at_rest(bench, "A1", SETTLE_S, READING_S, lambda *_: None)
