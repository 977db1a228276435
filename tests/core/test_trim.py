"""Two known loads at the place of use: what they mend, and what is refused."""

from dataclasses import fields

import numpy as np
import pytest

from softcal.core.errors import InputError
from softcal.core.maps.affine import AffineMap
from softcal.core.maps.anchors import AnchoredMap, source_level
from softcal.core.maps.interface import Anchors, FitProblem
from softcal.core.metrics import rmse
from softcal.core.unit.method import LEVELS
from softcal.core.unit.uncertainty import Interval
from softcal.core.use.trim import trim
from softcal.core.windows import resting

GAIN, OFFSET_V = 1.12, 0.03


@pytest.fixture
def problem(press, linear_network) -> FitProblem:  # type: ignore[no-untyped-def]
    unit = press(5, gain=GAIN, offset_V=OFFSET_V)
    return FitProblem(press(1, serial="S0", seconds=120.0), linear_network, unit.unlabelled)


def output_V(load_N: float) -> float:
    return OFFSET_V + GAIN * (0.5 + 0.1 * load_N)


def loads(*load_N: float) -> Anchors:
    return Anchors(np.array([output_V(load) for load in load_N]), np.array(load_N))


def test_two_loads_mend_gain_and_zero(problem: FitProblem, press, linear_network) -> None:  # type: ignore[no-untyped-def]
    found = trim(problem, AffineMap(1.0, 0.0), loads(0.0, 2.5))
    test = press(6, gain=GAIN, offset_V=OFFSET_V)
    error = rmse(linear_network.evaluate(found.unit_map.apply(test.windows)), test.window_reference)
    assert found.after_rmse < 0.1 * found.before_rmse
    # The noise alone is 0.02 N; the map as it was reads 0.9 N wrong.
    assert error < 0.06


def test_a_second_trim_replaces_the_first_in_one_gain_and_offset(problem: FitProblem) -> None:
    first = trim(problem, AffineMap(1.0, 0.0), loads(0.0, 2.5)).unit_map
    second = trim(problem, first, loads(0.5, 2.0)).unit_map
    assert isinstance(second, AnchoredMap) and not isinstance(second.inner, AnchoredMap)
    windows = np.full((1, 15), output_V(1.7))
    assert problem.network.evaluate(second.apply(windows))[0] == pytest.approx(1.7, abs=0.05)


@pytest.mark.parametrize(
    "given",
    [
        loads(1.0),
        loads(1.0, 1.0),
        loads(0.0, 2.5, 2.5),
        Anchors(loads(0.0, 2.5).output, np.array([0.0, 2500.0])),
        Anchors(loads(0.0, 2.5).output[::-1], np.array([0.0, 2.5])),
        Anchors(np.array([0.0, 2.5]), loads(0.0, 2.5).output),
        Anchors(1e3 * loads(0.0, 2.5).output, np.array([0.0, 2.5])),
    ],
)
def test_loads_that_cannot_be_of_this_unit_are_refused_in_one_line(problem: FitProblem, given: Anchors) -> None:
    with pytest.raises(InputError) as refused:
        trim(problem, AffineMap(1.0, 0.0), given)
    assert "\n" not in str(refused.value)


def test_what_a_trim_leaves_open_is_the_spread_of_trims_by_loads_that_are_known_so_well(  # type: ignore[no-untyped-def]
    problem: FitProblem, press, linear_network
) -> None:
    """Loads that are wrong by what the method takes them to be known to: estimates scatter as the trim said."""
    rng, map_before = np.random.default_rng(2), AffineMap(1.0, 0.0)
    given = loads(0.3, 2.2)
    told = trim(problem, map_before, given)
    interval = Interval(  # type: ignore[call-arg]
        **{**{f.name: None for f in fields(Interval)}, "low": 0.0, "high": 3.0, "half_width": np.zeros((3, LEVELS))}
    )
    said = np.sqrt(told.variance(interval, problem.source))
    levels = 3.0 * (np.arange(LEVELS) + 0.5) / LEVELS
    windows = resting(np.array([output_V(level) for level in levels]))
    # In the source's output the sigma of a load; 0.1 V is a newton there.
    sigma_N = [10.0 * source_level(problem.source, load, problem.config.anchors)[1] for load in given.reference]
    found = []
    for _ in range(300):
        wrong = Anchors(given.output, given.reference + rng.normal(0, sigma_N, 2))
        found.append(linear_network.evaluate(trim(problem, map_before, wrong).unit_map.apply(windows)))
    spread = np.std(found, axis=0)
    # What is said holds the prior of the map as well as the loads.
    assert np.all(said > 0.85 * spread)
    assert np.all(said < 1.5 * spread)
