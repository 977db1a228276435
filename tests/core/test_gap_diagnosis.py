"""Diagnoses of simulated cases: the planted cause is named, the rest is said honestly."""

import dataclasses
import json

import numpy as np
import pytest

from softcal.core import profiles
from softcal.core.errors import InputError
from softcal.core.gap.case import Case, Run
from softcal.core.gap.episodes import with_intervals, with_line, with_losses
from softcal.core.gap.evidence import in_catalogue_form, with_constants
from softcal.core.gap.fault_location import explained_twin
from softcal.core.gap.fit import fit, structure
from softcal.core.gap.hypothesis import Hypothesis, start_coordinates
from softcal.core.gap.twin import TWIN, diagnose
from softcal.core.twin.catalogue import EFFECTS
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.simulate import EffectSetting, Twin, simulate, twin_from_record, twin_record

READOUT = ReadoutMetadata(vref_V=3.3, adc_bits=12, r_series_ohm=10.0, sample_rate_Hz=50.0)
BASE = BaseParameters(u0_mm=0.35, k1_N_mm=1.1, k3_N_mm3=0.1, kappa_per_N=0.06, sigma_force_N=0.015)
DEPTH_mm = 3.1
CEILING_V, LOW_STOP_V = 1.38, 0.97
SINGLES = {
    "backlash": {"b": 0.05},
    "stress_relaxation": {"g": 0.1, "tau": 5.0},
    "channel_creep": {"c": 0.08, "tau": 5.0},
    "thermal_drift": {"alpha": 0.002},
    "readout_lag": {"tau": 0.08},
    "mains_hum": {"A": 0.004, "f": 10.0},
    "adc_saturation": {"V_max": 1.17},
    "loadcell_drift": {"r": 0.001},
    "clock_skew": {"epsilon": 0.001},
}


def make_case(*effects, profiles_=None, seed=1, base=BASE, readout=READOUT):
    rng = np.random.default_rng(seed)
    press_profiles = profiles_ or (
        profiles.ramps([DEPTH_mm] * 2, 0.6),
        profiles.ramps([DEPTH_mm] * 6, 4.0),
        profiles.steps_with_holds([1.2, 2.4, DEPTH_mm, 1.8], hold_s=4.0),
        profiles.random_presses(rng, 20.0, DEPTH_mm),
    )
    runs = []
    for k, profile in enumerate(press_profiles):
        t_s, stage_mm = profile.sample(50.0)
        temperature_C = 22.0 + 3.0 * (1 - np.exp(-t_s / 10.0)) + 0.3 * np.sin(t_s / 3.0 + k)
        settings = tuple(EffectSetting(e, v, ep) for e, v, ep in effects)
        force_N, output_V = simulate(Twin(base, settings, readout), t_s, stage_mm, rng, temperature_C)
        runs.append(Run(f"run {k}", t_s, readout, stage_mm, force_N, output_V, temperature_C, profile=profile.name))
    return Case("G1", tuple(runs))


@pytest.fixture(scope="module")
def plain():
    return make_case()


def test_base_data_give_no_gap(plain):
    diagnosis = diagnose(plain)
    assert diagnosis.verdict == "no_gap"
    assert diagnosis.causes[0].probability < 0.5
    assert diagnosis.locations == ()


@pytest.mark.parametrize("effect_id", SINGLES)
def test_a_single_effect_is_named_and_closes_the_gap(effect_id):
    diagnosis = diagnose(make_case((effect_id, SINGLES[effect_id], ())))
    first = diagnosis.causes[0]
    assert first.effect == effect_id and first.probability > 0.5
    assert diagnosis.verdict in ("explained", "ambiguous")
    assert diagnosis.locations[0].stage == first.stage
    assert diagnosis.explained_fraction.held_out > 0.9
    assert abs(diagnosis.explained_fraction.held_out - diagnosis.explained_fraction.predicted) < 0.1
    report = diagnosis.report()
    assert effect_id in {entry["effect"] for entry in report["twin"]["effects"]}
    assert twin_from_record(report["twin"], "report").effects


