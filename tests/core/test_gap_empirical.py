"""What no cause explains is described by a few terms, the twin holds them, and another run says how good they are."""

import dataclasses
import json

import numpy as np
import pytest

from softcal.core import profiles
from softcal.core.challenge.equations import OUTSIDE, OUTSIDE_FORM
from softcal.core.challenge.rig import Cause, Path, Rack, Rig, record
from softcal.core.errors import InputError
from softcal.core.gap.case import Case, Run
from softcal.core.gap.empirical import learn_residual
from softcal.core.gap.fault_location import explained_twin
from softcal.core.gap.twin import TWIN
from softcal.core.gap.twin_reach import terms_of_twin
from softcal.core.twin.effects import Flow
from softcal.core.twin.empirical_terms import TERM_TARGETS, VARIABLES, EmpiricalTerm
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.simulate import SCHEMA, Chain, Twin, TwinStream, simulate, twin_from_record, twin_record

READOUT = ReadoutMetadata(vref_V=3.3, adc_bits=14, r_series_ohm=10.0, sample_rate_Hz=50.0)
BASE = BaseParameters(u0_mm=0.35, k1_N_mm=1.1, k3_N_mm3=0.1, kappa_per_N=0.06, sigma_force_N=0.012)
DEPTH_mm, LOAD_N = 3.0, 5.5
TERM = EmpiricalTerm("output_V", "memory(load, 8 s)", 0.013, LOAD_N, DEPTH_mm)


def press_runs(seed):
    """Four runs of the common protocols and one more that is kept back."""
    rng = np.random.default_rng(seed)
    return (
        profiles.ramps([DEPTH_mm] * 2, 0.6),
        profiles.ramps([DEPTH_mm] * 6, 4.0),
        profiles.steps_with_holds([1.2, 2.4, DEPTH_mm, 1.8], hold_s=4.0),
        profiles.random_presses(rng, 20.0, DEPTH_mm),
        profiles.ramps([1.5, DEPTH_mm, 2.2], 1.5),
    )


def outside_run(name, values, profile, rng):
    """A run of the examiner's rig with an effect that the catalogue does not have."""
    rig = Rig(0.35, 1.1, 0.1, 4.0, 0.06, 1e-3, 1.2e-2, 3.3, 10.0, 14, 50.0)
    t_s, stage_mm = profile.sample(50.0)
    path = Path(profile.name, t_s, stage_mm)
    rack = Rack((Cause(name, OUTSIDE_FORM, values),), {(name, OUTSIDE_FORM): OUTSIDE[name]})
    columns = record(rig, rack, path, lambda at_s: 22.0 + 0.1 * at_s, rng).columns
    channels = {c: columns[c] for c in ("stage_mm", "force_N", "output_V", "temperature_C")}
    return Run(profile.name, columns["t_s"], READOUT, **channels, profile=profile.name)


def outside_case(name, values, seed=3):
    rng = np.random.default_rng(seed)
    *runs, held_out = (outside_run(name, values, profile, rng) for profile in press_runs(seed))
    return Case("G1", tuple(dataclasses.replace(r, name=f"run {k}") for k, r in enumerate(runs))), held_out


def gap(twin, run, diagnosis):
    """Error above the noise on a run, channels in units of their noise."""
    predicted = dict(
        zip(("force_N", "output_V"), simulate(twin, run.t_s, run.stage_mm, None, run.temperature_C), strict=True)
    )
    errors = {
        c: np.sqrt(np.mean((getattr(run, c) - v) ** 2)) / diagnosis.problem.noise_floor(c) for c, v in predicted.items()
    }
    return sum(max(0.0, error - 1.0) for error in errors.values())


@pytest.mark.parametrize(
    ("name", "values", "variable"),
    [
        pytest.param("guide_friction", {"friction_N": 0.15}, "direction", marks=pytest.mark.long),
        ("cell_span_temperature", {"coefficient_per_K": 0.01}, "load·T"),
        ("cable_drag", {"drag_N_per_mm": 0.06}, "position"),
        ("permanent_set", {"share": 0.05}, "deepest"),
    ],
)
def test_an_effect_outside_the_catalogue_is_described_and_the_twin_shrinks_the_gap_of_another_run(
    name, values, variable
):
    case, held_out = outside_case(name, values)
    base = TWIN.base_fit(case)
    terms = learn_residual(base, [base], list(terms_of_twin(base)))
    assert terms is not None and 1 <= len(terms.terms) <= 3
    assert variable in terms.terms[0].term.variable
    first = terms.terms[0]
    assert abs(first.term.coefficient) > 3.0 * first.standard_error > 0.0
    assert first.term.unit in first.term.formula and terms.explained_fraction.low > 0.0
    twin = explained_twin(terms.fit, [one.term for one in terms.terms])
    again = twin_from_record(json.loads(json.dumps(twin_record(twin))), "file")
    assert again == twin
    realised = 1.0 - gap(again, held_out, base) / gap(explained_twin(base), held_out, base)
    assert realised == pytest.approx(terms.explained_fraction.predicted, abs=0.10)


