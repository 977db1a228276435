"""Two known loads at the place of use: what they mend, and what is refused."""

from collections.abc import Callable
from dataclasses import fields

import numpy as np
import pytest

from softcal.core.errors import InputError
from softcal.core.maps.affine_map import AffineMap
from softcal.core.maps.anchors import AnchoredMap
from softcal.core.maps.interface import Anchors, FitProblem
from softcal.core.metrics import rmse
from softcal.core.network.network import Network
from softcal.core.recording import LabelledRecording
from softcal.core.unit.adjustments import Trim
from softcal.core.unit.method import LEVELS
from softcal.core.unit.trim import trim
from softcal.core.unit.uncertainty import Interval
from softcal.core.windows import resting

GAIN, OFFSET_V, BAND_N = 1.12, 0.03, 0.08

Press = Callable[..., LabelledRecording]


@pytest.fixture
def problem(press: Press, linear_network: Network) -> FitProblem:
    unit = press(5, gain=GAIN, offset_V=OFFSET_V)
    return FitProblem(press(1, serial="S0", seconds=120.0), linear_network, unit.unlabelled)


def output_V(load_N: float) -> float:
    return OFFSET_V + GAIN * (0.5 + 0.1 * load_N)


def interval() -> Interval:
    """The interval of estimates before the trim: the same for every load and direction."""
    table = {"low": 0.0, "high": 3.0, "half_width": np.full((3, LEVELS), BAND_N)}
    return Interval(**{**{f.name: None for f in fields(Interval)}, **table})  # type: ignore[arg-type]


def loads(*load_N: float) -> Anchors:
    return Anchors(np.array([output_V(load) for load in load_N]), np.array(load_N))


def behind(trimmed: Trim) -> AnchoredMap:
    """The map of these tests with the line of a trim behind it."""
    return AnchoredMap(AffineMap(1.0, 0.0), trimmed.gain, trimmed.offset)


def test_two_loads_mend_gain_and_zero(problem: FitProblem, press: Press, linear_network: Network) -> None:
    result = trim(problem, AffineMap(1.0, 0.0), interval(), loads(0.0, 2.5))
    test = press(6, gain=GAIN, offset_V=OFFSET_V)
    error = rmse(linear_network.evaluate(behind(result).apply(test.windows)), test.window_reference)
    assert result.after_rmse < 0.1 * result.before_rmse
    # The noise alone is 0.02 N; the map as it was reads 0.9 N wrong.
    assert error < 0.06


@pytest.mark.parametrize(
    "anchors",
    [
        loads(1.0),
        loads(1.0, 1.1),
        Anchors(np.array([1.2, 1.2001]), np.array([0.0, 2.5])),
        loads(1.0, 1.0),
        loads(0.0, 2.5, 2.5),
        Anchors(loads(0.0, 2.5).output, np.array([0.0, 2500.0])),
        Anchors(loads(0.0, 2.5).output[::-1], np.array([0.0, 2.5])),
        Anchors(np.array([0.0, 2.5]), loads(0.0, 2.5).output),
        Anchors(1e3 * loads(0.0, 2.5).output, np.array([0.0, 2.5])),
    ],
)
def test_loads_that_cannot_be_of_this_unit_are_refused_in_one_line(problem: FitProblem, anchors: Anchors) -> None:
    with pytest.raises(InputError) as refused:
        trim(problem, AffineMap(1.0, 0.0), interval(), anchors)
    assert "\n" not in str(refused.value)


def test_the_rows_of_a_load_that_is_stated_twice_are_named_in_whatever_order_they_stand(problem: FitProblem) -> None:
    anchors = loads(2.5, 0.0, 2.5)
    with pytest.raises(InputError, match="loads 1 and 3"):
        trim(problem, AffineMap(1.0, 0.0), interval(), anchors)


def test_loads_the_map_reads_already_are_refused(problem: FitProblem) -> None:
    """What a trim corrects must be more than what it is known to."""
    result = trim(problem, AffineMap(1.0, 0.0), interval(), loads(0.0, 2.5))
    with pytest.raises(InputError):
        trim(problem, behind(result), interval(), loads(0.2, 2.0))


def test_loads_that_contradict_one_another_are_refused(problem: FitProblem) -> None:
    anchors = loads(0.0, 1.0, 2.5)
    trim(problem, AffineMap(1.0, 0.0), interval(), anchors)
    bent = Anchors(anchors.output + np.array([0.0, 0.03, 0.0]), anchors.reference)
    with pytest.raises(InputError):
        trim(problem, AffineMap(1.0, 0.0), interval(), bent)


def test_what_a_trim_leaves_open_is_the_spread_of_trims_by_loads_that_are_known_so_well(
    problem: FitProblem, linear_network: Network
) -> None:
    """Loads that are wrong by what the method takes them to be known to: estimates scatter as the trim said."""
    rng, map_before = np.random.default_rng(2), AffineMap(1.0, 0.0)
    anchors = loads(0.3, 2.2)
    result = trim(problem, map_before, interval(), anchors)
    predicted_sd = np.sqrt(result.variance(interval()))
    levels = 3.0 * (np.arange(LEVELS) + 0.5) / LEVELS
    windows = resting(np.array([output_V(level) for level in levels]))
    # The calibration's own 90 % band is what is not known of a reading; the load itself is known ten times better.
    trims = []
    for _ in range(300):
        wrong = Anchors(anchors.output, anchors.reference + rng.normal(0, BAND_N / 1.645, 2))
        trims.append(linear_network.evaluate(behind(trim(problem, map_before, interval(), wrong)).apply(windows)))
    spread = np.std(trims, axis=0)
    assert np.all(np.abs(predicted_sd / spread - 1) < 0.15)