def test_a_cause_that_explains_nothing_on_unseen_samples_is_not_named(monkeypatch, plain):
    from softcal.core.gap import diagnosis as module

    measured = module.quantify
    lagging = make_case(("readout_lag", SINGLES["readout_lag"], ()))
    assert measured(*_fits_of(diagnose(lagging))).held_out_gain > 100.0
    monkeypatch.setattr(module, "quantify", lambda *fits: dataclasses.replace(measured(*fits), held_out_gain=-1.0))
    diagnosis = diagnose(lagging)
    assert diagnosis.verdict == "unknown" and diagnosis.causes[0].probability < 0.5
    assert explained_twin(diagnosis.best).effects == ()
    assert diagnosis.partial.effects == ("readout_lag",) and diagnosis.partial.share > 0.9


def _fits_of(diagnosis):
    return diagnosis.base, diagnosis.best


@pytest.mark.long
def test_shares_of_an_unknown_gap_are_measured_or_equal():
    case = make_case(seed=4)
    slipping = [
        dataclasses.replace(run, force_N=run.force_N + 0.2 * np.sign(np.gradient(run.stage_mm))) for run in case.runs
    ]
    diagnosis = diagnose(dataclasses.replace(case, runs=tuple(slipping)))
    assert diagnosis.verdict == "unknown"
    stages = [p for p in diagnosis.locations if "of the gap's energy" not in str(p.detail)]
    assert {p.share for p in stages} == {diagnosis.where.regimes[0].share}
    assert diagnosis.report()["partial"]["share"] == diagnosis.partial.share


def test_fitted_values_lie_near_the_planted_ones():
    diagnosis = diagnose(make_case(("stress_relaxation", {"g": 0.1, "tau": 5.0}, ())))
    g, tau = (diagnosis.causes[0].parameters[name] for name in ("g", "tau"))
    assert g.value == pytest.approx(0.1, abs=0.004) and g.low < g.value < g.high
    assert tau.value == pytest.approx(5.0, rel=0.1)
    assert diagnosis.best.base.k1_N_mm == pytest.approx(BASE.k1_N_mm, rel=0.01)


def test_lost_samples_are_found_in_place_and_number():
    diagnosis = diagnose(make_case(("dropped_samples", {}, ((6.0, 5),))))
    assert diagnosis.causes[0].effect == "dropped_samples"
    rows = [diagnosis.best.hypothesis.episodes_of(k)["dropped_samples"] for k in range(4)]
    assert all(r[:, 1].sum() == 5 for r in rows)
    for run, lost_rows in zip(diagnosis.case.runs, rows, strict=True):
        # Within a hold nobody can tell where samples are missing.
        first_s, last_s = sorted((lost_rows[0, 0], 6.0))
        in_interval = (run.elapsed_s >= first_s) & (run.elapsed_s <= last_s)
        assert last_s - first_s < 0.5 or np.ptp(run.stage_mm[in_interval]) < 1e-6


@pytest.mark.parametrize("seed", [121, 122])
def test_losses_are_found_although_a_run_has_a_seat_of_its_own(seed):
    rng = np.random.default_rng(seed)
    losses = tuple(sorted((float(rng.uniform(3.0, 12.0)), int(rng.integers(3, 20))) for _ in range(3)))
    base = TWIN.base_fit(make_case(("dropped_samples", {}, losses), seed=seed))
    refitted = with_losses(base, EFFECTS["dropped_samples"])
    rows = [refitted.hypothesis.episodes_of(k)["dropped_samples"] for k in range(4)]
    assert [r[:, 1].sum() for r in rows] == [sum(count for _, count in losses)] * 4
    assert not structure(refitted).is_significant


def test_a_bad_contact_jumps_and_a_smooth_gap_does_not():
    contact = EFFECTS["intermittent_contact"]
    jumping = TWIN.base_fit(make_case(("intermittent_contact", {"dR": 0.1}, ((4.0, 5.2), (11.0, 11.5)))))
    assert with_intervals(jumping, contact) is not None
    for effect in (("channel_creep", {"c": 0.2}, ()), ("mullins_softening", {}, ()), ("readout_lag", {}, ())):
        assert with_intervals(TWIN.base_fit(make_case(effect)), contact) is None


