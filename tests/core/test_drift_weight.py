"""How far cycles of the same use are believed to show the sensor: what the calibration and their course say."""

import json
from itertools import pairwise

import numpy as np
import pytest

from softcal.core.operation.activity import CalibratedOperation, learn_operation
from softcal.core.operation.cycles import CycleSegmenter
from softcal.core.operation.method import DriftTracking
from softcal.core.operation.observation import FOLLOWED, ON_HOLD
from softcal.core.operation.tracker import DriftTracker
from softcal.core.recording import Array, OutputRecording

RATE_HZ, PERIOD_S, CALIBRATED_S, OPERATED_S = 50.0, 4.0, 200.0, 800.0
GAIN = 1.2
"""Of the output about a rest at 1 V, at the end of the operation."""


def load(seconds: float, seed: int, timing: float = 0.0, is_reversed: bool = False) -> Array:
    """(n,) presses of about 1 from rest, that rise in a quarter of the time in which they fall, or the other way."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    count = int(1.5 * seconds / PERIOD_S) + 2
    ends_s = np.concatenate([[0.0], np.cumsum(PERIOD_S * (1 + timing * rng.normal(size=count)))])
    index = np.searchsorted(ends_s, t_s, side="right") - 1
    phase = (t_s - ends_s[index]) / np.diff(ends_s)[index]
    heights = (1 + 0.01 * rng.normal(size=count))[index]
    phase = 1 - phase if is_reversed else phase
    return np.asarray(heights * np.interp(phase, [0.0, 0.2, 0.36, 1.0], [0.0, 0.0, 1.0, 0.0]))


def read(loads: Array, gain: Array | float, seed: int) -> Array:
    """(n,) output in V; its gain turns about the rest."""
    return np.asarray(1.0 + gain * loads + 0.003 * np.random.default_rng(seed).normal(size=len(loads)))


def calibrated_operation(ageing: float, timing: float = 0.0) -> CalibratedOperation:
    """A use learnt from a calibration over which the gain aged by a share."""
    loads = load(CALIBRATED_S, 1, timing)
    output = read(loads, np.linspace(1.0, 1.0 + ageing, len(loads)), 2)
    return learn_operation(OutputRecording("A1", np.arange(len(output)) / RATE_HZ, output, RATE_HZ), True, 1.0)


def operate(tracker: DriftTracker, operation: CalibratedOperation, output: Array) -> list[str]:
    """Return the verdicts of an output's cycles."""
    segmenter, verdicts = (
        CycleSegmenter(
            operation.low, operation.high, operation.cycle_samples, operation.max_samples, DriftTracking().cycle
        ),
        [],
    )
    t_s = np.arange(len(output)) / RATE_HZ
    for start in range(0, len(output), 32):
        piece = slice(start, start + 32)
        verdicts += [tracker.observe(cycle).verdict for cycle in segmenter.advance(t_s[piece], output[piece])]
    return verdicts


def corrected_top(tracker: DriftTracker) -> float:
    """Return where the correction takes the top of an aged press: 2 V without ageing."""
    gain, offset = tracker.correction()
    return gain * (1.0 + GAIN) + offset


def grown(timing: float = 0.0, is_reversed: bool = False) -> Array:
    """(n,) output of an operation over which the output grows about a rest that stands."""
    loads = load(OPERATED_S, 3, timing, is_reversed)
    return read(loads, np.minimum(GAIN, np.linspace(1.05, 1.1 * GAIN, len(loads))), 4)


def test_a_gain_about_a_constant_rest_is_followed_where_it_aged_under_the_calibration() -> None:
    operation = calibrated_operation(ageing=0.06)
    tracker = DriftTracker(operation)

    verdicts = operate(tracker, operation, grown())

    assert corrected_top(tracker) == pytest.approx(2.0, abs=0.06)
    assert verdicts[-1] == FOLLOWED


@pytest.mark.parametrize("ageing", [0.0, 0.002])
def test_the_same_growth_after_a_calibration_that_stood_is_use_as_well(ageing: float) -> None:
    operation = calibrated_operation(ageing)
    tracker = DriftTracker(operation)

    verdicts = operate(tracker, operation, grown())

    assert corrected_top(tracker) == pytest.approx(1.0 + GAIN, abs=0.03)
    assert ON_HOLD in verdicts


def test_the_belief_grows_with_the_ageing_under_the_calibration_and_not_by_a_threshold() -> None:
    tops = []
    for ageing in (0.0, 0.025, 0.035, 0.05, 0.08):
        operation = calibrated_operation(ageing)
        tracker = DriftTracker(operation)
        operate(tracker, operation, grown())
        tops.append(corrected_top(tracker))

    assert all(less <= more + 0.01 for more, less in pairwise(tops))
    assert max(more - less for more, less in pairwise(tops)) < 0.7 * (tops[0] - tops[-1])


def test_a_person_who_presses_harder_is_not_believed_to_be_a_sensor_that_ages() -> None:
    operation = calibrated_operation(ageing=0.06, timing=0.04)
    tracker = DriftTracker(operation)

    operate(tracker, operation, grown(timing=0.04))

    assert corrected_top(tracker) == pytest.approx(1.0 + GAIN, abs=0.03)


def test_cycles_that_fall_as_the_calibrated_ones_rose_are_another_use() -> None:
    """Levels, their shares of the time, speed and duration are those of the calibration; their order is not."""
    operation = calibrated_operation(ageing=0.06)
    same, turned = DriftTracker(operation), DriftTracker(operation)

    operate(same, operation, grown())
    operate(turned, operation, grown(is_reversed=True))

    assert 1.0 + GAIN - corrected_top(turned) < 0.3 * (1.0 + GAIN - corrected_top(same))


def test_the_state_of_what_is_believed_goes_through_json_and_back() -> None:
    operation = calibrated_operation(ageing=0.06)
    tracker, other = DriftTracker(operation), DriftTracker(operation)
    operate(tracker, operation, grown())

    other.restore(json.loads(json.dumps(tracker.state())))

    assert other.correction() == tracker.correction() != (1.0, 0.0)
