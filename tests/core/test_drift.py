"""Cycles of use and the drift they show, on signals whose drift is known in closed form."""

import json

import numpy as np
import pytest

from softcal.core.operation.activity import CalibratedOperation, RestCurve, learn_operation
from softcal.core.operation.cycles import MAX_SAMPLES, Cycle, CycleSegmenter
from softcal.core.operation.method import DriftTracking
from softcal.core.operation.observation import (
    FOLLOWED,
    JUMPED,
    ON_HOLD,
    ON_TRIAL,
    OPERATION_OR_GAIN,
    PRELOAD_FELL,
    PRELOADED,
    Observation,
)
from softcal.core.operation.tracker import DriftTracker
from softcal.core.operation.uncertainty import REST_ELSEWHERE
from softcal.core.recording import Array, OutputRecording

RATE_HZ = 50.0
PERIOD_S = 4.0
CYCLE = DriftTracking().cycle


def presses(
    seconds: float, seed: int = 0, depth: float = 1.0, power: float = 2.0, scatter: float = 0.02, timing: float = 0.0
) -> Array:
    """Presses from a rest at 1 to about 2: `power` is their shape, depths differ by `scatter`, times by `timing`."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    count = int(1.5 * seconds / PERIOD_S) + 2
    depths = depth * (1 + scatter * rng.normal(size=count))
    starts_s = np.concatenate([[0.0], np.cumsum(PERIOD_S * (1 + timing * rng.normal(size=count)))])
    index = np.searchsorted(starts_s, t_s, side="right") - 1
    phase = (t_s - starts_s[index]) / np.diff(starts_s)[index]
    return np.asarray(1.0 + np.abs(np.sin(np.pi * phase)) ** power * depths[index] + 0.002 * rng.normal(size=len(t_s)))


def unlike_presses(seconds: float) -> Array:
    """Presses of two shapes in turn: no use that could be learnt."""
    count = round(seconds / PERIOD_S)
    return np.concatenate([presses(PERIOD_S, seed=k, power=8.0 if k % 2 else 0.4) for k in range(count)])


def calibrated_operation(output: Array | None = None, zero_output: float | None = None) -> CalibratedOperation:
    output = presses(120.0) if output is None else output
    return learn_operation(recorded(output), True, zero_output)


def recorded(output: Array) -> OutputRecording:
    return OutputRecording("A1", np.arange(len(output)) / RATE_HZ, output, RATE_HZ)


def cycles_of(output: Array, operation: CalibratedOperation, start_s: float = 0.0) -> list[Cycle]:
    segmenter = CycleSegmenter(operation.low, operation.high, operation.cycle_samples, operation.max_samples, CYCLE)
    t_s = start_s + np.arange(len(output)) / RATE_HZ
    cycles = []
    for k in range(0, len(output), 32):
        cycles += segmenter.advance(t_s[k : k + 32], output[k : k + 32])
    return cycles


def observe(
    tracker: DriftTracker, output: Array, operation: CalibratedOperation, start_s: float = 0.0
) -> list[Observation]:
    return [tracker.observe(cycle) for cycle in cycles_of(output, operation, start_s)]


def begun(
    calibration: Array | None = None, zero_output: float | None = None, operated_s: float = 0.0
) -> tuple[CalibratedOperation, DriftTracker]:
    """A calibrated use and its tracker, after so many seconds of that use without drift."""
    operation = calibrated_operation(calibration, zero_output)
    tracker = DriftTracker(operation)
    if operated_s:
        observe(tracker, presses(operated_s, seed=3), operation)
    return operation, tracker


def error_of(tracker: DriftTracker, gain: float, offset: float) -> float:
    """How far the correction is from the true one at rest and at the deepest press, in units of the output."""
    found_gain, found_offset = tracker.correction()
    ends = np.array([1.0, 2.0])
    return float(np.max(np.abs(found_gain * (gain * ends + offset) + found_offset - ends)))


def test_cycle_of_a_sine_has_the_moments_of_a_sine() -> None:
    output = 3.0 + 0.5 * np.sin(2 * np.pi * np.arange(4000) / 200)

    cycle = cycles_of(output, calibrated_operation(output))[2]

    assert cycle.level == pytest.approx(3.0, abs=0.005)
    assert cycle.scale == pytest.approx(0.5 / np.sqrt(2), rel=0.01)
    assert cycle.duration_s == pytest.approx(4.0, abs=0.05)
    assert cycle.speed == pytest.approx(2 * np.sin(np.pi * 14 / 200), rel=0.02)


def test_memory_of_a_cycle_does_not_grow_with_its_length() -> None:
    segmenter = CycleSegmenter(0.0, 1.0, 100, 10**9, CYCLE)

    for k in range(0, 100_000, 1000):
        segmenter.advance(np.arange(k, k + 1000) / RATE_HZ, np.full(1000, 0.5) + 1e-6 * np.arange(1000))

    assert len(segmenter.state()["samples"]) <= MAX_SAMPLES  # type: ignore[arg-type]


@pytest.mark.parametrize(("gain", "offset"), [(1.0, 0.08), (0.92, 0.0), (1.06, -0.1)])
def test_drift_that_comes_slowly_is_found(gain: float, offset: float) -> None:
    operation, tracker = begun()
    output = presses(1200.0, seed=1)
    share = np.minimum(1.0, np.arange(len(output)) / (0.7 * len(output)))

    observe(tracker, output * (1 + share * (gain - 1)) + share * offset, operation)

    assert error_of(tracker, gain, offset) < 0.015


def test_sensor_without_drift_is_left_alone() -> None:
    operation, tracker = begun(presses(200.0, scatter=0.2))

    observe(tracker, presses(1500.0, seed=5, scatter=0.2), operation)

    assert error_of(tracker, 1.0, 0.0) < 0.02


def test_another_shape_of_use_moves_nothing() -> None:
    operation, tracker = begun()

    observed = observe(tracker, presses(400.0, seed=2, power=0.4), operation)

    assert {observation.verdict for observation in observed[: DriftTracking().learning.cycles - 1]} == {ON_HOLD}
    assert tracker.correction() == pytest.approx((1.0, 0.0))


def test_deeper_presses_from_the_same_rest_are_use_and_not_drift() -> None:
    operation, tracker = begun(operated_s=200.0)

    observed = observe(tracker, presses(400.0, seed=4, depth=1.4), operation, 200.0)

    assert ON_HOLD in {one.verdict for one in observed} and tracker.alarm == ""
    assert error_of(tracker, 1.0, 0.0) < 0.02


def test_presses_of_a_person_that_slowly_grow_harder_are_not_taken_for_gain() -> None:
    operation, tracker = begun(presses(200.0, timing=0.04))
    output = presses(1200.0, seed=4, timing=0.04)
    grown = 1 + (output - 1) * np.linspace(1.0, 1.25, len(output))
    start = tracker.uncertainty_at(0.0).error_inflation

    observed = observe(tracker, grown, operation)

    assert error_of(tracker, 1.0, 0.0) < 0.02
    assert observed[-1].reason == OPERATION_OR_GAIN
    assert tracker.uncertainty_at(1200.0).error_inflation > start + 0.2


def test_weaker_presses_of_a_harder_use_do_not_drag_the_gain_after_it() -> None:
    """They lie within reach of the old use; its sensor has drifted, so that a gain would be believed."""
    operation, tracker = begun(presses(400.0, scatter=0.05, timing=0.04))
    before = presses(800.0, seed=4, scatter=0.05, timing=0.04)
    offset = np.linspace(0.0, 0.3, len(before))
    harder = presses(800.0, seed=5, scatter=0.05, timing=0.04, depth=1.3)

    observed = observe(tracker, np.concatenate([before + offset, harder + 0.3]), operation)

    assert ON_HOLD in {observation.verdict for observation in observed}
    assert error_of(tracker, 1.0, 0.3) < 0.05


def test_presses_of_a_machine_that_slowly_grow_larger_about_a_constant_rest_are_on_hold() -> None:
    """A programme that grows and a gain that rises are the same numbers there."""
    operation, tracker = begun()
    output = presses(1200.0, seed=4)
    gain = np.minimum(1.15, np.linspace(1.0, 1.25, len(output)))

    observed = observe(tracker, 1 + (output - 1) * gain, operation)

    assert error_of(tracker, 1.0, 0.0) < 0.03
    assert ON_HOLD in {one.verdict for one in observed}


def test_a_gain_of_a_use_that_a_machine_times_is_followed_where_the_rest_moved_with_it() -> None:
    operation, tracker = begun()
    output = presses(1200.0, seed=4)
    share = np.linspace(0.0, 1.0, len(output))

    observe(tracker, 1 + (output - 1) * (1 + 0.15 * share) + 0.2 * share, operation)

    assert error_of(tracker, 1.15, 1.2 - 1.15) < 0.05


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_presses_of_a_machine_that_grow_at_once_about_a_constant_rest_are_another_programme(share: float) -> None:
    """A tenth is less than what any jump of a person's use must be; the filter followed it as a gain."""
    operation, tracker = begun(presses(400.0, scatter=0.004), operated_s=0.0)
    output = presses(1200.0, seed=4, scatter=0.004)
    load = np.where(np.arange(len(output)) > len(output) // 2, share, 1.0)

    observed = observe(tracker, 1 + (output - 1) * load, operation)

    assert error_of(tracker, 1.0, 0.0) < 0.02
    assert ON_HOLD in {one.verdict for one in observed}


@pytest.mark.parametrize("curvature", [-0.5, 0.5])
@pytest.mark.parametrize("share", [0.6, 1.3, 1.6])
@pytest.mark.parametrize("rest", [0.0, 0.15])
def test_another_load_of_a_curved_sensor_that_turns_above_zero_load_is_operation(
    curvature: float, share: float, rest: float
) -> None:
    """Lag and creep keep it from zero load: its rest moves with the load, though the sensor does not."""

    def sensed(load: Array) -> Array:
        return 1.0 + (1 + 0.3 * curvature) * load - 0.5 * curvature * load**2 * 0.5

    levels = np.linspace(-0.5, 2.5, 300)
    curve = RestCurve(sensed(levels), levels)
    load = rest + (1 - rest) * (presses(400.0, timing=0.04) - 1.0)
    operation = learn_operation(recorded(sensed(load)), True, 1.0, curve=curve)
    tracker = DriftTracker(operation)
    later = rest + (1 - rest) * (presses(1600.0, seed=2, timing=0.04) - 1.0)

    observe(tracker, sensed(later * np.where(np.arange(len(later)) > len(later) // 2, share, 1.0)), operation)

    assert error_of(tracker, 1.0, 0.0) < 0.03


def test_loads_that_grow_slowly_from_a_preload_are_use_although_a_filter_lags() -> None:
    """Rest and size grow together there: seen with another lag each, they would read as a sensor that drifts."""
    rng = np.random.default_rng(3)
    rate_Hz = 10.0

    def strained(samples: int) -> Array:
        waves: list[Array] = []
        while sum(map(len, waves)) < samples:
            length, height = int(200 * (1 + 0.04 * rng.normal())), 1 + 0.04 * rng.normal()
            waves.append(0.2 + 0.8 * height * (1 - np.abs(2 * np.arange(length) / length - 1)))
        return np.concatenate(waves)[:samples]

    def sensed(load: Array) -> Array:
        return np.asarray(2.5 - 0.9 * load**0.7)

    def read(load: Array) -> OutputRecording:
        output = sensed(load) + 0.0036 * rng.normal(size=len(load))
        return OutputRecording("A1", np.arange(len(load)) / rate_Hz, output, rate_Hz)

    calibrated, later_load = strained(5000), strained(12_000) * np.linspace(1.0, 1.2, 12_000)
    levels = np.linspace(1.6, 0.0, 200)
    operation = learn_operation(read(calibrated), False, 2.5, curve=RestCurve(sensed(levels), levels))
    later = read(later_load)
    segmenter, tracker = (
        CycleSegmenter(operation.low, operation.high, operation.cycle_samples, operation.max_samples, CYCLE),
        DriftTracker(operation),
    )
    largest = 0.0
    for k in range(0, len(later), 32):
        for cycle in segmenter.advance(later.t_s[k : k + 32], later.output[k : k + 32]):
            tracker.observe(cycle)
            gain, offset = tracker.correction()
            ends = np.array([operation.low, operation.high])
            largest = max(largest, float(np.abs((gain - 1) * ends + offset).max()) / operation.scale)
    assert largest < 0.04


def test_pause_keeps_the_swing_that_cycles_are_cut_with() -> None:
    operation = calibrated_operation()
    walk = presses(100.0, seed=2)
    pause = 1.0 + 0.002 * np.random.default_rng(3).normal(size=3000)

    cycles = cycles_of(np.concatenate([walk, pause, walk]), operation)

    usual = [cycle for cycle in cycles if cycle.is_complete and cycle.scale > 0.2]
    assert len(cycles) - len(usual) <= 3
    assert sum(cycle.end_s > 165.0 for cycle in usual) >= 20


def test_cycles_are_found_again_after_values_far_beyond_them() -> None:
    operation = calibrated_operation()
    walk = presses(100.0, seed=2)
    fault = np.random.default_rng(3).choice([-20.0, 20.0], 1000)

    cycles = cycles_of(np.concatenate([walk, fault, walk]), operation)

    assert sum(cycle.is_complete and cycle.end_s > 130.0 and cycle.scale < 0.5 for cycle in cycles) >= 15


def test_reseated_sensor_is_followed_after_the_stated_cycles() -> None:
    operation, tracker = begun(operated_s=200.0)

    observed = observe(tracker, 0.95 * presses(200.0, seed=6) + 0.25, operation, 200.0)

    first = next(k for k, observation in enumerate(observed) if observation.verdict == JUMPED)
    assert first <= DriftTracking().jump.cycles
    assert error_of(tracker, 0.95, 0.25) < 0.02


def test_rest_that_moved_is_followed_after_one_cycle_and_the_gain_after_two() -> None:
    operation, tracker = begun(zero_output=1.0, operated_s=200.0)
    # The sensor is re-seated in the midst of a press.
    output = np.concatenate([presses(90.0, seed=5), 0.95 * presses(110.0, seed=5)[4500:] + 0.25])

    observed = []
    for cycle in cycles_of(output, operation, 200.0):
        observed.append(tracker.observe(cycle))
        if observed[-1].verdict == ON_TRIAL:
            break

    assert observed[-1].t_s - 200.0 - 90.0 < 1.5 * PERIOD_S
    assert error_of(tracker, 1.0, 0.20) < 0.02
    assert tracker.is_unsettled


def test_second_cycle_that_contradicts_the_first_rolls_it_back() -> None:
    operation, tracker = begun(zero_output=1.0, operated_s=200.0)
    before = tracker.correction()
    (lifted,) = cycles_of(presses(10.0, seed=6) + 0.2, operation, 200.0)[:1]
    (usual,) = cycles_of(presses(10.0, seed=7), operation, 210.0)[:1]

    assert tracker.observe(lifted).verdict == ON_TRIAL
    assert tracker.correction() != before
    assert tracker.observe(usual).verdict == FOLLOWED

    assert tracker.correction() == pytest.approx(before, abs=0.005)
    assert not tracker.is_unsettled


def test_turning_point_above_zero_load_is_not_followed_after_one_cycle() -> None:
    """A use that is preloaded moves it when it grows; two cycles tell whether the output at zero load moved as well."""
    operation, tracker = begun(zero_output=0.8, operated_s=200.0)
    before = tracker.correction()
    (lifted,) = cycles_of(presses(10.0, seed=6) + 0.2, operation, 200.0)[:1]

    assert tracker.observe(lifted).verdict == ON_HOLD
    assert tracker.correction() == pytest.approx(before, abs=1e-9)


def test_one_cycle_moves_the_map_no_longer_than_the_next_one_is_due() -> None:
    operation, tracker = begun(zero_output=1.0, operated_s=200.0)
    before = tracker.correction()
    (lifted,) = cycles_of(presses(10.0, seed=6) + 0.2, operation, 200.0)[:1]
    tracker.observe(lifted)

    tracker.expire(lifted.end_s + PERIOD_S)
    assert tracker.correction() != before
    tracker.expire(lifted.end_s + 2 * PERIOD_S)
    assert tracker.correction() == before


def test_gain_known_before_a_reseating_is_known_after_it() -> None:
    operation, tracker = begun(presses(200.0, timing=0.04))
    output = presses(1200.0, seed=4, timing=0.04)
    share = np.minimum(1.0, np.arange(len(output)) / (0.7 * len(output)))
    drifted = output * (1 - 0.08 * share) + 0.25 * share
    after_reseating = presses(40.0, seed=6, timing=0.04) * 0.92 + 0.45

    for cycle in cycles_of(np.concatenate([drifted, after_reseating]), operation):
        if tracker.observe(cycle).verdict == JUMPED:
            break

    assert cycle.end_s < 1200.0 + 4 * PERIOD_S
    assert error_of(tracker, 0.92, 0.45) < 0.03


def test_reseating_does_not_vouch_for_a_gain_that_comes_later() -> None:
    operation, tracker = begun(presses(200.0, timing=0.04))
    output = 0.95 * presses(1600.0, seed=4, timing=0.04) + 0.25
    rest = 0.95 + 0.25
    grown = rest + (output - rest) * np.linspace(1.0, 1.25, len(output))

    observed = observe(tracker, np.concatenate([presses(100.0, seed=9, timing=0.04), grown]), operation)

    assert JUMPED in {observation.verdict for observation in observed}
    assert error_of(tracker, 0.95, 0.25) < 0.06


def test_a_preload_that_is_taken_off_is_no_new_seat() -> None:
    """The rest goes to where no load is, and cycles grow by as much: a sensor that moved would look the same."""
    preloaded = 1.15 + 0.85 * (presses(240.0) - 1.0)
    operation, tracker = begun(preloaded, zero_output=1.0)
    observe(tracker, 1.15 + 0.85 * (presses(200.0, seed=3) - 1.0), operation)

    observed = observe(tracker, presses(60.0, seed=4), operation, 200.0)

    assert PRELOAD_FELL in {one.reason for one in observed}
    assert error_of(tracker, 1.0, 0.0) < 0.01


def test_a_preloaded_sensor_that_steps_back_half_way_is_followed_back() -> None:
    """What takes back a correction cannot make an estimate worse than none, be it a preload or the sensor."""
    preloaded = 1.2 + 0.8 * (presses(240.0) - 1.0)
    operation, tracker = begun(preloaded, zero_output=1.0)

    def stepped(by: float, seed: int) -> Array:
        return 1.2 + 0.8 * (presses(100.0, seed=seed) - 1.0) + by

    observe(tracker, stepped(0.0, 3), operation)
    observe(tracker, stepped(0.25, 4), operation, 100.0)
    assert error_of(tracker, 1.0, 0.25) < 0.02
    observe(tracker, stepped(0.1, 5), operation, 200.0)

    assert error_of(tracker, 1.0, 0.1) < 0.02


def test_jump_beyond_the_trust_region_is_held_and_alarmed() -> None:
    operation, tracker = begun(operated_s=100.0)

    observed = observe(tracker, presses(100.0, seed=6) + 2.0, operation, 100.0)

    assert observed[-1].verdict == ON_HOLD
    assert tracker.alarm
    assert tracker.correction() == pytest.approx((1.0, 0.0))


def test_use_that_is_new_is_learnt_and_its_drift_followed() -> None:
    operation, tracker = begun()
    output = presses(1600.0, seed=8, power=0.4)
    offset = np.interp(np.arange(len(output)), [0.3 * len(output), 0.9 * len(output)], [0.0, 0.2])

    observed = observe(tracker, output + offset, operation)

    assert ON_HOLD in {observation.verdict for observation in observed} and observed[-1].verdict == FOLLOWED
    assert error_of(tracker, 1.0, 0.2) < 0.05


def test_return_of_the_calibrated_use_overrules_what_was_learnt_meanwhile() -> None:
    operation, tracker = begun()
    observe(tracker, presses(400.0, seed=8, power=0.4) + 0.12, operation)

    observe(tracker, presses(800.0, seed=9) + 0.12, operation, 400.0)

    assert error_of(tracker, 1.0, 0.12) < 0.02


def test_recording_without_cycles_says_so() -> None:
    ramp = np.concatenate([np.linspace(0, 1, 3000), np.linspace(1, 0, 3000)])
    ramp += 0.001 * np.random.default_rng(0).normal(size=6000)

    learning = calibrated_operation(ramp).learning

    assert learning.activity is None and learning.reason


def test_uncertainty_grows_while_nothing_is_observed() -> None:
    operation, tracker = begun(operated_s=200.0)

    inflations = [tracker.uncertainty_at(t_s).interval_inflation for t_s in (200.0, 1000.0, 10_000.0)]

    assert inflations[0] < inflations[1] < inflations[2]


def test_a_drift_that_came_in_use_nobody_compared_is_not_sure() -> None:
    operation, tracker = begun(operated_s=400.0)
    observed = observe(tracker, unlike_presses(300.0), operation, 400.0)
    assert {one.verdict for one in observed[1:]} == {ON_HOLD}
    assert observed[0].shift_sd < 0.1
    assert observed[-1].shift_sd > DriftTracking().drift.unobserved


def test_predicted_error_grows_with_use_that_says_nothing() -> None:
    operation, tracker = begun(operated_s=200.0)
    inflations = [tracker.uncertainty_at(200.0).error_inflation]

    for start_s in (200.0, 240.0):
        observe(tracker, unlike_presses(40.0), operation, start_s)
        inflations.append(tracker.uncertainty_at(start_s + 40.0).error_inflation)

    assert inflations[0] < inflations[1] < inflations[2]
    observe(tracker, presses(40.0, seed=7), operation, 280.0)
    assert tracker.uncertainty_at(320.0).error_inflation < inflations[1]


def test_state_goes_through_json_and_back() -> None:
    operation = calibrated_operation()
    tracker, other = DriftTracker(operation), DriftTracker(operation)
    observe(tracker, presses(300.0, seed=8, power=0.4), operation)

    other.restore(json.loads(json.dumps(tracker.state())))

    later = presses(300.0, seed=9) + 0.1
    assert observe(other, later, operation, 300.0) == observe(tracker, later, operation, 300.0)


def test_cycles_twice_as_long_as_the_usual_wait_are_found() -> None:
    """The swing was taken anew after each wait, and a cycle that lasts longer than one was never seen whole."""
    operation = calibrated_operation()
    slow = np.interp(np.arange(60_000) / 3.5, np.arange(60_000), 1.0 + 0.45 * (presses(1200.0, seed=2) - 1.0))

    cycles = cycles_of(slow, operation)

    assert sum(cycle.is_complete for cycle in cycles) > 0.7 * len(slow) / (3.5 * PERIOD_S * RATE_HZ)


def test_slow_drift_is_followed_no_further_behind_than_its_cycles_scatter() -> None:
    """A mean over ten cycles does not show it beyond chance, one over thirty does."""
    operation = calibrated_operation(presses(400.0, scatter=0.08, timing=0.04))
    behind = []
    for seed in range(3):
        tracker = DriftTracker(operation)
        output = presses(600.0, seed=seed, scatter=0.08, timing=0.04)
        gain = np.interp(np.arange(len(output)) / RATE_HZ, [200.0, 600.0], [1.0, 0.75])
        observed = observe(tracker, 1 + (output - 1) * gain, operation)
        behind.append(observed[-1].log_gain - np.log(0.75))

    assert np.mean(behind) < 0.05


@pytest.mark.parametrize(("lifted", "is_reported"), [(0.0, False), (0.2, True), (-0.2, True)])
def test_new_use_that_rests_elsewhere_counts_until_a_known_one_is_seen(lifted: float, is_reported: bool) -> None:
    operation, tracker = begun(zero_output=1.0, operated_s=200.0)

    # A re-seating in the moment in which the use changes: taken for a part of the new use, it was never told.
    observe(tracker, presses(400.0, seed=8, power=6.0) + lifted, operation, 200.0)

    assert (tracker.uncertainty_at(600.0).ambiguous[REST_ELSEWHERE] > 0) == is_reported
    observe(tracker, presses(200.0, seed=9), operation, 600.0)
    assert tracker.uncertainty_at(800.0).ambiguous[REST_ELSEWHERE] == 0.0


@pytest.mark.parametrize(("zero_output", "is_ambiguous"), [(1.0, False), (0.8, True), (None, True)])
def test_correction_that_a_preload_would_have_asked_for_as_well_is_said_to_be(
    zero_output: float | None, is_ambiguous: bool
) -> None:
    operation, tracker = begun(presses(400.0, timing=0.04), zero_output=zero_output)
    output = presses(800.0, seed=4, timing=0.04)

    observed = observe(tracker, output + np.linspace(0.0, 0.2, len(output)), operation)

    assert any(one.reason == PRELOADED for one in observed) == is_ambiguous


@pytest.mark.parametrize(("calibrated_s", "is_imposed"), [(120.0, False), (600.0, True)])
def test_few_equal_durations_of_a_learnt_use_do_not_show_a_machine(calibrated_s: float, is_imposed: bool) -> None:
    """A quarter of the calibration's length is learnt from: seven presses, or thirty-seven."""
    operation, tracker = begun(presses(calibrated_s))

    observe(tracker, presses(0.4 * calibrated_s, seed=8, power=6.0), operation)

    calibrated, learnt = tracker._now.activities
    assert calibrated.is_imposed
    assert learnt.is_imposed == is_imposed


def test_a_drift_that_may_be_chance_does_not_become_sure_when_another_use_is_learnt() -> None:
    operation, tracker = begun(presses(240.0, scatter=0.1, timing=0.04), zero_output=1.0)
    other = {"power": 0.6, "depth": 1.2, "scatter": 0.1, "timing": 0.04}
    observe(tracker, presses(100.0, seed=3, scatter=0.1, timing=0.04), operation)
    observe(tracker, presses(52.0, seed=5, **other), operation, 100.0)
    observe(tracker, presses(10.0, seed=6, scatter=0.1, timing=0.04) - 0.02, operation, 152.0)
    assert tracker.correction() == (1.0, 0.0)

    observed = observe(tracker, presses(400.0, seed=7, **other), operation, 162.0)

    assert observed[-1].verdict == FOLLOWED
    assert tracker.correction() == (1.0, 0.0)