@pytest.mark.parametrize(
    ("rate_Hz", "slow_Hz", "is_hum"), [(10.0, 0.2, False), (50.0, 0.2, False), (50.0, 10.02, True)]
)
def test_hum_is_a_line_where_mains_can_stand(rate_Hz, slow_Hz, is_hum):
    case = make_case()
    every = round(50.0 / rate_Hz)
    readout = dataclasses.replace(READOUT, sample_rate_Hz=rate_Hz)
    runs = []
    for run in case.runs:
        columns = {n: getattr(run, n)[::every] for n in ("t_s", "stage_mm", "force_N", "output_V", "temperature_C")}
        columns["output_V"] = columns["output_V"] + 0.005 * np.sin(2 * np.pi * slow_Hz * columns["t_s"])
        runs.append(dataclasses.replace(run, readout=readout, **columns))
    hum = with_line(TWIN.base_fit(Case("G1", tuple(runs))), EFFECTS["mains_hum"])
    assert (hum is not None) == is_hum


def test_two_effects_of_different_stages_are_both_named():
    diagnosis = diagnose(make_case(("channel_hysteresis", {}, ()), ("loadcell_creep", {}, ())))
    assert {c.effect for c in diagnosis.causes[:2]} == {"channel_hysteresis", "loadcell_creep"}
    assert {p.stage for p in diagnosis.locations[:2]} == {"transduction", "load_cell"}


@pytest.mark.long
def test_a_soft_frame_beside_a_large_cause_is_named_or_held_open_until_a_rigid_block_tells():
    case = make_case(("channel_collapse", {"beta": 0.025, "Fc": 4.0}, ()), ("frame_compliance", {"c_f": 0.03}, ()))
    diagnosis = diagnose(case)
    in_play = {i for competitor in diagnosis.competing_hypotheses for i in competitor.hypothesis.ids}
    assert in_play == {"channel_collapse", "frame_compliance"}
    if diagnosis.verdict == "ambiguous":
        assert diagnosis.ambiguous_with == [["channel_collapse", "frame_compliance"]]
        assert diagnosis.next_experiment.profile == "rigid_block"
        chances = {c.effect: c.probability for c in diagnosis.causes}
        assert 0.05 < chances["frame_compliance"] < 0.95 < chances["channel_collapse"]


@pytest.mark.long
def test_a_small_cause_that_the_equation_of_a_large_one_might_leave_is_held_open():
    case = make_case(("dropped_samples", {}, ((6.0, 12),)), ("frame_compliance", {"c_f": 0.04}, ()))
    diagnosis = diagnose(case)
    assert {i for competitor in diagnosis.competing_hypotheses for i in competitor.hypothesis.ids} == {
        "dropped_samples",
        "frame_compliance",
    }


@pytest.mark.long
def test_a_frame_with_a_toe_is_not_called_a_joint_that_closes_alone():
    diagnosis = diagnose(make_case(("frame_compliance", {"c_f": 0.05}, ()), ("misaligned_contact", {"l": 0.3}, ())))
    assert {i for competitor in diagnosis.competing_hypotheses for i in competitor.hypothesis.ids} == {
        "frame_compliance",
        "misaligned_contact",
    }


@pytest.mark.long
def test_samples_lost_beside_a_fast_clock_are_distinguished_from_it():
    diagnosis = diagnose(make_case(("dropped_samples", {}, ((6.0, 6),)), ("clock_skew", {"epsilon": 0.0015}, ())))
    assert {c.effect for c in diagnosis.causes if c.probability > 0.5} == {"dropped_samples", "clock_skew"}
    skew = next(c for c in diagnosis.causes if c.effect == "clock_skew").parameters["epsilon"]
    assert skew.value == pytest.approx(0.0015, rel=0.05)


