"""A recording proves itself: lag, gain, what follows the stage; and good rigs of many kinds are never refused."""

from dataclasses import replace

import numpy as np
import pytest
from common.proof_trial import draw_good_rig, open_good_rig, press_good_rig
from scipy.signal import lfilter

from softcal.core.errors import BadReply
from softcal.core.profiles import moves, ramps
from softcal.core.twin.simulate import Twin, simulate
from softcal.station.bench.bench import open_simulated_bench
from softcal.station.devices.config import UNKNOWN_S
from softcal.station.record.method import METHOD
from softcal.station.record.proof import (
    PressLaw,
    check_bits,
    check_follows,
    check_gain,
    check_output_gain,
    check_strokes,
    press_gains,
)
from softcal.station.record.recording import Raw, RunMetadata, assemble, restore
from softcal.station.record.response import CellResponse, check_lag, fit_response
from softcal.station.record.spool import read_spool
from softcal.station.tasks.acquisition import record
from softcal.station.testing.faults import loosen
from tests.layers import layered

TURNS_S, DEPTHS_MM = np.arange(0.0, 31.0, 1.5), np.tile([0.0, 3.0, 0.0, 2.0], 6)[:21]


def stage_mm(t_s):
    return np.interp(t_s, TURNS_S, DEPTHS_MM)


def relaxing_force(t_s, share=0.3, time_s=0.8):
    """A standard linear solid: a spring, and a Maxwell branch, in steps of a millisecond."""
    fine_s = np.arange(0.0, 31.0, 0.001)
    elastic = 0.8 * stage_mm(fine_s) ** 1.5
    branch, decay = np.zeros_like(elastic), np.exp(-0.001 / time_s)
    for k in range(1, len(elastic)):
        branch[k] = decay * branch[k - 1] + elastic[k] - elastic[k - 1]
    return np.interp(t_s, fine_s, (1 - share) * elastic + share * branch)


def lag_s(*arguments):
    return fit_response(*arguments, METHOD).lag_s


def check_law(*arguments):
    PressLaw(*arguments, METHOD).check()


@pytest.mark.parametrize("late_s", [0.0, 0.02, 0.05, 0.1, 0.3])
@pytest.mark.parametrize("share", [0.0, 0.3])
def test_how_late_a_cell_is_is_found_on_elastic_and_on_relaxing_units(late_s, share, rng):
    t_s = np.arange(1.0, 29.0, 1 / 80)
    force_N = relaxing_force(t_s - late_s, share) + rng.normal(0, 0.01, len(t_s))
    assert lag_s(t_s, force_N, stage_mm, 0.0) == pytest.approx(late_s, abs=0.008)


def test_a_few_samples_or_noise_alone_tell_nothing(rng):
    t_s = np.arange(1.0, 3.0, 0.1)
    assert np.isnan(lag_s(t_s, relaxing_force(t_s) + rng.normal(0, 0.2, len(t_s)), stage_mm, 0.0))
    t_s = np.arange(1.0, 29.0, 1 / 80)
    assert np.isnan(lag_s(t_s, rng.normal(0, 1.0, len(t_s)), stage_mm, 0.0))
    assert np.isnan(lag_s(t_s, rng.normal(0, 1.0, len(t_s)), lambda t: np.zeros_like(t), 1.0))


def test_presses_that_repeat_within_the_delays_that_are_tried_tell_no_delay(rng):
    def every_half_second(t_s):
        return 1.0 + np.abs(4.0 * np.mod(t_s, 0.5) - 1.0)

    t_s = np.arange(1.0, 9.0, 0.05)
    force_N = 0.8 * every_half_second(t_s - 0.1) ** 1.5 + rng.normal(0, 0.01, len(t_s))
    assert np.isnan(lag_s(t_s, force_N, every_half_second, 0.0))


def refused(code, check, *arguments):
    """Return the values with which a check refuses what it is shown."""
    with pytest.raises(BadReply) as bad:
        check(*arguments)
    assert bad.value.reason.code == code
    return bad.value.reason.values


def behind(delay_s, constant_s=0.0):
    return CellResponse(delay_s, constant_s, *(np.zeros(1),) * 3)


def test_a_cell_may_be_off_by_a_share_of_its_sampling_period():
    for found_s, period_s in ((0.008, 0.0125), (0.02, 0.1), (-0.02, 0.1), (float("nan"), 0.0125)):
        check_lag(behind(found_s), 0.0, period_s, METHOD.lag)
    for found_s in (0.02, -0.02):
        values = refused("rig.behind", check_lag, behind(found_s), 0.0, 0.0125, METHOD.lag)
        assert (values["found_s"], values["declared_s"]) == (found_s, 0.0)


