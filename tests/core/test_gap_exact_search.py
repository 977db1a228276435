"""The whole diagnosis of a pad on short runs: causes put in are named, and every search keeps its rules."""

import json
from dataclasses import replace

import numpy as np
import pytest

from softcal.app.gap.diagnose import apply_report
from softcal.core.errors import InputError
from softcal.core.gap.case import Case, Run
from softcal.core.gap.diagnosis import check_case
from softcal.core.gap.fault_location import explained_twin
from softcal.core.gap.fit import log_evidences
from softcal.core.gap.method import METHOD
from softcal.core.gap.search import Search
from softcal.core.gap.twin import TWIN, diagnose
from softcal.core.twin.catalogue import EFFECTS
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.simulate import EffectSetting, Twin, simulate, twin_from_record

READOUT = ReadoutMetadata(vref_V=3.3, adc_bits=16, r_series_ohm=10.0, sample_rate_Hz=50.0)
PAD = BaseParameters(u0_mm=0.35, k1_N_mm=1.1, k3_N_mm3=0.1, kappa_per_N=0.06, sigma_force_N=0.01, sigma_output_V=0.001)
COUNT = 300


def run_of(number, *effects, seed=0, count=COUNT, base=PAD):
    rng = np.random.default_rng(100 * seed + number)
    t_s = np.arange(count) * 0.02
    # Presses of several depths and speeds, with a hold.
    knots_s = np.cumsum([0.3, *np.random.default_rng(number).uniform(0.4, 1.2, 12)])
    depths = [0.0, 2.8, 2.8, 0.2, 2.0, 0.0, 3.1, 1.2, 3.1, 3.1, 0.0, 1.6, 0.0]
    stage_mm = np.interp(t_s, knots_s, np.roll(depths, number)[: len(knots_s)])
    mine = tuple(e for e in effects if not e.episodes or number == 2)
    warm_C = 22.0 + 3.0 * np.sin(t_s + number)
    force_N, output_V = simulate(Twin(base, mine, READOUT), t_s, stage_mm, rng, warm_C)
    return Run(str(number), t_s, READOUT, stage_mm, force_N, output_V, temperature_C=warm_C)


def case_of(*effects, seed=0, runs=3, count=COUNT):
    return Case("D1", tuple(run_of(k + 1, *effects, seed=seed, count=count) for k in range(runs)))


CAUSES = {
    "backlash": {"b": 0.08},
    "frame_compliance": {"c_f": 0.15},
    "stress_relaxation": {"g": 0.15, "tau": 0.6},
    "mechanical_hysteresis": {"a": 0.08, "d0": 0.3},
    "channel_creep": {"c": 0.15, "tau": 0.7},
    "thermal_drift": {"alpha": 0.004},
    "readout_lag": {"tau": 0.1},
    "loadcell_drift": {"r": 0.02},
    "loadcell_creep": {"k": 0.1, "tau": 2.0},
    "clock_skew": {"epsilon": 0.01},
    "mains_hum": {"A": 0.008, "f": 10.0, "phi": 0.0},
}


@pytest.mark.parametrize("name", CAUSES)
def test_a_cause_alone_is_named_with_its_size(name):
    diagnosis = diagnose(case_of(EffectSetting(name, CAUSES[name])))
    assert diagnosis.best.ids == (name,)
    assert diagnosis.verdict in ("explained", "ambiguous")
    first = diagnosis.causes[0]
    assert first.effect == name and first.probability > 0.5 and first.stage == EFFECTS[name].stage
    size = EFFECTS[name].parameters[0].name
    estimate = first.parameters[size]
    sigma = (estimate.high - estimate.low) / (2 * 1.645)
    assert abs(estimate.value - CAUSES[name][size]) < 5 * sigma + 0.02 * abs(CAUSES[name][size])
    assert diagnosis.explained_share > 0.8 and diagnosis.explained_fraction.held_out > 0.7
    assert abs(diagnosis.explained_fraction.predicted - diagnosis.explained_fraction.held_out) < 0.2
    assert diagnosis.locations[0].stage == EFFECTS[name].stage
    assert 0.0 <= diagnosis.hidden_fraction[name] <= 1.0