@pytest.mark.long
def test_the_quiet_flat_top_of_a_clipped_output_is_not_taken_for_jitter_elsewhere():
    runs = []
    for run in make_case(("wiring_resistance", {"Rw": 2.0}, ())).runs:
        clipped_V = np.minimum(run.output_V, CEILING_V)
        assert np.mean(clipped_V == CEILING_V) > 0.01
        runs.append(dataclasses.replace(run, output_V=clipped_V))
    diagnosis = diagnose(Case("G1", tuple(runs)))
    assert diagnosis.verdict in ("explained", "ambiguous")
    assert "adc_saturation" in {c.effect for c in diagnosis.causes if c.probability > 0.5}


@pytest.mark.long
def test_two_relaxation_times_are_still_stress_relaxation():
    case = make_case()
    runs = []
    for run in case.runs:
        drop = sum(g * _low_pass(run.force_N, tau) for g, tau in ((0.06, 0.5), (0.06, 12.0)))
        force_N = np.maximum(0.0, run.force_N - drop)
        resistance = 4.0 / (1 - 0.06 * force_N)
        clean_V = 3.3 * resistance / (resistance + 10.0)
        output_V = np.round(clean_V / READOUT.step_V) * READOUT.step_V
        runs.append(dataclasses.replace(run, force_N=force_N, output_V=output_V))
    diagnosis = diagnose(Case("G1", tuple(runs)))
    assert diagnosis.causes[0].effect == "stress_relaxation"
    assert diagnosis.verdict in ("explained", "ambiguous")


def _low_pass(signal, tau_s):
    out, y = [], 0.0
    for x in signal:
        y += (1 - np.exp(-0.02 / tau_s)) * (x - y)
        out.append(y)
    return np.array(out)


@pytest.mark.long
def test_a_cause_outside_the_catalogue_is_unknown():
    case = make_case()
    pitch = [run.stage_mm + 0.03 * np.sin(2 * np.pi * run.stage_mm / 0.4) for run in case.runs]
    runs = []
    for run, pad_mm in zip(case.runs, pitch, strict=True):
        force_N, output_V = simulate(Twin(BASE, (), READOUT), run.t_s, pad_mm, np.random.default_rng(3))
        runs.append(dataclasses.replace(run, force_N=force_N, output_V=output_V))
    diagnosis = diagnose(Case("G1", tuple(runs)))
    assert diagnosis.verdict == "unknown"
    assert diagnosis.locations[0].stage in ("motion", "mechanics") and str(diagnosis.locations[0].detail)


@pytest.mark.long
def test_an_output_offset_that_drifts_is_not_blamed_on_ageing():
    case = make_case()
    runs = []
    for run in case.runs:
        drifting_V = run.output_V + 4e-4 * run.elapsed_s
        runs.append(dataclasses.replace(run, output_V=np.round(drifting_V / READOUT.step_V) * READOUT.step_V))
    diagnosis = diagnose(Case("G1", tuple(runs)))
    assert diagnosis.verdict == "unknown"
    assert diagnosis.locations[0].stage == "electronics"


@pytest.mark.long
def test_the_forecast_of_a_half_explained_gap_counts_the_noise_of_a_driving_force():
    runs = []
    for run in make_case().runs:
        wavy_V = run.output_V + 0.02 * np.sin(60.0 * run.output_V)
        noisy_N = run.force_N + np.random.default_rng(5).normal(0.0, 0.05, len(run))
        output_V = np.round(wavy_V / READOUT.step_V) * READOUT.step_V
        runs.append(dataclasses.replace(run, stage_mm=None, force_N=noisy_N, output_V=output_V))
    diagnosis = diagnose(Case("G1", tuple(runs)))
    assert diagnosis.verdict == "unknown"
    assert abs(diagnosis.explained_fraction.predicted - diagnosis.explained_fraction.held_out) < 0.15


def test_drift_of_reference_and_channel_without_temperature_is_resolved_or_called_ambiguous():
    case = make_case(("ageing_drift", {"gamma": 0.004, "tau": 60.0}, ()))
    case = Case("G1", tuple(dataclasses.replace(run, temperature_C=None) for run in case.runs))
    diagnosis = diagnose(case)
    competing_ids = {i for competitor in diagnosis.competing_hypotheses for i in competitor.hypothesis.ids}
    assert "ageing_drift" in competing_ids
    assert diagnosis.case.missing_channels == ("temperature_C",)
    if diagnosis.verdict == "ambiguous":
        assert diagnosis.ambiguous_with and str(diagnosis.next_experiment.why)