def test_a_low_pass_may_be_hidden_by_a_unit_that_relaxes_but_never_makes_a_cell_later():
    check_lag(behind(0.0, 0.08), 0.1, 0.0125, METHOD.lag)
    refused("rig.behind", check_lag, behind(0.0, 0.13), 0.1, 0.0125, METHOD.lag)


def test_a_press_with_another_gain_is_refused():
    t_s = np.arange(0.0, 30.0, 0.02)
    force_N = relaxing_force(t_s)
    check_gain(stage_mm(t_s), force_N, METHOD.press)
    assert press_gains(stage_mm(t_s), force_N, METHOD.press) == pytest.approx(1.0, abs=0.15)
    refused("rig.gain", check_gain, stage_mm(t_s), np.where(t_s > 15.0, 0.6, 1.0) * force_N, METHOD.press)


def shown_by(force_N, rng):
    """The output of a sensor that follows the force at once."""
    return 1.4 + 0.1 * force_N + rng.normal(0, 0.002, len(force_N))


def check_is_refused(t_s, force_N, output):
    refused("rig.odd_force", check_law, t_s, force_N, output, stage_mm, 0.0)


@pytest.mark.parametrize("gain", [0.5, 0.7, 1.5, 2.0])
@pytest.mark.parametrize("samples_Hz", [10.0, 80.0])
def test_a_gain_that_changes_once_is_refused_however_few_presses_there_are(gain, samples_Hz, rng):
    t_s = np.arange(0.0, 6.0, 1 / samples_Hz)
    force_N, output = relaxing_force(t_s) + rng.normal(0, 0.01, len(t_s)), shown_by(relaxing_force(t_s), rng)
    check_law(t_s, force_N, output, stage_mm, 0.0)
    check_is_refused(t_s, np.where(t_s > 3.0, gain, 1.0) * force_N, output)


@pytest.mark.parametrize("changes_s", [8.0, 15.0, 21.7])
@pytest.mark.parametrize("samples_Hz", [10.0, 80.0])
def test_a_gain_a_zero_or_a_delay_that_changes_a_little_at_any_moment_is_refused(samples_Hz, changes_s, rng):
    t_s = np.arange(0.0, 30.0, 1 / samples_Hz)
    force_N, output = relaxing_force(t_s) + rng.normal(0, 0.01, len(t_s)), shown_by(relaxing_force(t_s), rng)
    check_law(t_s, force_N, output, stage_mm, 0.0)
    late_N = relaxing_force(t_s - 0.1) + rng.normal(0, 0.01, len(t_s))
    for changed_N in (0.85 * force_N, 1.15 * force_N, force_N + 0.3, force_N - 0.3, late_N):
        check_is_refused(t_s, np.where(t_s > changes_s, changed_N, force_N), output)


def test_a_unit_that_softens_or_a_sensor_that_drifts_is_no_cell_that_changes(rng):
    t_s = np.arange(0.0, 30.0, 1 / 80)
    noise_N = rng.normal(0, 0.01, len(t_s))
    softer_N = np.where(t_s > 3.0, 0.93, 1.0) * relaxing_force(t_s) + noise_N
    check_law(t_s, softer_N, shown_by(softer_N - noise_N, rng), stage_mm, 0.0)
    drifting = shown_by(relaxing_force(t_s), rng) + 0.1 * (t_s > 12.0)
    check_law(t_s, relaxing_force(t_s) + noise_N, drifting, stage_mm, 0.0)


