"""The raw output: dead, noisy, clipped, frozen and short recordings, and good ones that look like them."""

from dataclasses import replace

import numpy as np
import pytest

from softcal.core.errors import UnitRefused
from softcal.core.recording import OutputRecording
from softcal.core.unit.health import check_alive, count_presses, health_findings, output_limits, run_lengths
from softcal.core.unit.method import HealthConfig, Method

HEALTH = HealthConfig()


@pytest.fixture
def source(press):
    return press(1, seconds=120.0).unlabelled


def kinds(target, source):
    limits = output_limits(target, source, is_rising=True, method=Method())
    return [f.kind for f in health_findings(target, source, limits, Method())]


def test_run_lengths_count_equal_samples():
    assert run_lengths(np.array([1.0, 1, 2, 2, 2, 1])).tolist() == [1, 2, 1, 2, 3, 1]


@pytest.mark.parametrize("peaks", [1, 2, 7])
def test_presses_are_counted(peaks):
    output = np.concatenate([np.zeros(30), *[np.concatenate([np.hanning(60), np.zeros(20)]) for _ in range(peaks)]])
    recording = OutputRecording("U1", np.arange(len(output)) / 50.0, output, 50.0)
    assert count_presses(recording, HEALTH) == peaks


def test_a_good_unit_has_no_finding(press, source):
    assert kinds(press(2, gain=1.3, offset_V=0.1).unlabelled, source) == []


@pytest.mark.parametrize("bits", [8, 10])
def test_a_coarse_readout_is_not_called_clipped(press, source, bits):
    step = 1.0 / 2**bits
    coarse = [replace(r, output=np.round(r.output / step) * step) for r in (press(2).unlabelled, source)]
    assert "saturated" not in kinds(*coarse)


def test_a_clipped_range_is_found_with_its_rail(press, source):
    unit = press(2).unlabelled
    clipped = replace(unit, output=np.minimum(unit.output, 0.65))
    assert "saturated" in kinds(clipped, source)
    assert output_limits(clipped, source, is_rising=True, method=Method()).rail_high == pytest.approx(0.65, abs=0.02)


def test_a_noisy_clip_is_found_too(press, source, rng):
    unit = press(2).unlabelled
    noisy = np.minimum(unit.output, 0.65) + rng.normal(0, 0.001, len(unit))
    assert "saturated" in kinds(replace(unit, output=noisy), source)


def test_sharp_tips_of_one_depth_and_one_hold_there_are_no_clipping(source, rng):
    tip = np.concatenate([np.linspace(0, 3, 60), np.linspace(3, 0, 60), np.zeros(30)])
    hold = np.concatenate([np.linspace(0, 3, 60), np.full(150, 3.0), np.linspace(3, 0, 60), np.zeros(30)])
    force_N = np.concatenate([np.zeros(50), tip, tip, tip, hold, 0.6 * tip, tip])
    output = 0.5 + 0.1 * force_N + rng.normal(0, 0.003, len(force_N))
    unit = replace(source, t_s=np.arange(len(output)) / source.sample_rate_Hz, output=output)
    assert "saturated" not in kinds(unit, source)


def test_a_falling_output_is_clipped_at_its_lower_end(press, source):
    falling_source = replace(source, output=1.0 - source.output)
    unit = press(2).unlabelled
    clipped = replace(unit, output=np.maximum(1.0 - unit.output, 0.35))
    limits = output_limits(clipped, falling_source, is_rising=False, method=Method())
    assert limits.rail_low == pytest.approx(0.35, abs=0.02)


@pytest.mark.parametrize(
    ("dead", "code"),
    [
        (lambda output, rng: np.full(len(output), 0.5), "dead.constant"),
        (lambda output, rng: 0.5 + rng.normal(0, 0.1, len(output)), "dead.noise"),
        (lambda output, rng: 0.5 + 0.001 * (output - 0.5), "dead.small"),
    ],
)
def test_a_dead_output_is_refused(press, source, rng, dead, code):
    unit = press(2).unlabelled
    with pytest.raises(UnitRefused) as refused:
        check_alive(replace(unit, output=dead(unit.output, rng)), source, HEALTH)
    assert refused.value.reason.code == code
    assert code != "dead.constant" or refused.value.reason.values["level"] == 0.5


def test_a_reading_that_freezes_in_mid_range_asks_for_a_retest(press, source):
    output = press(2).unlabelled.output.copy()
    start = int(np.flatnonzero(np.abs(output - 0.65) < 0.01)[0])
    output[start : start + 400] = output[start]
    pair = replace(press(2).unlabelled, output=output), source
    findings = health_findings(*pair, output_limits(*pair, is_rising=True, method=Method()), Method())
    assert [f.best for f in findings if f.kind == "stuck"] == ["retest"]


def test_a_short_recording_says_how_much_is_needed(press, source):
    unit = press(2, seconds=8.0).unlabelled
    assert "too little data" in kinds(unit, source)