def test_the_report_is_the_contract(plain):
    report = json.loads(json.dumps(diagnose(plain).report(), allow_nan=False))
    assert {
        "schema",
        "verdict",
        "gap",
        "shrink",
        "where",
        "causes",
        "ambiguous_with",
        "hidden_fraction",
        "next_experiment",
        "missing_channels",
    } <= set(report)
    assert set(report["gap"]) == {"output", "force"} and len(report["causes"]) == 25
    assert set(report["gap"]["force"]) == {"rmse_before", "rmse_after", "noise_floor"}


def test_a_fit_is_the_same_again(plain):
    assert diagnose(plain).report() == diagnose(plain).report()


@pytest.mark.parametrize("missing", ["force_N", "stage_mm", "output_V"])
def test_a_missing_channel_narrows_the_diagnosis(missing, plain):
    case = Case("G1", tuple(dataclasses.replace(run, **{missing: None}) for run in plain.runs))
    diagnosis = diagnose(case)
    assert missing in diagnosis.case.missing_channels
    assert diagnosis.verdict == "no_gap"
    hidden = {"force_N": "load_cell", "stage_mm": "mechanics", "output_V": "transduction"}[missing]
    assert all(c.probability == 0 for c in diagnosis.causes if c.stage == hidden)


def test_one_run_is_diagnosed_on_stretches_held_back():
    case = make_case(
        ("backlash", {"b": 0.1}, ()), profiles_=(profiles.random_presses(np.random.default_rng(2), 30, 3),)
    )
    diagnosis = diagnose(case)
    assert diagnosis.causes[0].effect == "backlash" and "stretches" in diagnosis.protocol


@pytest.mark.long
def test_special_runs_join_the_fit():
    case = make_case(("loadcell_nonlinearity", {"lambda": 0.05}, ()))
    t_s = np.arange(500) / 50.0
    weight_N = np.floor(t_s / 2.0) * 1.5
    read_N = weight_N * (1 + 0.05 * (1 - weight_N / 10.0)) + np.random.default_rng(1).normal(0, 0.015, 500)
    weights = Run("weights", t_s, READOUT, force_N=read_N, known_force_N=weight_N, kind="dead_weights")
    dummy_V = np.full(500, round(3.3 * 5 / 15 / READOUT.step_V) * READOUT.step_V)
    dummy = Run("dummy", t_s, READOUT, output_V=dummy_V, dummy_ohm=5.0, kind="dummy_resistor")
    rest = Run("rest", t_s, READOUT, output_V=np.full(500, 0.9428), kind="rest")
    diagnosis = diagnose(Case("G1", (*case.runs, weights, dummy, rest)))
    assert diagnosis.causes[0].effect == "loadcell_nonlinearity"


def warm_divider_V(ohm, rise_K, series_per_K):
    clean_V = 3.3 * ohm / (ohm + 10.0 * (1 + series_per_K * rise_K))
    noisy_V = clean_V + np.random.default_rng(7).normal(0, BASE.sigma_output_V, len(rise_K))
    return np.round(noisy_V / READOUT.step_V) * READOUT.step_V


def with_warmed_dummy(case, series_per_K):
    t_s = np.arange(3000) / 50.0
    warmth_C = 22.0 + 4.0 * (1 - np.exp(-t_s / 20.0))
    output_V = warm_divider_V(5.0, warmth_C - 22.0, series_per_K)
    special = {"dummy_ohm": 5.0, "kind": "dummy_resistor"}
    return Case("G1", (*case.runs, Run("dummy", t_s, READOUT, output_V=output_V, temperature_C=warmth_C, **special)))