@pytest.mark.parametrize("hang_s", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("samples_Hz", [10.0, 80.0])
def test_a_cell_that_hangs_for_a_moment_is_refused_although_its_noise_goes_on(hang_s, samples_Hz, rng):
    t_s = np.arange(0.0, 12.0, 1 / samples_Hz)
    force_N = relaxing_force(t_s) + rng.normal(0, 0.01, len(t_s))
    output = shown_by(force_N, rng)
    check_law(t_s, force_N, output, stage_mm, 0.0)
    begins = int(np.argmax(force_N > 1.0))
    is_hanging = (t_s >= t_s[begins]) & (t_s < t_s[begins] + hang_s)
    hanging_N = np.where(is_hanging, force_N[begins] + rng.normal(0, 0.01, len(t_s)), force_N)
    at_s = refused("rig.odd_force", check_law, t_s, hanging_N, output, stage_mm, 0.0)["at_s"]
    assert t_s[begins] - 0.1 <= at_s <= t_s[begins] + hang_s + 0.1


@pytest.mark.parametrize("seed", [156, 204, 108])
def test_a_cell_whose_gain_halves_in_a_short_run_is_noticed(seed, tmp_path):
    path = tmp_path / "run.spool"
    press_good_rig(draw_good_rig(seed), path)
    run = read_spool(path)
    metadata, (begun_s, ended_s) = RunMetadata(**run.metadata), run.metadata["span_s"]
    middle = [p for p in run.polls if 0.35 < (p.host_s - begun_s) / (ended_s - begun_s) < 0.65]
    at_s, zero_N = min(middle, key=lambda poll: poll.position_mm).host_s, metadata.zero_N
    halved = tuple(
        replace(sample, values=(zero_N + 0.5 * (sample.values[0] - zero_N),)) if sample.host_s > at_s else sample
        for sample in run.force
    )
    assemble(Raw(run.output, run.force, run.polls), metadata)
    with pytest.raises(BadReply) as bad:
        assemble(Raw(run.output, halved, run.polls), metadata)
    assert bad.value.reason.code in ("rig.gain", "rig.odd_force")


def test_a_unit_with_a_hard_layer_is_no_stage_that_lost_steps(rng):
    """Without its soft layer from the second press on it would fit the law better, but so it would from the first."""
    t_s = np.arange(0.0, 12.0, 1 / 80)
    depth_mm = np.where(t_s < 3.0, np.minimum(stage_mm(t_s), 0.9), stage_mm(t_s))
    force_N = 0.4 * depth_mm + 4.6 * np.maximum(0.0, depth_mm - 0.9) + rng.normal(0, 0.01, len(t_s))
    law = (force_N, shown_by(force_N, rng), lambda at_s: np.interp(at_s, t_s, depth_mm), 0.0, METHOD)
    PressLaw(t_s, *law).check_slip()
    lost_N = np.where(t_s > 6.0, 0.4, 0.0) * (depth_mm > 0.4)
    slipped_N = np.maximum(0.0, force_N - 5.0 * lost_N)
    refused("rig.slipped", PressLaw(t_s, slipped_N, shown_by(slipped_N, rng), *law[2:]).check_slip)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_lost_steps_show_in_the_output_where_there_is_no_cell(sign):
    t_s = np.arange(0.0, 30.0, 0.02)
    output = 2.0 + sign * 0.1 * stage_mm(t_s) ** 1.5
    check_output_gain(stage_mm(t_s), output, METHOD.press)
    slipped = 2.0 + sign * 0.1 * np.maximum(0.0, stage_mm(t_s) - np.where(t_s > 15.0, 1.0, 0.0)) ** 1.5
    refused("rig.output_gain", check_output_gain, stage_mm(t_s), slipped, METHOD.press)


def test_an_output_that_does_not_follow_the_stage_is_refused(rng):
    t_s = np.arange(1.0, 29.0, 0.02)
    good = 1.4 + 0.1 * relaxing_force(t_s) + rng.normal(0, 0.005, len(t_s))
    check_follows(t_s, good[:, None], stage_mm, 0.0, METHOD)
    floats = 2.0 + 0.4 * np.sin(2 * np.pi * 0.93 * t_s)
    refused("rig.follows", check_follows, t_s, np.column_stack([good, floats]), stage_mm, 0.0, METHOD)


@pytest.mark.parametrize("lag_s", [0.0, 0.3])
def test_an_output_that_stays_at_its_level_in_one_press_is_refused(lag_s, rng):
    t_s = np.arange(0.0, 29.0, 0.02)
    depth_mm = np.maximum(0.0, stage_mm(t_s))
    output = 1.4 + 0.1 * depth_mm**1.5
    if lag_s:
        output = lfilter([-np.expm1(-0.02 / lag_s)], [1.0, -np.exp(-0.02 / lag_s)], output - 1.4) + 1.4
    output += rng.normal(0, 0.005, len(t_s))
    check_strokes(t_s, output[:, None], depth_mm, "sensor readout", METHOD.stroke)
    stuck = np.where(t_s > 14.0, 1.5 + rng.normal(0, 0.01, len(t_s)), output)
    channels = np.column_stack([output, stuck])
    values = refused("rig.stuck", check_strokes, t_s, channels, depth_mm, "sensor readout", METHOD.stroke)
    assert values["level"] == pytest.approx(1.5, abs=0.01) and values["stuck_mm"] > 1.0


@pytest.mark.parametrize("bit", [1, 3, 5, 6])
@pytest.mark.parametrize("is_one", [True, False])
def test_a_bit_that_hangs_is_found(bit, is_one, rng):
    t_s = np.arange(0.0, 30.0, 0.02)
    counts = np.round(290 + 60 * relaxing_force(t_s) + rng.normal(0, 0.5, len(t_s))).astype(int)
    step_V = 5 / 1023
    check_bits(step_V * counts[:, None], METHOD.output)
    stuck = counts | 1 << bit if is_one else counts & ~(1 << bit)
    assert refused("rig.bit", check_bits, step_V * stuck[:, None], METHOD.output)["bit"] == bit


@pytest.mark.parametrize(
    "kind", ["arduino", "scpi_lcr", *(pytest.param(kind, marks=pytest.mark.long) for kind in ("scpi_dmm", "labjack"))]
)
def test_a_loose_cable_of_the_output_is_reported_through_every_readout(kind):
    profile, pending = moves("short", [0.0, 2.0, 0.0], [2.0, 2.0, 2.0], [0.5, 0.5, 0.5]), [1.2]
    with open_simulated_bench(seed=3, readout_kind=kind) as (bench, station):

        def loosen_once(progress):
            if progress.phase == "pressing" and pending and progress.force_N > 0.5:
                pending.clear()
                loosen(station, 0.05, lambda output_V: 0.5 * output_V)

        with pytest.raises(BadReply) as bad:
            record(bench, "A1", profile, True, loosen_once)
        assert not station.axis.is_moving
    about = bad.value.reason.values["why"]
    assert about.code == "rig.dropout"
    assert about.values["level"] == pytest.approx(0.5 * about.values["expected"], rel=0.1)
    assert 0.5 < about.values["at_s"] < 2.5 and 0.02 <= about.values["lasts_s"] <= 0.1


def test_a_loose_cable_is_reported_of_a_spooled_run_too(tmp_path):
    rig = draw_good_rig(2003)
    press_good_rig(rig, tmp_path / "run.spool")
    run = read_spool(tmp_path / "run.spool")
    at = next(k for k, sample in enumerate(run.output) if sample.host_s > run.metadata["span_s"][0] + 5.0)
    rail = [replace(s, values=(5.0,)) if at <= k < at + 2 else s for k, s in enumerate(run.output)]
    with pytest.raises(BadReply) as bad:
        restore(replace(run, output=tuple(rail)))
    assert bad.value.reason.code == "rig.dropout"
    assert bad.value.reason.values["at_s"] == pytest.approx(5.0, abs=0.1)


def test_an_instrument_without_steps_has_no_bits(rng):
    check_bits(rng.normal(100.0, 3.0, (500, 2)), METHOD.output)
    check_bits(np.full((500, 1), 1.4), METHOD.output)


def test_a_latency_that_nobody_stated_is_found_and_taken_off():
    with open_simulated_bench(seed=3) as (bench, station):
        station.force_wire.delay_s += 0.1
        unstated = replace(bench.config, force=replace(bench.config.force, latency_s=UNKNOWN_S))
        recording = record(replace(bench, config=unstated), "A0", ramps([2.0, 3.0], 3.0, rest_s=0.5), True)
        surface_mm = recording.contact_mm - 0.3 - station.rig.clearance_mm
    force_N, _ = simulate(Twin(), recording.t_s, recording.stage_mm + surface_mm)
    assert recording.alignment.force_behind_s == pytest.approx(0.1, abs=0.01)
    # 0.1 s late, this run would be wrong by 0.5 N.
    assert np.sqrt(np.mean((recording.force_N - force_N) ** 2)) < 0.1


@pytest.mark.parametrize("seed", layered((7, 19, 31, 36, 57, 66, 615, 667, 704, 1018), (7, 615, 667, 1018)))
def test_slow_late_and_flat_channels_of_a_good_rig_are_no_fault(seed):
    rig = draw_good_rig(seed)
    recording = press_good_rig(rig)
    behind_s = recording.alignment.force_behind_s
    assert np.isnan(behind_s) or behind_s == pytest.approx(rig.late_s, abs=0.03)


@pytest.mark.long
def test_a_unit_that_relaxes_in_a_slow_press_and_leaves_the_stage_is_no_channel_that_is_stuck():
    rig = replace(draw_good_rig(3), cell_Hz=20.0, late_s=0.0, latency_s=UNKNOWN_S)
    with open_good_rig(rig) as (bench, _):
        slow = replace(bench.config, safety=replace(bench.config.safety, stiffest_N_mm=1000.0))
        assert record(replace(bench, config=slow), "P1", rig.profile, True).lost == 0


def test_an_output_that_lags_in_a_fast_profile_is_no_channel_that_is_stuck():
    assert press_good_rig(replace(draw_good_rig(3425), stage_kind="zaber")).lost == 0