@pytest.fixture(scope="module")
def drifting():
    effects = (EffectSetting("loadcell_drift", {"r": 0.02}), EffectSetting("readout_lag", {"tau": 0.1}))
    return diagnose(case_of(*effects))


def test_two_causes_share_what_they_take(drifting):
    assert drifting.best.ids == ("loadcell_drift", "readout_lag")
    shares = {c.effect: c.shrink for c in drifting.causes}
    assert shares["loadcell_drift"] + shares["readout_lag"] == pytest.approx(drifting.explained_fraction.held_out)
    locations = drifting.locations[:2]
    assert {p.stage for p in locations} == {"load_cell", "electronics"}
    assert sum(p.share for p in locations) == pytest.approx(1.0)


def test_a_report_can_be_written_and_its_twin_run(drifting):
    report = json.loads(json.dumps(drifting.report()))
    assert report["verdict"] == drifting.verdict and report["serial"] == "D1"
    assert set(report["gap"]) == {"force", "output"}
    twin = twin_from_record(report["twin"], "report")
    assert {s.effect_id for s in twin.effects} == {"loadcell_drift", "readout_lag"}
    base_twin = twin_from_record(report["base_twin"], "report")
    assert base_twin.effects == ()
    run = drifting.case.runs[0]
    for one, worse in ((twin, False), (base_twin, True)):
        force_N, output_V = simulate(one, run.t_s, run.stage_mm)
        errors = np.std(run.output_V - output_V) / PAD.sigma_output_V, np.std(run.force_N - force_N) / PAD.sigma_force_N
        assert bool(max(errors) > 2.0) is worse
    assert [row["run"] for row in report["offsets"]] == [1, 2, 3]
    assert report["on_bound"] == {} and report["missing_channels"] == [] and report["plugins"] == []
    assert set(report["base"]) == {"u0_mm", "k1_N_mm", "k3_N_mm3", "r0_ohm", "kappa_per_N"}
    assert report["base"]["k1_N_mm"] == pytest.approx(1.1, abs=0.05)
    assert {m["map"] for m in report["maps"]} == {"stage→force", "force→output", "stage→output"}
    stage = np.asarray(run.stage_mm)
    depth = np.maximum(0.0, stage - drifting.best.base.u0_mm)
    base = drifting.best.base
    block = drifting.best.problem.blocks_of("force_N")[0]
    np.testing.assert_allclose(TWIN.load_of(drifting.best)[block.rows], base.k1_N_mm * depth + base.k3_N_mm3 * depth**3)


def test_a_base_parameter_on_its_bound_is_reported(drifting):
    assert drifting.on_bound == {}
    best = drifting.best
    coordinates = best.coordinates.copy()
    coordinates[2] = 0.0
    stuck = replace(best, coordinates=coordinates)
    assert replace(drifting, best=stuck).on_bound == {"k3_N_mm3": 0.0}
    fixed = replace(best.problem)
    fixed.__dict__["is_free"] = np.array([True, True, False, True, True])
    assert replace(drifting, best=replace(stuck, problem=fixed)).on_bound == {}


def test_sound_recordings_have_no_gap():
    diagnosis = diagnose(case_of())
    assert (diagnosis.verdict, diagnosis.best.ids, diagnosis.locations) == ("no_gap", (), ())
    assert all(c.probability < 0.2 for c in diagnosis.causes)
    assert diagnosis.next_experiment.profile == "long_hold"
    assert diagnosis.residual is None and diagnosis.partial is None
    mistakes, identifiability = check_case(case_of(), TWIN)
    assert mistakes == () and identifiability is not None and identifiability["k1_N_mm"].is_identifiable


def wavy(run):
    return replace(run, output_V=run.output_V + 0.012 * np.sin(2.2 * run.force_N))


def test_what_no_cause_explains_is_unknown_and_described():
    case = case_of()
    diagnosis = diagnose(Case("D1", tuple(wavy(r) for r in case.runs)))
    assert diagnosis.verdict == "unknown"
    assert all(c.probability <= METHOD.verdict.unknown_trust for c in diagnosis.causes)
    assert diagnosis.locations[0].stage in ("electronics", "transduction")
    assert diagnosis.next_experiment.profile != "none"
    assert explained_twin(diagnosis.best).effects == ()
    assert diagnosis.partial is None or 0.0 < diagnosis.partial.share < 1.0