@pytest.mark.long
def test_a_warm_divider_is_held_open_beside_thermal_drift_until_a_warmed_dummy_tells():
    runs = []
    for run in make_case().runs:
        ohm = BASE.r0_ohm / (1 - BASE.kappa_per_N * run.force_N)
        runs.append(dataclasses.replace(run, output_V=warm_divider_V(ohm, run.temperature_rise_K, 0.002)))
    case = Case("G1", tuple(runs))
    diagnosis = diagnose(case)
    assert diagnosis.causes[0].effect == "thermal_drift"
    assert {p.stage for p in diagnosis.locations[:2]} == {"transduction", "electronics"}
    assert diagnosis.next_experiment.profile == "dummy_resistor"
    diagnosis = diagnose(with_warmed_dummy(case, 0.002))
    assert diagnosis.verdict == "unknown"
    assert diagnosis.locations[0].stage == "electronics"


def test_a_warmed_dummy_that_stays_put_leaves_the_drift_to_the_channel():
    case = make_case(("thermal_drift", SINGLES["thermal_drift"], ()))
    diagnosis = diagnose(with_warmed_dummy(case, 0.0))
    assert diagnosis.causes[0].effect == "thermal_drift" and diagnosis.verdict == "explained"
    assert {p.stage for p in diagnosis.locations} == {"transduction"}
    assert diagnosis.next_experiment.profile == "none"


@pytest.mark.long
def test_the_explained_twin_foretells_an_unseen_profile():
    planted = ("mechanical_hysteresis", {"a": 0.06, "d0": 0.4}, ())
    twin = explained_twin(diagnose(make_case(planted)).best)
    t_s, stage_mm = profiles.rate_sweep(2.8).sample(50.0)
    truth = simulate(Twin(BASE, (EffectSetting(*planted[:2]),), READOUT), t_s, stage_mm)
    predicted = simulate(twin, t_s, stage_mm)
    assert np.sqrt(np.mean((predicted[0] - truth[0]) ** 2)) < 0.01
    assert np.sqrt(np.mean((predicted[1] - truth[1]) ** 2)) < 0.001


def test_a_cause_fitted_in_another_form_is_reported_by_the_catalogues_equation():
    base = TWIN.base_fit(make_case(("loadcell_nonlinearity", {"lambda": 0.05}, ())))
    form = EFFECTS["loadcell_nonlinearity"].forms[0]
    start = np.append(base.coordinates, start_coordinates([form.effect], [form.start([0.01, 10.0])]))
    lost_rows = fit(base.problem, Hypothesis((form.effect,)), start, steps=40)
    assert lost_rows.effect_values[0][0] != pytest.approx(0.05, abs=0.005)
    twin = explained_twin(in_catalogue_form(lost_rows))
    size, span_N = (twin.effects[0].values[name] for name in ("lambda", "F_max"))
    # With another capacity the same curve has another λ and another gain.
    assert size / span_N / (1 + size) ** 2 == pytest.approx(0.05 / 10.0 / 1.05**2, rel=0.06)
    assert twin.parameters.k1_N_mm * (1 + size) == pytest.approx(BASE.k1_N_mm * 1.05, rel=0.01)


@pytest.mark.parametrize("form", [f for e in EFFECTS.values() for f in e.forms], ids=lambda f: f.effect.equation)
def test_a_cause_enters_the_twin_by_the_form_it_was_fitted_in(form):
    base = TWIN.base_fit(make_case())
    # Size and shapes as usual on a rig; a level that the output does reach.
    values = [p.usual for p in EFFECTS[form.effect.id].parameters]
    values[0] = CEILING_V if form.effect.id == "adc_saturation" else values[0]
    start = np.append(base.coordinates, start_coordinates([form.effect], [form.start(values)]))
    lost_rows = with_constants(fit(base.problem.bare, Hypothesis((form.effect,)), start, steps=0))
    twin = explained_twin(lost_rows)
    (setting,) = twin.effects
    assert (setting.effect_id, setting.form) == (form.effect.id, form.effect.equation)
    again = twin_from_record(json.loads(json.dumps(twin_record(twin))), "test")
    assert again == twin
    run = base.problem.case.runs[1]
    force_N, output_V = simulate(again, run.t_s, run.stage_mm, None, run.temperature_C)
    predicted = {b.channel: lost_rows.predicted[b.rows] for b in lost_rows.problem.blocks if b.run == 1}
    np.testing.assert_allclose(force_N, predicted["force_N"], atol=1e-9)
    np.testing.assert_allclose(output_V, predicted["output_V"], atol=READOUT.step_V)


