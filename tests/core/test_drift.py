"""Cycles of use and the drift they show, on signals whose drift is known in closed form."""

import json

import numpy as np
import pytest

from softcal.core.adapt_activity import CalibratedUse, learn_use
from softcal.core.adapt_cycle import KEPT, Cycle, CycleCutter
from softcal.core.drift import FOLLOWED, HELD, JUMP_CYCLES, JUMPED, DriftTracker, Observation
from softcal.core.recording import Array, OutputRecording

RATE_HZ = 50.0
PERIOD_S = 4.0


def presses(seconds: float, seed: int = 0, depth: float = 1.0, power: float = 2.0, scatter: float = 0.02) -> Array:
    """Presses from a rest at 1 to about 2; `power` sets the shape, `scatter` how depths differ."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    depths = depth * (1 + scatter * rng.normal(size=int(seconds / PERIOD_S) + 1))
    wave = np.abs(np.sin(np.pi * t_s / PERIOD_S)) ** power * depths[(t_s / PERIOD_S).astype(int)]
    return np.asarray(1.0 + wave + 0.002 * rng.normal(size=len(t_s)))


def calibrated_use(output: Array | None = None) -> CalibratedUse:
    output = presses(120.0) if output is None else output
    return learn_use(OutputRecording("A1", np.arange(len(output)) / RATE_HZ, output, RATE_HZ), rest_is_low=True)


def cycles_of(output: Array, use: CalibratedUse, start_s: float = 0.0) -> list[Cycle]:
    cutter = CycleCutter(use.low, use.high, use.usual, use.longest)
    t_s = start_s + np.arange(len(output)) / RATE_HZ
    found = []
    for k in range(0, len(output), 32):
        found += cutter.advance(t_s[k : k + 32], output[k : k + 32])
    return found


def observe(tracker: DriftTracker, output: Array, use: CalibratedUse, start_s: float = 0.0) -> list[Observation]:
    return [tracker.observe(cycle) for cycle in cycles_of(output, use, start_s)]


def error_of(tracker: DriftTracker, gain: float, offset: float) -> float:
    """How far the correction is from the true one at rest and at the deepest press, in units of the output."""
    found_gain, found_offset = tracker.correction()
    ends = np.array([1.0, 2.0])
    return float(np.max(np.abs(found_gain * (gain * ends + offset) + found_offset - ends)))


def test_cycle_of_a_sine_has_the_moments_of_a_sine() -> None:
    output = 3.0 + 0.5 * np.sin(2 * np.pi * np.arange(4000) / 200)

    cycle = cycles_of(output, calibrated_use(output))[2]

    assert cycle.level == pytest.approx(3.0, abs=0.005)
    assert cycle.scale == pytest.approx(0.5 / np.sqrt(2), rel=0.01)
    assert cycle.duration_s == pytest.approx(4.0, abs=0.05)
    assert cycle.speed == pytest.approx(2 * np.sin(np.pi * 14 / 200), rel=0.02)


def test_memory_of_a_cycle_does_not_grow_with_its_length() -> None:
    cutter = CycleCutter(0.0, 1.0, 100, 10**9)

    for k in range(0, 100_000, 1000):
        cutter.advance(np.arange(k, k + 1000) / RATE_HZ, np.full(1000, 0.5) + 1e-6 * np.arange(1000))

    assert len(cutter.state()["kept"]) <= KEPT  # type: ignore[arg-type]


@pytest.mark.parametrize(("gain", "offset"), [(1.0, 0.08), (0.92, 0.0), (1.06, -0.1)])
def test_drift_that_comes_slowly_is_found(gain: float, offset: float) -> None:
    use = calibrated_use()
    tracker = DriftTracker(use, is_improved=False)
    output = presses(1200.0, seed=1)
    share = np.minimum(1.0, np.arange(len(output)) / (0.7 * len(output)))

    observe(tracker, output * (1 + share * (gain - 1)) + share * offset, use)

    assert error_of(tracker, gain, offset) < 0.015


def test_sensor_without_drift_is_left_alone() -> None:
    use = calibrated_use(presses(200.0, scatter=0.2))
    tracker = DriftTracker(use, is_improved=True)

    observe(tracker, presses(1500.0, seed=5, scatter=0.2), use)

    assert error_of(tracker, 1.0, 0.0) < 0.02


def test_another_shape_of_use_moves_nothing() -> None:
    use = calibrated_use()
    tracker = DriftTracker(use, is_improved=False)

    seen = observe(tracker, presses(400.0, seed=2, power=0.4), use)

    assert {observation.verdict for observation in seen} == {HELD}
    assert "use is not that of the calibration" in seen[-1].reason
    assert tracker.correction() == pytest.approx((1.0, 0.0))


def test_deeper_presses_from_the_same_rest_are_use_and_not_drift() -> None:
    use = calibrated_use()
    tracker = DriftTracker(use, is_improved=False)
    observe(tracker, presses(200.0, seed=3), use)

    seen = observe(tracker, presses(400.0, seed=4, depth=1.4), use, 200.0)

    assert "the use changed, not the sensor" in seen[-1].reason
    assert tracker.alarm == ""
    assert error_of(tracker, 1.0, 0.0) < 0.02


def test_reseated_sensor_is_followed_after_the_stated_cycles() -> None:
    use = calibrated_use()
    tracker = DriftTracker(use, is_improved=True)
    observe(tracker, presses(200.0, seed=3), use)

    seen = observe(tracker, 0.95 * presses(200.0, seed=6) + 0.25, use, 200.0)

    first = next(k for k, observation in enumerate(seen) if observation.verdict == JUMPED)
    assert first <= JUMP_CYCLES
    assert error_of(tracker, 0.95, 0.25) < 0.02


def test_jump_beyond_the_trust_region_is_held_and_alarmed() -> None:
    use = calibrated_use()
    tracker = DriftTracker(use, is_improved=True)
    observe(tracker, presses(100.0, seed=3), use)

    seen = observe(tracker, presses(100.0, seed=6) + 2.0, use, 100.0)

    assert seen[-1].verdict == HELD
    assert "check the sensor" in tracker.alarm
    assert tracker.correction() == pytest.approx((1.0, 0.0))


def test_use_that_is_new_is_learnt_and_its_drift_followed() -> None:
    use = calibrated_use()
    tracker = DriftTracker(use, is_improved=True)
    output = presses(1600.0, seed=8, power=0.4)
    offset = np.interp(np.arange(len(output)), [0.3 * len(output), 0.9 * len(output)], [0.0, 0.2])

    seen = observe(tracker, output + offset, use)

    assert any("a new use was learnt" in observation.reason for observation in seen)
    assert seen[-1].verdict == FOLLOWED
    assert error_of(tracker, 1.0, 0.2) < 0.05


def test_return_of_the_calibrated_use_overrules_what_was_learnt_meanwhile() -> None:
    use = calibrated_use()
    tracker = DriftTracker(use, is_improved=True)
    observe(tracker, presses(400.0, seed=8, power=0.4) + 0.12, use)

    observe(tracker, presses(800.0, seed=9) + 0.12, use, 400.0)

    assert error_of(tracker, 1.0, 0.12) < 0.02


def test_recording_without_cycles_says_so() -> None:
    ramp = np.concatenate([np.linspace(0, 1, 3000), np.linspace(1, 0, 3000)])
    ramp += 0.001 * np.random.default_rng(0).normal(size=6000)

    lesson = calibrated_use(ramp).lesson

    assert lesson.activity is None
    assert "cycles" in lesson.reason


def test_doubt_grows_while_nothing_is_seen() -> None:
    use = calibrated_use()
    tracker = DriftTracker(use, is_improved=True)
    observe(tracker, presses(200.0, seed=3), use)

    doubts = [tracker.doubt_at(t_s)[0] for t_s in (200.0, 1000.0, 10_000.0)]

    assert doubts[0] < doubts[1] < doubts[2]


def test_state_goes_through_json_and_back() -> None:
    use = calibrated_use()
    tracker, other = DriftTracker(use, is_improved=True), DriftTracker(use, is_improved=True)
    observe(tracker, presses(300.0, seed=8, power=0.4), use)

    other.restore(json.loads(json.dumps(tracker.state())))

    later = presses(300.0, seed=9) + 0.1
    assert observe(other, later, use, 300.0) == observe(tracker, later, use, 300.0)