def test_a_mistake_stops_the_diagnosis(tmp_path):
    case = case_of()
    runs = (case.runs[0], replace(case.runs[1], force_N=-case.runs[1].force_N), case.runs[2])
    diagnosis = diagnose(Case("D1", runs))
    assert diagnosis.verdict == "data" and diagnosis.mistakes[0].runs == (2,)
    with pytest.raises(InputError, match="mistake"):
        apply_report(tmp_path / "twin.json", diagnosis.report(), "D1", provenance=None)
    assert not (tmp_path / "twin.json").exists()
    assert diagnosis.report()["twin"] is None and diagnosis.report()["base_twin"] is None
    mistakes, identifiability = check_case(Case("D1", runs), TWIN)
    assert mistakes == diagnosis.mistakes and identifiability is None
    apart = tuple(replace(r, force_N=1.3 * r.force_N) if r.name == "3" else r for r in case_of(runs=4).runs)
    assert diagnose(Case("D1", apart)).mistakes[0].what == "gain"


def test_events_of_one_run_are_placed():
    lost_samples = EffectSetting("dropped_samples", {}, ((2.4, 6.0),))
    diagnosis = diagnose(case_of(lost_samples))
    assert diagnosis.best.ids == ("dropped_samples",)
    bad = EffectSetting("intermittent_contact", {"dR": 0.8}, ((1.0, 1.4), (3.0, 3.3)))
    diagnosis = diagnose(case_of(bad))
    assert diagnosis.best.ids == ("intermittent_contact",)
    assert explained_twin(diagnosis.best).effects == ()
    clipped = diagnose(case_of(EffectSetting("adc_saturation", {"V_max": 1.12})))
    assert clipped.best.ids == ("adc_saturation",)


@pytest.fixture(scope="module")
def searched():
    case = case_of(
        EffectSetting("stress_relaxation", {"g": 0.15, "tau": 0.6}), EffectSetting("wiring_resistance", {"Rw": 1.5})
    )
    search = Search(TWIN.base_fit(case), TWIN.visible(case))
    search.run()
    return search


def test_every_hypothesis_is_scored_under_one_noise(searched):
    problems = {id(f.problem) for f in searched.fits.values()}
    sigmas = {tuple(sorted(f.problem.sigma.items())) for f in searched.fits.values()}
    assert len(sigmas) == 1 and problems
    for ids, fit in searched.fits.items():
        assert fit.ids == ids and np.isfinite(fit.chi2)
        residual = fit.problem.whitened(fit.problem.measured - fit.predicted)
        assert fit.chi2 == pytest.approx(residual @ residual)


def test_the_best_is_the_likeliest_and_a_larger_set_leaves_no_more(searched):
    logs = log_evidences(searched.fits)
    assert searched.best is searched.fits[max(logs, key=lambda ids: logs[ids])]
    assert "stress_relaxation" in searched.best.ids
    base = searched.fits[()]
    for ids, fit in searched.fits.items():
        assert fit.chi2 <= 1.02 * base.chi2, ids
    assert len(max(searched.fits, key=len)) <= len(METHOD.search.candidates) + 1


def test_causes_that_the_others_imitate_are_not_excluded(searched, monkeypatch):
    from softcal.core.gap import search as module

    both = next(f for ids, f in searched.fits.items() if len(ids) == 2 and "stress_relaxation" in ids)
    other = next(i for i in both.ids if i != "stress_relaxation")
    best, searched.best = searched.best, both
    monkeypatch.setattr(searched, "is_explained", lambda found: True)
    monkeypatch.setattr(module, "causes_with_surrogate", lambda best, smaller: [other] if other in smaller else [])
    searched.store_not_excluded()
    assert searched.best.ids == ("stress_relaxation",)
    assert searched.not_excluded == {other: searched.fits[both.ids]}
    searched.best, searched.not_excluded = best, {}
    monkeypatch.setattr(searched, "is_explained", lambda found: False)
    monkeypatch.setattr(module, "causes_with_surrogate", lambda best, smaller: list(smaller))
    searched.best = both
    searched.store_not_excluded()
    assert searched.best is both and searched.not_excluded == {}
    searched.best = best