def test_an_output_that_stops_at_a_floor_enters_the_twin_as_that_floor():
    case = make_case(("adc_saturation", {"V_min": LOW_STOP_V}, ()))
    below = np.mean([np.mean(run.output_V < LOW_STOP_V + READOUT.step_V) for run in case.runs])
    assert 0.05 < below < 0.6
    twin = explained_twin(diagnose(case).best)
    (setting,) = twin.effects
    assert setting.effect_id == "adc_saturation" and setting.values == {"V_min": pytest.approx(LOW_STOP_V, abs=0.002)}
    again = twin_from_record(twin_record(twin), "test")
    t_s, stage_mm = profiles.rate_sweep(DEPTH_mm).sample(50.0)
    predicted_V, bare_V = simulate(again, t_s, stage_mm)[1], simulate(twin.clean, t_s, stage_mm)[1]
    assert predicted_V.min() == pytest.approx(LOW_STOP_V, abs=0.003)
    assert predicted_V.max() == pytest.approx(bare_V.max(), abs=READOUT.step_V)


def test_a_hum_enters_the_twin_without_the_phases_of_the_runs():
    twin = explained_twin(diagnose(make_case(("mains_hum", SINGLES["mains_hum"], ()))).best)
    (setting,) = twin.effects
    assert setting.effect_id == "mains_hum" and {"A", "f"} <= set(setting.values) <= {"A", "f", "phi"}
    assert setting.values["A"] == pytest.approx(0.004, rel=0.1)


def test_runs_that_do_not_belong_together_are_refused(plain):
    other = dataclasses.replace(plain.runs[1], readout=dataclasses.replace(READOUT, vref_V=5.0))
    with pytest.raises(InputError, match="run 1.*vref_V.*5.0.*3.3.*run 0"):
        Case("G1", (plain.runs[0], other))
    with pytest.raises(InputError, match="run 1.*force_N"):
        Case("G1", (plain.runs[0], dataclasses.replace(plain.runs[1], force_N=None)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"output_V": np.full(40, 0.5)}, "output_V .*0.5"),
        ({"force_N": np.full(40, np.nan)}, "force_N .*nan .*40"),
        ({"kind": "dummy_resistor"}, "dummy_ohm"),
        ({"stage_mm": None, "force_N": None}, "stage_mm, force_N, output_V"),
    ],
)
def test_a_run_without_meaning_is_refused(change, message):
    good = {"name": "run", "t_s": np.arange(40) / 50.0, "readout": READOUT}
    good |= dict.fromkeys(("stage_mm", "force_N", "output_V"), np.linspace(0, 1, 40))
    with pytest.raises(InputError, match=message):
        Run(**(good | change))


@pytest.mark.long
def test_a_clock_that_runs_ahead_is_not_blamed_for_what_comes_after_the_end():
    runs = []
    for run in make_case().runs:
        clamped_V = np.interp(run.t_s * 1.002 + 0.05, run.t_s, run.output_V)
        runs.append(dataclasses.replace(run, output_V=np.round(clamped_V / READOUT.step_V) * READOUT.step_V))
    diagnosis = diagnose(Case("G1", tuple(runs)))
    assert {c.effect for c in diagnosis.causes if c.probability > 0.5} == {"clock_offset", "clock_skew"}


def test_the_report_holds_the_explained_twin_and_the_refitted_base():
    diagnosis = diagnose(make_case(("readout_lag", {"tau": 0.08}, ())))
    report = diagnosis.report()
    assert twin_from_record(report["twin"], "report") == explained_twin(diagnosis.best)
    assert [s.effect_id for s in explained_twin(diagnosis.best).effects] == ["readout_lag"]
    assert twin_from_record(report["base_twin"], "report").effects == ()