def test_noise_alone_gets_no_term():
    rng = np.random.default_rng(5)
    runs = []
    for k, profile in enumerate(press_runs(5)):
        t_s, stage_mm = profile.sample(50.0)
        runs.append(Run(f"run {k}", t_s, READOUT, stage_mm, *simulate(Twin(BASE, (), READOUT), t_s, stage_mm, rng)))
    base = TWIN.base_fit(Case("G1", tuple(runs)))
    assert learn_residual(base, [base], list(terms_of_twin(base))) is None


def test_what_happens_once_in_a_run_gets_no_term():
    """A blow of half a second at another place in every run follows nothing that holds on a run held back."""
    rng = np.random.default_rng(6)
    runs = []
    for k, profile in enumerate(press_runs(6)):
        t_s, stage_mm = profile.sample(50.0)
        force_N, output_V = simulate(Twin(BASE, (), READOUT), t_s, stage_mm, rng)
        at_s = rng.uniform(0.2, 0.8) * t_s[-1]
        output_V = output_V + rng.choice([-0.02, 0.02]) * (np.abs(t_s - at_s) < 0.25)
        runs.append(Run(f"run {k}", t_s, READOUT, stage_mm, force_N, output_V))
    base = TWIN.base_fit(Case("G1", tuple(runs)))
    assert learn_residual(base, [base], list(terms_of_twin(base))) is None


@pytest.mark.parametrize("variable", VARIABLES)
@pytest.mark.parametrize("target", TERM_TARGETS)
def test_a_term_streams_as_in_one_call_and_acts_at_its_place(target, variable):
    twin = Twin(BASE, (), READOUT, (EmpiricalTerm(target, variable, 0.05, LOAD_N, DEPTH_mm),))
    t_s, stage_mm = profiles.steps_with_holds([1.2, DEPTH_mm, 2.0], hold_s=1.0).sample(50.0)
    temperature_C = 20.0 + t_s
    whole = simulate(twin, t_s, stage_mm, None, temperature_C)
    stream = TwinStream(twin, None)
    parts = [
        stream.advance(t_s[k : k + 7], stage_mm[k : k + 7], temperature_C[k : k + 7]) for k in range(0, len(t_s), 7)
    ]
    for channel in (0, 1):
        np.testing.assert_allclose(np.concatenate([p[channel] for p in parts]), whole[channel], atol=1e-9)
    bare = simulate(twin.clean, t_s, stage_mm, None, temperature_C)
    assert np.any(whole[0] != bare[0]) == (target != "output_V")
    assert np.any(whole[1] != bare[1]) == (target != "force_N")


def test_a_term_does_nothing_where_no_pad_is_pressed():
    flow = Flow(np.arange(50) / 50.0, np.full(50, 0.02), np.arange(50.0), None, 3.3)
    flow.resistance_ohm = np.full(50, 4.0)
    chain = Chain([TERM.effect])
    chain.read_out(flow, READOUT, [[1.0]], chain.fresh_memories())
    assert np.ptp(flow.output_V) == 0.0


def test_a_twin_without_terms_keeps_the_first_schema():
    assert twin_record(Twin(BASE, (), READOUT))["schema"] == SCHEMA
    assert twin_record(Twin(BASE, (), READOUT, (TERM,)))["schema"] == SCHEMA


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"place": "stage_mm"}, "'stage_mm'.* F, force_N, output_V"),
        ({"variable": "mood"}, "'mood'"),
        ({"coefficient": float("nan")}, "nan"),
        ({"load_N": 0.0}, "load_N"),
        ({"unit": "V/s"}, " V, .*V/s"),
    ],
)
def test_a_term_without_meaning_is_refused(change, message):
    entry = twin_record(Twin(BASE, (), READOUT, (TERM,)))
    entry["empirical"][0] |= change
    with pytest.raises(InputError, match=message):
        twin_from_record(entry, "twin.json")
