"""Cases, predictions, starts, maps and places of the twin, by the equations of its base."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import least_squares

from softcal.core.errors import InputError
from softcal.core.gap.case import CHANNEL_OF_STAGE, COMMON, Case, RigScale, Run
from softcal.core.gap.evidence import in_catalogue_form, with_constants
from softcal.core.gap.fault_location import (
    Tone,
    conditions_of_presses,
    explained_twin,
    likely_stages,
    loose_noise,
    strongest_tone,
    suspects,
)
from softcal.core.gap.fit import (
    Map,
    Structure,
    fit,
    form_of,
    nuisance_rows,
    rows_of_runs,
    shares_of_gap,
    strongest_regimes,
    structure,
)
from softcal.core.gap.hypothesis import BASE, Hypothesis, Probe, to_fit
from softcal.core.gap.method import METHOD
from softcal.core.gap.model import Problem
from softcal.core.gap.residual import with_driving_noise
from softcal.core.gap.search import best_unmodelled, causes_with_surrogate, fit_jointly, screen, surrogate_share
from softcal.core.gap.twin import TWIN
from softcal.core.gap.twin_reach import (
    UNMODELLED_EFFECTS,
    WARM_DIVIDER,
    bases_of,
    changing,
    dither_of,
    excitation_of,
    explanatory_chain_signals,
    is_resolved,
    menu,
    rough_start,
    terms_of_twin,
    visible_effects,
)
from softcal.core.messages.reason import Reason
from softcal.core.twin.catalogue import EFFECTS
from softcal.core.twin.effects import Flow
from softcal.core.twin.electronics import dither_V
from softcal.core.twin.empirical_terms import VARIABLES, EmpiricalTerm
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.probes import ExcitationRange
from softcal.core.twin.signals import low_pass

READOUT = ReadoutMetadata(vref_V=3.3, adc_bits=20, r_series_ohm=10.0, sample_rate_Hz=50.0)
PAD = BaseParameters(u0_mm=0.35, k1_N_mm=1.1, k3_N_mm3=0.1, r0_ohm=4.0, kappa_per_N=0.06)
SIGMA = {"force_N": 0.01, "output_V": 0.001}
AT = np.array([to_fit(p, getattr(PAD, p.name)) for p in BASE])


def volt(resistance, readout=READOUT):
    return readout.vref_V * resistance / (resistance + readout.r_series_ohm)


def elastic(depth_mm):
    return 1.1 * depth_mm + 0.1 * depth_mm**3


def run_of(number=1, count=400, noise=1.0, pad=PAD, readout=READOUT, seed=None, speed=1.0, **change):
    """A press along a swinging stage, with white noise, by the equations of the base."""
    rng = np.random.default_rng(number if seed is None else seed)
    t_s = np.arange(count) * 0.02
    stage_mm = 1.6 * (1.0 - np.cos(2 * np.pi * speed * t_s / 3.1)) * (0.7 + 0.3 * np.sin(t_s / (1.0 + number)))
    depth = np.maximum(0.0, stage_mm - pad.u0_mm)
    force = pad.k1_N_mm * depth + pad.k3_N_mm3 * depth**3
    drive = depth if readout.sensor_type == "strain" else force
    output = volt(pad.r0_ohm / (1.0 - pad.kappa_per_N * drive), readout)
    columns = {"stage_mm": stage_mm, "force_N": force + noise * rng.normal(0, SIGMA["force_N"], count),
               "output_V": output + noise * rng.normal(0, SIGMA["output_V"], count)}  # fmt: skip
    return Run(str(number), **({"t_s": t_s, "readout": readout} | columns | change))


def case_of(*runs, **more):
    return Case("C1", runs or (run_of(1), run_of(2, 350, speed=1.4)), **more)


CASE = case_of()
PROBLEM = Problem(TWIN, CASE, SIGMA)


def pad_fit(problem=PROBLEM, *effects, values=()):
    start = np.concatenate([AT, *([to_fit(p, v)] for e, row in zip(effects, values, strict=True)
                                  for p, v in zip(e.parameters, row, strict=True))])  # fmt: skip
    return fit(problem, Hypothesis(tuple(effects)), start)


# A run and a case are checked once.


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "bend"}, "'bend'"),
        ({"t_s": np.where(np.arange(400) == 9, np.nan, np.arange(400) * 0.02)}, "t_s is not finite"),
        ({"t_s": np.where(np.arange(400) == 9, 8 * 0.02, np.arange(400) * 0.02)}, "sample 9"),
        ({"force_N": np.ones(399)}, "force_N has 399"),
        ({"known_force_N": np.ones(399)}, "known_force_N has 399"),
        ({"output_V": np.where(np.arange(400) == 5, np.inf, 1.0)}, "inf at sample 5; 1 not finite"),
        ({"stage_mm": None, "force_N": None}, "two of stage_mm"),
        ({"force_N": np.ones(400)}, "force_N is 1 throughout"),
        ({"kind": "rigid_block", "force_N": None}, "needs force_N"),
        ({"kind": "dead_weights"}, "needs known_force_N"),
        ({"kind": "dummy_resistor"}, "dummy_ohm above 0"),
        ({"kind": "dummy_resistor", "dummy_ohm": 0.0}, "dummy_ohm above 0"),
    ],
)
def test_a_run_that_cannot_be_is_refused(change, message):
    with pytest.raises(InputError, match=message):
        run_of(**change)


def test_a_run_of_30_samples_is_enough_and_of_29_is_not():
    assert len(run_of(count=200)) == 200
    t_s = np.arange(30) * 0.02
    Run("1", t_s, READOUT, t_s, t_s)
    with pytest.raises(InputError, match="29 samples"):
        Run("1", t_s[:29], READOUT, t_s[:29], t_s[:29])
    Run("1", t_s, READOUT, output_V=np.zeros(30), is_planned=True)
    Run("1", t_s, READOUT, output_V=np.ones(30), kind="dummy_resistor", dummy_ohm=5.0)


def test_times_of_a_run_count_from_its_first_sample():
    run = replace(run_of(temperature_C=20.0 + np.arange(400) * 0.01), t_s=5.0 + np.arange(400) * 0.02)
    np.testing.assert_allclose(run.elapsed_s, np.arange(400) * 0.02)
    np.testing.assert_allclose(run.step_s, [0.0, *np.full(399, 0.02)])
    np.testing.assert_allclose(run.temperature_rise_K, np.arange(400) * 0.01)
    assert run.observed_rate_Hz == pytest.approx(50.0)
    assert run_of().temperature_rise_K is None


def test_the_noise_of_a_measured_force_is_read_from_second_differences():
    noise = np.random.default_rng(3).normal(0.0, 0.05, 5000)
    ramp = 0.01 * np.arange(5000)
    run = Run("1", np.arange(5000) * 0.02, READOUT, stage_mm=ramp, force_N=ramp + noise)
    driving_N = run.driving_force
    # A line through nine samples keeps a ninth of the variance in its middle.
    assert np.median(driving_N.sigma_N) == pytest.approx(0.05 / 3.0, rel=0.05)
    assert np.std(driving_N.force_N - ramp) < 0.035
    with pytest.raises(ValueError, match="no force"):
        _ = run_of(force_N=None).driving_force


def test_a_case_is_of_one_unit_on_one_rig():
    with pytest.raises(InputError, match="vref_V is 5"):
        case_of(run_of(1), run_of(2, readout=replace(READOUT, vref_V=5.0)))
    case_of(run_of(1), run_of(2, readout=replace(READOUT, sample_rate_Hz=60.0)))
    with pytest.raises(InputError, match="output_V is missing"):
        case_of(run_of(1), run_of(2, output_V=None))
    with pytest.raises(InputError, match="no run in which"):
        case_of(run_of(1, kind="rest"))
    assert case_of(run_of(1, kind="rest"), is_planned=True).presses == ()
    case = case_of(run_of(1), run_of(2, kind="rest", stage_mm=None))
    assert [r.name for r in case.presses] == ["1"] and case.has("stage_mm")
    assert len(case.recorded("force_N")) == 1 and case.missing_channels == ("temperature_C",)


def test_what_a_case_cannot_show():
    for channel, stages in (("stage_mm", {"motion", "mechanics"}), ("force_N", {"load_cell"}),
                            ("output_V", {"transduction", "electronics", "acquisition"})):  # fmt: skip
        case = case_of(run_of(**{channel: None}))
        assert set(case.unseen_stages) == stages == {s for s, c in CHANNEL_OF_STAGE.items() if c == channel}
        assert not any(e.stage in stages for e in visible_effects(case))
    assert {e.id for e in visible_effects(CASE)} == {i for i, e in EFFECTS.items() if not e.signs.needs}
    warm = case_of(run_of(temperature_C=20.0 + np.arange(400) * 0.01))
    assert {e.id for e in visible_effects(warm)} == set(EFFECTS)
    still = case_of(run_of(temperature_C=np.full(400, 20.0)))
    assert "thermal_drift" not in {e.id for e in visible_effects(still)}


def test_a_channel_changes_by_its_span_in_a_kind_of_run():
    warm = np.linspace(20.0, 21.0, 400)
    dummy = run_of(2, kind="dummy_resistor", dummy_ohm=5.0, temperature_C=warm)
    case = case_of(run_of(1), dummy)
    assert case.changes("temperature_C", "dummy_resistor", 1.0) and WARM_DIVIDER in TWIN.departures(case)
    assert not case.changes("temperature_C", "dummy_resistor", 1.0 + 1e-9)
    assert not case.changes("temperature_C")
    cooler = case_of(run_of(1), replace(dummy, temperature_C=20.0 + 0.9 * (warm - 20.0)))
    assert WARM_DIVIDER not in TWIN.departures(cooler)
    alias = EFFECTS["thermal_drift"].signs.alias
    assert is_resolved(case, alias) and not is_resolved(CASE, alias)


def test_the_size_of_a_rig_is_read_off_its_runs():
    scale = RigScale.from_case(CASE)
    ranges = {c: max(np.ptp(v) for v in CASE.recorded(c)) for c in ("stage_mm", "force_N")}
    for unit, size in (("mm", ranges["stage_mm"]), ("N", ranges["force_N"]), ("ohm", 10.0), ("V", 3.3)):
        assert scale.factor(unit) == pytest.approx(size / COMMON[unit])
    without = RigScale.from_case(case_of(run_of(force_N=None)))
    assert without.factor("N") == pytest.approx(without.factor("mm"))


# What the twin predicts.


def test_a_press_is_predicted_by_the_equations_of_the_base():
    clean = case_of(run_of(1, noise=0.0), run_of(2, 350, speed=1.4, noise=0.0))
    problem = Problem(TWIN, clean, SIGMA)
    np.testing.assert_allclose(problem.predict(Hypothesis(), AT), problem.measured, atol=1e-9)
    assert [(b.run, b.channel) for b in problem.blocks] == [(k, c) for k in (0, 1) for c in ("force_N", "output_V")]
    strain = ReadoutMetadata(3.3, 20, 10.0, 50.0, "strain")
    problem = Problem(TWIN, case_of(run_of(noise=0.0, readout=strain)), SIGMA)
    np.testing.assert_allclose(problem.predict(Hypothesis(), AT), problem.measured, atol=1e-9)


def test_an_output_never_leaves_the_range_of_the_adc():
    chain = Hypothesis((EFFECTS["reference_drift"],))
    problem = PROBLEM.bare
    for rho, end in ((-5.0, 0.0), (5.0, 3.3)):
        out = problem.predict(chain, np.append(AT, rho))
        volts = np.concatenate([out[b.rows] for b in problem.blocks_of("output_V")])
        assert volts.min() >= 0.0 and volts.max() <= 3.3
        assert end in (volts.min(), volts.max())


def special(kind, **columns):
    t_s = np.arange(100) * 0.02
    return Run("s", t_s, READOUT, kind=kind, **columns)


def predicted(run, *effects, values=()):
    problem = Problem(TWIN, case_of(run_of(1), run), SIGMA).bare
    x = np.concatenate([AT, *(np.atleast_1d(v) for v in values)])
    out = problem.predict(Hypothesis(tuple(effects)), x)
    return {b.channel: out[b.rows] for b in problem.blocks if b.run == 1}


T100 = np.arange(100) * 0.02


def test_a_coarse_adc_is_predicted_by_the_mean_of_its_codes():
    readout = replace(READOUT, adc_bits=8)
    step_V = 3.3 / 255
    problem = Problem(
        TWIN, case_of(run_of(1, noise=0.0, readout=readout)), {"force_N": 0.01, "output_V": 0.3 * step_V}
    ).bare
    out = problem.predict(Hypothesis(), AT)[400:]
    clean_V = volt(4.0 / (1.0 - 0.06 * elastic(np.maximum(0.0, run_of(1).stage_mm - 0.35))))
    noise_V = dither_of(problem) * np.random.default_rng(1).normal(size=(20000, 1))
    at = slice(0, 400, 20)
    codes = np.round((clean_V[at] + noise_V) / step_V) * step_V
    np.testing.assert_allclose(out[at], codes.mean(axis=0), atol=5 * 0.5 * step_V / np.sqrt(20000))
    assert np.abs(out - clean_V).max() > 0.05 * step_V


def test_special_runs_show_their_own_part_of_the_chain():
    weights = np.floor(T100 * 3.0)
    out = predicted(
        special("dead_weights", force_N=weights, known_force_N=weights), EFFECTS["loadcell_drift"], values=[0.05]
    )
    np.testing.assert_allclose(out["force_N"], weights + 0.05 * T100)
    assert set(out) == {"force_N"}
    out = predicted(
        special("dummy_resistor", output_V=np.ones(100), dummy_ohm=7.0), EFFECTS["wiring_resistance"], values=[0.5]
    )
    np.testing.assert_allclose(out["output_V"], volt(7.5))
    assert set(out) == {"output_V"}
    out = predicted(special("rest", force_N=np.zeros(100), output_V=np.ones(100)))
    np.testing.assert_allclose(out["force_N"], 0.0)
    np.testing.assert_allclose(out["output_V"], volt(4.0))


def test_a_rigid_block_gives_way_as_the_frame_does():
    force = 6.0 * np.abs(np.sin(T100 * 3))
    stage = 1.0 + 0.03 * force + np.where(force > 0.3, 0.0, -0.5)
    out = predicted(special("rigid_block", stage_mm=stage, force_N=force), EFFECTS["frame_compliance"], values=[0.03])
    np.testing.assert_allclose(out["stage_mm"], stage, atol=1e-9)
    stiff = predicted(special("rigid_block", stage_mm=stage, force_N=force))
    touched = force > 0.05 * force.max()
    np.testing.assert_allclose(stiff["stage_mm"][touched], np.mean(stage[touched]), atol=1e-9)
    np.testing.assert_allclose(stiff["stage_mm"][~touched], stage[~touched])
    play = predicted(
        special("rigid_block", stage_mm=stage, force_N=force),
        EFFECTS["backlash"],
        EFFECTS["frame_compliance"],
        values=[0.0, 0.03],
    )
    np.testing.assert_allclose(play["stage_mm"], stage, atol=1e-9)


def test_a_block_moves_with_the_play_of_the_stage():
    force = np.concatenate([np.linspace(0, 6, 50), np.linspace(6, 0, 50)])
    b, c = 0.2, 0.01
    # While it is touched the stage goes a play further before the block feels it.
    stage = 1.0 + c * force
    flow = Flow(T100, T100, stage, None, 3.3)
    out = predicted(
        special("rigid_block", stage_mm=stage, force_N=force),
        EFFECTS["backlash"],
        EFFECTS["frame_compliance"],
        values=[b, c],
    )
    y, pad = stage[0] - b, []
    for u in flow.stage_mm:
        y = min(max(y, u - b), u)
        pad.append(y)
    touched = force > 0.05 * 6.0
    bent = c * force + stage - pad
    np.testing.assert_allclose(out["stage_mm"][touched], (np.mean((stage - bent)[touched]) + bent)[touched], atol=1e-9)


def test_without_a_stage_the_force_drives_the_chain():
    run = run_of(noise=0.0, stage_mm=None)
    problem = Problem(TWIN, case_of(run), SIGMA).bare
    drive = run.driving_force.force_N
    out = problem.predict(Hypothesis(), AT)
    np.testing.assert_allclose(out, volt(4.0 / (1.0 - 0.06 * drive)), atol=1e-12)
    assert [b.channel for b in problem.blocks] == ["output_V"]
    # What a cell reads too much is taken off the force first.
    bent = problem.predict(Hypothesis((EFFECTS["loadcell_drift"],)), np.append(AT, 0.02))
    np.testing.assert_allclose(bent, volt(4.0 / (1.0 - 0.06 * (drive - 0.02 * run.elapsed_s))), atol=1e-9)
    saturated = problem.predict(Hypothesis((EFFECTS["loadcell_saturation"],)), np.append(AT, 1 / 25.0**2))
    true = 25.0 * np.arctanh(drive / 25.0)
    np.testing.assert_allclose(saturated, volt(4.0 / (1.0 - 0.06 * true)), atol=2e-5)


def test_the_noise_of_a_driving_force_is_carried_through_the_slope():
    run = run_of(1, 2000, stage_mm=None)
    problem = Problem(TWIN, case_of(run), SIGMA)
    result = fit(problem, Hypothesis(), AT)
    driven = with_driving_noise(problem, result)
    assert driven.is_driven_by_force and not problem.is_driven_by_force
    force = run.driving_force.force_N
    slope = 3.3 * 10.0 / (4.0 / (1 - 0.06 * force) + 10.0) ** 2 * 4.0 * 0.06 / (1 - 0.06 * force) ** 2
    expected = 9.0 * (slope * run.driving_force.sigma_N) ** 2
    loaded = force > 1.0
    assert np.median(driven.extra_variance[loaded] / expected[loaded]) == pytest.approx(1.0, abs=0.15)
    np.testing.assert_allclose(driven.noise**2, SIGMA["output_V"] ** 2 + driven.extra_variance)
    assert with_driving_noise(PROBLEM, pad_fit()) is PROBLEM


def test_an_unforeseeable_sample_costs_what_a_right_prediction_would():
    problem = PROBLEM.bare
    late = problem.predict(Hypothesis((EFFECTS["clock_offset"],)), np.append(AT, -0.1))
    residual = problem.whitened(problem.measured - late)
    for block in problem.blocks_of("output_V"):
        np.testing.assert_allclose(residual[block.rows][-5:], 1.0)


# Base fits.


def test_a_base_fit_is_that_of_scipy():
    fit = pad_fit(PROBLEM.bare)

    def error(x):
        base = BaseParameters(x[0], x[1], x[2], np.exp(x[3]), x[4])
        out = []
        for run in CASE.runs:
            depth = np.maximum(0.0, run.stage_mm - base.u0_mm)
            force = base.k1_N_mm * depth + base.k3_N_mm3 * depth**3
            out += [
                (run.force_N - force) / 0.01,
                (run.output_V - volt(base.r0_ohm / (1 - base.kappa_per_N * force))) / 0.001,
            ]
        return np.concatenate(out)

    expected = least_squares(error, AT, x_scale=[0.3, 1.0, 0.1, 1.0, 0.07])
    assert fit.chi2 == pytest.approx(2 * expected.cost, abs=0.05)
    deviation = np.sqrt(np.diag(np.linalg.inv(expected.jac.T @ expected.jac)))
    np.testing.assert_allclose(fit.coordinates, expected.x, atol=0.1 * deviation.max())
    np.testing.assert_allclose(np.sqrt(np.diag(fit.covariance)), deviation, rtol=0.05)


def test_a_rough_start_is_near_the_truth():
    ramp_mm = np.interp(np.arange(1500) * 0.02, [0, 4, 12, 16, 24, 30], [0.0, 0.1, 3.2, 3.2, 0.0, 0.0])
    force = elastic(np.maximum(0.0, ramp_mm - 0.35)) + np.random.default_rng(1).normal(0, 0.01, 1500)
    ramp = Run("1", np.arange(1500) * 0.02, READOUT, ramp_mm, force, volt(4.0 / (1 - 0.06 * force)))
    start = rough_start(case_of(ramp))
    values = Hypothesis().split(start)[0]
    for value, name, share in zip(
        values, ("u0_mm", "k1_N_mm", "k3_N_mm3", "r0_ohm", "kappa_per_N"), (0.7, 0.3, 0.5, 0.03, 0.15), strict=True
    ):
        assert value == pytest.approx(getattr(PAD, name), rel=share), name
    strain = rough_start(case_of(run_of(readout=replace(READOUT, sensor_type="strain"))))
    assert strain[4] == pytest.approx(0.06, rel=0.2)
    for channel in ("stage_mm", "force_N", "output_V"):
        assert np.all(np.isfinite(rough_start(case_of(run_of(**{channel: None})))))
    alone = Hypothesis().split(rough_start(case_of(run_of(stage_mm=None))))[0]
    assert (alone[3], alone[4]) == pytest.approx((4.0, 0.06), rel=0.1)
    no_force = Hypothesis().split(rough_start(case_of(run_of(force_N=None))))[0]
    assert no_force[0] == pytest.approx(0.35, abs=0.3)
    np.testing.assert_allclose(TWIN.base_of_mistaken_case(CASE).coordinates, rough_start(CASE))


def test_a_base_is_fitted_with_the_noise_of_its_residual():
    base = TWIN.base_fit(CASE)
    for p, x, at in zip(BASE, base.coordinates, AT, strict=True):
        assert x == pytest.approx(at, abs=0.02), p.name
    assert base.problem.sigma["force_N"] == pytest.approx(0.01, rel=0.1)
    assert base.problem.sigma["output_V"] == pytest.approx(0.001, rel=0.1)


@pytest.mark.parametrize(
    ("missing", "free"),
    [
        ((), [1, 1, 1, 1, 1]),
        (("stage_mm",), [0, 0, 0, 1, 1]),
        (("force_N",), [1, 0, 1, 1, 1]),
        (("output_V",), [1, 1, 1, 0, 0]),
    ],
)
def test_channels_determine_parameters(missing, free):
    problem = Problem(TWIN, case_of(run_of(**dict.fromkeys(missing))), SIGMA)
    np.testing.assert_array_equal(problem.is_free, np.array(free, dtype=bool))
    assert fit(problem, Hypothesis(), AT).covariance.diagonal().astype(bool).tolist() == [bool(f) for f in free]


def test_extents_are_read_off_the_case():
    result = pad_fit()
    at = excitation_of(result)
    assert at.depth_mm == pytest.approx(max(r.stage_mm.max() for r in CASE.runs) - result.base.u0_mm)
    assert at.force_N == max(r.force_N.max() for r in CASE.runs)
    assert (at.lowest_V, at.highest_V) == (
        min(r.output_V.min() for r in CASE.runs),
        max(r.output_V.max() for r in CASE.runs),
    )
    assert (at.duration_s, at.period_s, at.series_ohm) == pytest.approx((399 * 0.02, 0.02, 10.0))
    blind = excitation_of(fit(Problem(TWIN, case_of(run_of(force_N=None)), {"output_V": 0.001}), Hypothesis(), AT))
    assert blind.force_N == pytest.approx(elastic(run_of().stage_mm.max() - 0.35), rel=0.05)


def test_noise_that_is_believed_has_a_least():
    assert TWIN.noise_range(PROBLEM, "output_V") == (pytest.approx(0.1 * READOUT.step_V), np.inf)
    assert TWIN.noise_range(PROBLEM, "force_N") == (pytest.approx(1e-6 * PROBLEM.scale.factor("N")), np.inf)
    assert PROBLEM.scored_channels == ["output_V", "force_N"] and TWIN.smooth_order == 1
    assert dither_of(PROBLEM) is None
    coarse = Problem(TWIN, case_of(run_of(readout=replace(READOUT, adc_bits=8))), {"force_N": 0.01, "output_V": 0.004})
    assert dither_of(coarse) == dither_V(0.004, 3.3 / 255)
    assert dither_of(Problem(TWIN, CASE, {"force_N": 0.01})) is None


# Offsets of runs.


def test_bases_of_runs_differ_by_seat_and_resistance():
    bases = bases_of(PAD, {1: np.array([0.3, 0.01, 0.02])})
    assert bases[1] == replace(PAD, r0_ohm=4.04, u0_mm=0.37)
    problem = PROBLEM
    sizes = {0: np.array([0.3, 0.01, 0.02]), 1: np.zeros(3)}
    out, clean = problem.clean(Hypothesis(), AT, sizes), problem.clean(Hypothesis(), AT, {})
    depth = np.maximum(0.0, CASE.runs[0].stage_mm - 0.37)
    np.testing.assert_allclose(out[problem.blocks[0].rows], elastic(depth) + 0.3, atol=1e-12)
    np.testing.assert_allclose(out[problem.blocks[1].rows], volt(4.04 / (1 - 0.06 * elastic(depth))), atol=1e-12)
    np.testing.assert_array_equal(out[problem.blocks[2].rows], clean[problem.blocks[2].rows])


def test_directions_of_offsets_are_derivatives():
    problem, eps = PROBLEM, 1e-6
    clean = problem.clean(Hypothesis(), AT, {})
    rows = rows_of_runs(problem, problem.directions(Hypothesis(), AT, clean, {}))
    for run in (0, 1):
        for kind in range(3):
            sizes = {k: np.zeros(3) for k in (0, 1)}
            sizes[run][kind] = eps
            change = (problem.clean(Hypothesis(), AT, sizes) - clean) / eps
            is_curved = np.abs(rows[run][kind] - change) > 1e-3 * max(np.abs(change).max(), 1e-12)
            assert is_curved.sum() <= 4, (run, kind)
    every, kinds = nuisance_rows(problem, problem.directions(Hypothesis(), AT, clean, {}))
    assert kinds == (0, 0, 1, 2)
    np.testing.assert_allclose(every[2], rows[1][1] - rows[0][1])
    np.testing.assert_allclose(every[0], rows[0][0])
    largest = problem.largest_offsets
    spans = [max(np.ptp(getattr(r, c)) for r in CASE.runs) for c in ("force_N", "stage_mm")]
    config = METHOD.offset
    np.testing.assert_allclose(largest, [config.tare * spans[0], config.resistance, config.seat * spans[1]])


# Maps and where a gap lies.


def mapped(**z):
    names = {"sf": "stage→force", "fo": "force→output", "so": "stage→output"}
    return tuple(Map(names[k], Structure(v, 1.0, v > METHOD.structure.structured_z)) for k, v in z.items())


BEFORE, BEHIND = {"mechanics", "motion"}, {"transduction", "electronics", "acquisition"}


@pytest.mark.parametrize(
    ("maps", "sensor", "expected"),
    [
        ({"sf": 1.0, "fo": 1.0, "so": 1.0}, "pressure", set()),
        ({"sf": 90.0, "fo": 1.0, "so": 90.0}, "pressure", BEFORE),
        ({"sf": 1.0, "fo": 90.0, "so": 90.0}, "pressure", BEHIND),
        ({"sf": 90.0, "fo": 90.0, "so": 1.0}, "pressure", {"load_cell"}),
        ({"sf": 90.0, "fo": 90.0, "so": 90.0}, "pressure", BEFORE | BEHIND),
        ({"sf": 900.0, "fo": 17.0, "so": 900.0}, "pressure", BEFORE),
        ({"sf": 900.0, "fo": 60.0, "so": 900.0}, "pressure", BEFORE),
        ({"sf": 900.0, "fo": 95.0, "so": 900.0}, "pressure", BEFORE | BEHIND),
        ({"sf": 90.0}, "pressure", BEFORE | {"load_cell"}),
        ({"fo": 90.0}, "pressure", BEHIND | {"load_cell"}),
        ({"so": 90.0}, "pressure", BEFORE | BEHIND),
        ({"sf": 90.0, "so": 90.0}, "strain", BEFORE),
        ({"sf": 1.0, "so": 90.0}, "strain", BEHIND),
        ({"sf": 90.0, "so": 1.0}, "strain", {"mechanics", "load_cell"}),
    ],
)
def test_dirty_maps_point_to_what_they_share(maps, sensor, expected):
    assert set(suspects(mapped(**maps), METHOD.structure.quiet, sensor)) == expected


def test_three_maps_are_three_fits():
    maps = {m.name: m.structure for m in TWIN.maps(CASE)}
    assert set(maps) == {"stage→force", "force→output", "stage→output"}
    assert not any(s.is_significant for s in maps.values())
    assert [m.name for m in TWIN.maps(case_of(run_of(output_V=None)))] == ["stage→force"]
    assert [m.name for m in TWIN.maps(case_of(run_of(stage_mm=None)))] == ["force→output"]
    strain = case_of(run_of(readout=replace(READOUT, sensor_type="strain")))
    assert [m.name for m in TWIN.maps(strain)] == ["stage→force", "stage→output"]
    alone = fit(Problem(TWIN, case_of(*(replace(r, output_V=None) for r in CASE.runs)), SIGMA), Hypothesis(), AT)
    assert maps["stage→force"].z == pytest.approx(structure(alone).z, abs=1.0)


LONG = (run_of(1, 900), run_of(2, 700, speed=1.7))


def fit_with_change(channel, change):
    """The base at the truth, on runs whose channel is changed by hand."""
    runs = [replace(r, **{channel: getattr(r, channel) + change(r)}) for r in LONG]
    problem = Problem(TWIN, Case("S", tuple(runs)), SIGMA).bare
    return fit(problem, Hypothesis(), AT, steps=0)


def test_shares_of_a_gap_are_those_of_its_energy():
    loading = lambda r: np.gradient(r.stage_mm, r.t_s) > 0  # noqa: E731
    fit = fit_with_change("force_N", lambda r: 0.3 * loading(r) * (r.stage_mm > 0.35))
    blocks = fit.problem.blocks_of("force_N")
    excess = np.concatenate([fit.residual[b.rows] ** 2 - 1 for b in blocks])
    every = np.concatenate([loading(fit.problem.case.runs[b.run]) for b in blocks])
    rare = np.arange(len(every)) < 3
    nearly = ~rare
    shares = dict(
        (k, (s, t))
        for k, s, t in shares_of_gap(
            fit,
            blocks,
            {Reason("gap.regime.loading"): every, Reason("gap.regime.start"): rare, Reason("gap.regime.end"): nearly},
        )
    )
    assert list(shares) == [Reason("gap.regime.loading")]
    assert shares[Reason("gap.regime.loading")] == pytest.approx((excess[every].sum() / excess.sum(), every.mean()))
    clean = fit_with_change("force_N", lambda r: 0.0)
    assert list(shares_of_gap(clean, clean.problem.blocks_of("force_N"), {Reason("gap.regime.loading"): every})) == []


@pytest.mark.parametrize(
    ("name", "where"),
    [
        ("loading", lambda r: (np.gradient(r.stage_mm, r.t_s) > 0) & (r.stage_mm > 0.35)),
        ("unloading", lambda r: (np.gradient(r.stage_mm, r.t_s) < 0) & (r.stage_mm > 0.35)),
        ("no_contact", lambda r: r.stage_mm <= 0.35),
        ("first_touch", lambda r: (r.stage_mm > 0.35) & (r.stage_mm < 0.7)),
        ("high_load", lambda r: r.stage_mm > 0.35 + 0.81 * (max(x.stage_mm.max() for x in LONG) - 0.35)),
        ("start", lambda r: r.elapsed_s < 0.25 * r.elapsed_s[-1]),
        ("end", lambda r: r.elapsed_s > 0.75 * r.elapsed_s[-1]),
    ],
)
@pytest.mark.parametrize("channel", ["force_N", "output_V"])
def test_a_gap_of_one_regime_is_listed_first(name, where, channel):
    size = 60.0 * SIGMA[channel]
    regimes_found = strongest_regimes(fit_with_change(channel, lambda r: size * where(r)), conditions_of_presses)
    assert regimes_found[0].name.code == f"gap.regime.{name}"
    assert regimes_found[0].channel == channel
    assert regimes_found[0].share > 0.9 and regimes_found[0].lift > 1.5
    keys = [-r.share * np.log(max(r.lift, 1.0) + 1e-9) for r in regimes_found]
    assert keys == sorted(keys)


def test_a_gap_of_one_run_names_the_run():
    regimes_found = strongest_regimes(
        fit_with_change("force_N", lambda r: 0.6 * (r.name == "2")), conditions_of_presses
    )
    assert regimes_found[0].name.values["run"] == "2" and regimes_found[0].share > 0.99


def test_a_hold_is_where_the_stage_stands():
    t_s = np.arange(600) * 0.02
    stage = np.interp(t_s, [0, 2, 5, 7, 12], [0.0, 2.5, 2.5, 0.0, 0.0]) + 1e-6 * np.sin(t_s)
    still = (t_s > 2) & (t_s < 5)
    rng = np.random.default_rng(1)
    force = elastic(np.maximum(0.0, stage - 0.35)) + rng.normal(0, 0.01, 600) + 0.5 * still
    run = Run("1", t_s, READOUT, stage_mm=np.where(still, 2.5, stage), force_N=force)
    regimes_found = strongest_regimes(
        fit(Problem(TWIN, Case("H", (run,)), SIGMA).bare, Hypothesis(), AT, steps=0), conditions_of_presses
    )
    assert "hold" in regimes_found[0].name.code or regimes_found[0].name.code.endswith("high_load")
    assert any(r.name.code == "gap.regime.hold" and r.share > 0.98 for r in regimes_found)


# Tones, spikes, jitter.


def test_a_tone_is_found_with_its_frequency_and_size():
    fit = fit_with_change("output_V", lambda r: 0.002 * np.sin(2 * np.pi * 8.0 * r.t_s + 0.3))
    tone = strongest_tone(fit)
    assert tone.channel == "output_V"
    assert tone.frequency_Hz == pytest.approx(8.0, abs=0.08)
    assert tone.rms == pytest.approx(0.002 / np.sqrt(2) / SIGMA["output_V"], rel=0.15)
    assert tone.width_Hz in [pytest.approx(1 / (0.02 * n)) for n in (900, 700)]
    assert strongest_tone(fit_with_change("output_V", lambda r: 0.0)) is None
    assert loose_noise(fit).stage == "electronics"
    assert (
        loose_noise(fit_with_change("force_N", lambda r: 0.02 * np.sin(2 * np.pi * 8.0 * r.t_s))).stage == "load_cell"
    )


def test_a_tone_of_one_of_two_runs_is_none():
    fit = fit_with_change("output_V", lambda r: 0.002 * np.sin(2 * np.pi * 8.0 * r.t_s) * (r.name == "1"))
    assert strongest_tone(fit) is None
    apart = fit_with_change("output_V", lambda r: 0.002 * np.sin(2 * np.pi * (8.0 + 3.0 * (r.name == "1")) * r.t_s))
    assert strongest_tone(apart) is None


def test_what_is_slow_is_no_tone():
    assert strongest_tone(fit_with_change("output_V", lambda r: 0.003 * np.sin(2 * np.pi * 1.3 * r.t_s))) is None


def test_tones_are_the_same_within_both_widths():
    tone = Tone("output_V", 8.0, 1.0, 0.1)
    assert tone.is_same(replace(tone, frequency_Hz=8.29, width_Hz=0.2))
    assert not tone.is_same(replace(tone, frequency_Hz=8.31, width_Hz=0.2))
    assert not tone.is_same(replace(tone, channel="force_N"))


def test_single_samples_far_off_are_spikes():
    rng = np.random.default_rng(2)
    fit = fit_with_change("output_V", lambda r: 0.03 * (rng.random(len(r)) < 0.02))
    loose = loose_noise(fit)
    assert loose.stage == "electronics" and loose.detail.code == "gap.seen.spikes"
    few = np.zeros(900)
    few[[50, 300, 650]] = 0.03
    assert loose_noise(fit_with_change("output_V", lambda r: few[: len(r)] * (r.name == "1"))) is None


def test_a_clock_that_jitters_makes_fast_samples_noisy():
    rng = np.random.default_rng(2)
    fit = fit_with_change("output_V", lambda r: np.gradient(r.stage_mm, r.t_s) * rng.uniform(-0.0016, 0.0016, len(r)))
    loose = loose_noise(fit)
    assert (loose.stage, loose.detail.code) == ("acquisition", "gap.seen.jitter")
    # Noise that grows with the load is none of the clock.
    assert (
        loose_noise(fit_with_change("output_V", lambda r: 0.003 * (r.stage_mm > 2.0) * rng.normal(0, 1, len(r))))
        is None
    )


def stage_of(channel, change, maps):
    return likely_stages(fit_with_change(channel, change), mapped(**maps))[0]


STRUCTURED_BEFORE, STRUCTURED_BEHIND = {"sf": 90.0, "fo": 1.0, "so": 90.0}, {"sf": 1.0, "fo": 90.0, "so": 90.0}


def test_within_a_group_the_residual_tells():
    ripple = lambda r: 0.1 * np.sin(2 * np.pi * r.stage_mm / 0.4) * (r.stage_mm > 0.35)  # noqa: E731
    assert stage_of("force_N", ripple, STRUCTURED_BEFORE) == "motion"
    weaker = lambda r: -0.02 * r.elapsed_s * r.force_N  # noqa: E731
    assert stage_of("force_N", weaker, STRUCTURED_BEFORE) == "mechanics"
    curvature = lambda r: 0.02 * (r.stage_mm / 3.0) ** 4  # noqa: E731
    assert stage_of("output_V", curvature, STRUCTURED_BEHIND) == "transduction"
    wavy = lambda r: 0.02 * np.sin(2 * np.pi * r.output_V / 0.06)  # noqa: E731
    assert stage_of("output_V", wavy, STRUCTURED_BEHIND) == "electronics"
    late = lambda r: 0.05 * np.gradient(r.output_V, r.t_s)  # noqa: E731
    clean_late = fit_with_change("output_V", lambda r: 0.0)
    assert stage_of("output_V", late, STRUCTURED_BEHIND) in ("acquisition", "transduction")
    assert likely_stages(clean_late, mapped(sf=1.0, fo=1.0, so=1.0)) == ()


def test_what_errs_at_rest_comes_from_behind_pad_and_channel():
    slow = lambda r: 0.02 * np.sin(2 * np.pi * 1.1 * r.t_s)  # noqa: E731
    assert stage_of("output_V", lambda r: slow(r) * (r.stage_mm < 0.35), STRUCTURED_BEHIND) == "electronics"
    assert stage_of("output_V", lambda r: slow(r) * (r.stage_mm > 1.5), STRUCTURED_BEHIND) == "transduction"


def test_loose_noise_comes_first_where_maps_are_hardly_dirty():
    fit = fit_with_change("output_V", lambda r: 0.002 * np.sin(2 * np.pi * 8.0 * r.t_s))
    faint = METHOD.fault_location.faint_z
    assert likely_stages(fit, mapped(sf=0.9 * faint, fo=1.0, so=0.9 * faint))[0] == "electronics"
    assert likely_stages(fit, mapped(sf=1.1 * faint, fo=0.1, so=1.1 * faint))[0] == "mechanics"


def test_the_chain_offers_what_its_base_knows():
    fit = pad_fit(Problem(TWIN, case_of(run_of(temperature_C=20.0 + np.arange(400) * 0.01)), SIGMA))
    columns = explanatory_chain_signals(fit, "output_V")
    run, block = fit.problem.case.runs[0], fit.problem.blocks_of("output_V")[0]
    rows = [c[block.rows] for c in columns]
    other = fit.problem.blocks_of("force_N")[0]
    assert all(not c[other.rows].any() for c in columns)
    depth = np.maximum(run.stage_mm - fit.base.u0_mm, 0.0)
    load = elastic(depth) / elastic(depth).max()
    for expected in (run.elapsed_s, run.stage_mm, run.temperature_rise_K, np.maximum.accumulate(depth) / depth.max()):
        assert any(np.allclose(row, expected, atol=1e-6) for row in rows)
    rate = np.gradient(load, run.elapsed_s)
    for expected in (rate, load * rate, np.sign(rate), load * run.elapsed_s, load * run.temperature_rise_K):
        assert min(np.max(np.abs(row - expected)) for row in rows) < 0.02 * np.abs(expected).max() + 1e-9
    hats = METHOD.noise_test.hats
    np.testing.assert_allclose(np.sum(rows[:hats], axis=0)[depth > depth.max() / hats], 1.0, atol=1e-9)
    for tau_s in METHOD.noise_test.memory_s:
        memory = low_pass(load, run.step_s, tau_s, np.zeros(2))
        assert min(np.max(np.abs(row - memory)) for row in rows) < 0.01
    np.testing.assert_array_equal(TWIN.halves(fit, block)[0], run.stage_mm > fit.base.u0_mm)


# Unmodelled effects and free forms.


def test_a_departure_multiplies_or_adds_what_it_follows():
    flow = SimpleNamespace(force_N=np.array([2.0, 4.0]), t_s=np.array([1.0, 3.0]))
    changing("force_N", lambda f: f.t_s)(flow, (0.1,), {})
    np.testing.assert_allclose(flow.force_N, [2.2, 5.2])
    changing("force_N", lambda f: f.t_s, is_offset=True)(flow, (0.1,), {})
    np.testing.assert_allclose(flow.force_N, [2.3, 5.5])
    for one in (*UNMODELLED_EFFECTS, WARM_DIVIDER):
        (size,) = one.parameters
        assert size.high == pytest.approx(30 * size.usual) and size.low in (0.0, -size.high) and size.neutral == 0.0


@pytest.mark.parametrize(
    "name", ["stiffness_in_time", "offset_in_time", "cell_by_position", "cell_late", "sensitivity_in_time"]
)
def test_a_departure_of_another_kind_is_found(name):
    (one,) = [s for s in UNMODELLED_EFFECTS if s.id.endswith(name)]
    usual = 8.0 * one.parameters[0].usual
    measured = PROBLEM.bare.predict(Hypothesis((one,)), np.append(AT, usual))
    noise = PROBLEM.measured - PROBLEM.bare.predict(Hypothesis(), AT)
    parts = {(b.run, b.channel): (measured + noise)[b.rows] for b in PROBLEM.blocks}
    runs = tuple(
        replace(r, force_N=parts[k, "force_N"], output_V=parts[k, "output_V"]) for k, r in enumerate(CASE.runs)
    )
    base = fit(Problem(TWIN, Case("S", runs), SIGMA), Hypothesis(), AT)
    unmodelled = best_unmodelled(base, [base], [base])
    assert unmodelled.effects[0].id == one.id
    assert unmodelled.effect_values[0][0] == pytest.approx(usual, rel=0.15)
    clean = pad_fit()
    assert best_unmodelled(clean, [clean], [clean]) is None


def test_a_free_form_of_a_cause_takes_what_looks_like_it():
    relax = EFFECTS["stress_relaxation"]
    measured = PROBLEM.bare.predict(Hypothesis((relax,)), np.array([*AT, 0.15, np.log(0.3)]))
    # A second, slower relaxation is another equation of the first.
    more = PROBLEM.bare.predict(Hypothesis((relax,)), np.array([*AT, 0.1, np.log(3.0)])) - PROBLEM.bare.predict(
        Hypothesis(), AT
    )
    noise = PROBLEM.measured - PROBLEM.bare.predict(Hypothesis(), AT)
    parts = {(b.run, b.channel): (measured + more + noise)[b.rows] for b in PROBLEM.blocks}
    runs = tuple(
        replace(r, force_N=parts[k, "force_N"], output_V=parts[k, "output_V"]) for k, r in enumerate(CASE.runs)
    )
    problem = Problem(TWIN, Case("S", runs), SIGMA).bare
    rest = fit(problem, Hypothesis((relax,)), np.array([*AT, 0.2, np.log(0.5)]))
    best = replace(rest, chi2=float(problem.count))
    assert 0.5 < surrogate_share(rest, best) <= 1.2
    assert surrogate_share(rest, rest) == 0.0
    bare = fit(problem, Hypothesis(), AT)
    assert surrogate_share(bare, best) == 0.0
    assert causes_with_surrogate(best, {"x": rest}) == (
        ["x"] if surrogate_share(rest, best) >= METHOD.unmodelled.surrogate_share else []
    )


# Twins to go on with.


def test_an_explained_twin_has_the_fitted_base_noise_and_causes():
    lag = EFFECTS["readout_lag"]
    result = pad_fit(PROBLEM, lag, values=[(0.05,)])
    twin = explained_twin(result)
    for p in BASE:
        assert getattr(twin.parameters, p.name) == getattr(result.base, p.name)
    assert twin.parameters.sigma_force_N == SIGMA["force_N"]
    assert twin.parameters.sigma_output_V == pytest.approx(np.sqrt(SIGMA["output_V"] ** 2 - READOUT.step_V**2 / 12))
    (setting,) = twin.effects
    assert (setting.effect_id, setting.form) == ("readout_lag", "")
    assert setting.values["tau"] == result.effect_values[0][0]
    term = EmpiricalTerm("F", "t", 0.1, 5.0, 2.0)
    assert explained_twin(result, [term]).empirical == (term,)
    with_lost_samples = pad_fit(PROBLEM, EFFECTS["dropped_samples"], values=[(3.0,)])
    assert explained_twin(with_lost_samples).effects == ()
    coarse = Problem(TWIN, case_of(run_of(readout=replace(READOUT, adc_bits=8))), {"force_N": 0.01, "output_V": 0.004})
    assert explained_twin(pad_fit(coarse)).parameters.sigma_output_V == dither_of(coarse)
    quiet = Problem(TWIN, CASE, {"force_N": 0.01, "output_V": 0.1 * READOUT.step_V})
    assert explained_twin(fit(replace(quiet, of_rig=None), Hypothesis(), AT, steps=0)).parameters.sigma_output_V >= 0.0
    no_cell = Problem(TWIN, case_of(run_of(force_N=None)), {"output_V": 0.001})
    assert explained_twin(pad_fit(no_cell)).parameters.sigma_force_N == 0.0


def test_a_form_is_named_and_taken_back_to_the_catalogue():
    lag = EFFECTS["readout_lag"]
    second = lag.find_form("second order")
    assert (form_of(pad_fit(PROBLEM), second), form_of(pad_fit(PROBLEM), lag)) == ("second order", "")
    second_order = pad_fit(PROBLEM, second, values=[(0.05, 0.001)])
    twin = explained_twin(second_order)
    assert twin.effects[0].form == "second order" and set(twin.effects[0].values) == {"tau", "tau2"}
    back = in_catalogue_form(second_order)
    assert back.effects == (lag,)
    assert back.effect_values[0][0] == pytest.approx(second_order.effect_values[0][0], abs=0.01)
    assert in_catalogue_form(back) is back


def test_constants_of_a_form_become_one_number_for_all_runs():
    form = next(f.effect for f in EFFECTS["channel_hysteresis"].forms if f.effect.constants)
    result = fit(PROBLEM.bare, Hypothesis((form,)), np.array([*AT, 0.02, 0.02, 0.02, 0.02]), steps=0)
    closed = with_constants(result)
    ((name, value),) = closed.effects[0].constants
    assert name == "reach_N"
    assert value == pytest.approx(max(elastic(np.maximum(0.0, r.stage_mm - 0.35)).max() for r in CASE.runs))
    assert with_constants(closed) is closed
    assert pad_fit().effects == () and with_constants(pad_fit()).effects == ()


def test_a_candidate_of_the_twin_ends_at_the_truth():
    measured = PROBLEM.bare.predict(Hypothesis((EFFECTS["wiring_resistance"],)), np.append(AT, 1.5))
    noise = PROBLEM.measured - PROBLEM.bare.predict(Hypothesis(), AT)
    parts = {(b.run, b.channel): (measured + noise)[b.rows] for b in PROBLEM.blocks}
    runs = tuple(
        replace(r, force_N=parts[k, "force_N"], output_V=parts[k, "output_V"]) for k, r in enumerate(CASE.runs)
    )
    base = fit(Problem(TWIN, Case("S", runs), SIGMA), Hypothesis(), AT)
    (candidate,) = screen(base, [Probe(EFFECTS["wiring_resistance"], (0.3,), True)])
    assert candidate.values[0] > 0.0 and candidate.hidden > 0.9
    assert fit_jointly(base, candidate).effect_values[0][0] == pytest.approx(1.5, rel=0.25)


# What could be recorded.


def test_a_menu_has_what_the_rig_can_record():
    at = ExcitationRange(2.5, 6.0, 1.0, 2.0, 8.0, 0.02)
    every = {e.name for e in menu(CASE, at)}
    assert {"rate_sweep", "rest", "dummy_resistor", "dead_weights", "rigid_block", "small_reversals"} <= every
    no_stage = {e.name for e in menu(case_of(run_of(stage_mm=None)), at)}
    assert no_stage == {"rest", "dummy_resistor", "dead_weights"}
    no_force = {e.name for e in menu(case_of(run_of(force_N=None)), at)}
    assert not {"dead_weights", "rigid_block"} & no_force and "dummy_resistor" in no_force
    for entry in menu(CASE, at):
        run = entry.run
        assert run.is_planned
        seconds = run.elapsed_s[-1]
        assert 0.4 + seconds / 60 < entry.minutes < 2.1 + (seconds + 0.1) / 60, entry.name
        if run.kind == "press":
            assert run.stage_mm.max() <= 2.5 + 1e-9
            assert not run.force_N.any() and not run.output_V.any()
    by_name = {e.name: e.run for e in menu(CASE, at)}
    weights = by_name["dead_weights"].known_force_N
    assert (weights.min(), weights.max()) == (0.0, 6.0)
    np.testing.assert_allclose(np.unique(np.round(weights, 9)), np.linspace(0.0, 6.0, 6))
    block = by_name["rigid_block"].force_N
    assert (block[0], block[-1]) == pytest.approx((0.0, 0.0), abs=1e-9) and block.max() == pytest.approx(6.0, rel=1e-2)
    assert {e.run.dummy_ohm for e in menu(CASE, at) if e.name == "dummy_resistor"} == {5.0, 20.0}
    assert by_name["rest"].elapsed_s[-1] == pytest.approx(120.0, abs=0.05)
    assert by_name["long_hold"].elapsed_s[-1] > 300.0


# Every departure outside the catalogue, by its equation.


WARM_C = 22.0 + 4.0 * np.sin(np.arange(400) * 0.02)
WARM_CASE = case_of(run_of(1, noise=0.0, temperature_C=WARM_C))
T400, RISE_K = np.arange(400) * 0.02, WARM_C - 22.0
STAGE_mm = run_of(1, noise=0.0).stage_mm
FORCE_N = elastic(np.maximum(0.0, STAGE_mm - 0.35))


def read(force=FORCE_N, drive=None, reading=None, factor=1.0, offset_V=0.0):
    """Reading and output where one signal of the chain is another one."""
    drive = force if drive is None else drive
    ohm = 4.0 / (1.0 - 0.06 * drive) / factor
    return (force if reading is None else reading), volt(ohm) + offset_V


SIZE = 0.01
DEPARTURES = {
    "stiffness_in_time": read(FORCE_N * (1 + SIZE * T400)),
    "stiffness_when_warm": read(FORCE_N * (1 + SIZE * RISE_K)),
    "sensitivity_in_time": read(drive=FORCE_N * (1 + SIZE * T400)),
    "sensitivity_when_warm": read(drive=FORCE_N * (1 + SIZE * RISE_K)),
    "offset_in_time": read(offset_V=SIZE * T400),
    "offset_when_warm": read(offset_V=SIZE * RISE_K),
    "cell_span_in_time": read(reading=FORCE_N * (1 + SIZE * T400)),
    "cell_span_when_warm": read(reading=FORCE_N * (1 + SIZE * RISE_K)),
    "cell_zero_when_warm": read(reading=FORCE_N + SIZE * RISE_K),
    "cell_by_position": read(reading=FORCE_N + SIZE * STAGE_mm),
    "divider_when_warm": read(factor=1 + SIZE * RISE_K),
}


@pytest.mark.parametrize(
    "one", [s for s in (*UNMODELLED_EFFECTS, WARM_DIVIDER) if not s.id.endswith("late")], ids=lambda s: s.id
)
def test_a_departure_is_its_equation(one):
    reading, output = DEPARTURES[one.id.removeprefix("gap.like.")]
    problem = Problem(TWIN, WARM_CASE, SIGMA).bare
    out = problem.predict(Hypothesis((one,)), np.append(AT, SIZE))
    np.testing.assert_allclose(out[:400], reading, atol=1e-9)
    np.testing.assert_allclose(out[400:], output, atol=1e-9)


def test_a_late_cell_follows_by_a_low_pass():
    (late,) = [s for s in UNMODELLED_EFFECTS if s.id.endswith("cell_late")]
    out = Problem(TWIN, WARM_CASE, SIGMA).bare.predict(Hypothesis((late,)), np.append(AT, 0.2))[:400]
    y, expected = FORCE_N[0], [FORCE_N[0]]
    for k in range(1, 400):
        for i in range(200):
            x = FORCE_N[k - 1] + (FORCE_N[k] - FORCE_N[k - 1]) * (i + 0.5) / 200
            y += 0.02 / 200 / 0.2 * (x - y)
        expected.append(y)
    np.testing.assert_allclose(out, expected, atol=2e-3)


def test_what_needs_warmth_or_a_channel_is_not_tried_without():
    measured = Problem(TWIN, WARM_CASE, SIGMA).bare.predict(Hypothesis((UNMODELLED_EFFECTS[5],)), np.append(AT, 0.01))
    noise = np.random.default_rng(3).normal(size=800) * np.repeat([0.01, 0.001], 400)
    run = replace(WARM_CASE.runs[0], force_N=(measured + noise)[:400], output_V=(measured + noise)[400:])
    for is_warm in (True, False):
        one = run if is_warm else replace(run, temperature_C=None)
        base = fit(Problem(TWIN, case_of(one), SIGMA), Hypothesis(), AT)
        unmodelled = best_unmodelled(base, [base], [base])
        if is_warm:
            assert unmodelled.effects[0].id == UNMODELLED_EFFECTS[5].id
            assert unmodelled.effect_values[0][0] == pytest.approx(0.01, rel=0.1)
        else:
            assert unmodelled is None or not unmodelled.effects[0].id.endswith("warm")


# Terms that runs can show.


def test_terms_of_the_twin_are_those_its_channels_show():
    warm = case_of(run_of(1, temperature_C=WARM_C))
    every = list(terms_of_twin(pad_fit(Problem(TWIN, warm, SIGMA))))
    assert {(t.place, t.variable) for t in every} == {(p, v) for p in ("F", "force_N", "output_V") for v in VARIABLES}
    base = pad_fit(Problem(TWIN, warm, SIGMA)).base
    depth = run_of(1).stage_mm.max() - base.u0_mm
    assert every[0].depth_mm == pytest.approx(depth)
    assert every[0].load_N == pytest.approx(base.k1_N_mm * depth + base.k3_N_mm3 * depth**3)
    assert all(t.coefficient == 0.0 for t in every)
    plain = {(t.place, t.variable) for t in terms_of_twin(pad_fit(Problem(TWIN, case_of(run_of(1)), SIGMA)))}
    assert plain == {
        (p, v) for p in ("F", "force_N", "output_V") for v in VARIABLES if VARIABLES[v].needs != "temperature_C"
    }
    blind_case = case_of(run_of(1, stage_mm=None))
    blind = list(terms_of_twin(fit(Problem(TWIN, blind_case, SIGMA), Hypothesis(), AT)))
    assert {t.place for t in blind} == {"output_V"}
    assert {t.variable for t in blind} == {v for v in VARIABLES if not VARIABLES[v].needs}
    largest = blind_case.runs[0].driving_force.force_N.max()
    assert (blind[0].load_N, blind[0].depth_mm) == pytest.approx((largest, largest))
