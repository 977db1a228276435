"""Drawing, sealing and opening cases."""

from dataclasses import asdict, replace

import msgspec
import numpy as np
import pytest

from softcal.core.challenge.case_generator import LINES, SIZES, draw_case, draw_challenge
from softcal.core.challenge.cases import EXPERIMENTS, RunPlan, SealedCase, distance_sigma
from softcal.core.challenge.equations import CATALOGUE, OUTSIDE
from softcal.core.challenge.explained_fraction import BASE, explained_fraction, refit_base
from softcal.core.challenge.published_equations import PUBLISHED_OUTSIDE
from softcal.core.challenge.rig import Cause
from softcal.core.challenge.seal import Seal, open_seal, seal_labels
from softcal.core.errors import InputError


def test_the_same_seed_gives_the_same_case() -> None:
    first, again, other = (draw_case(seed, "case", "pair") for seed in (5, 5, 6))
    assert asdict(first) == asdict(again) != asdict(other)
    for plan in first.plans:
        columns, same = first.measure(plan).columns, again.measure(plan).columns
        assert all(np.array_equal(columns[name], same[name]) for name in columns)


def test_every_effect_has_a_size() -> None:
    assert set(SIZES) == set(CATALOGUE) | set(OUTSIDE) | set(PUBLISHED_OUTSIDE)


@pytest.mark.parametrize("line", LINES)
def test_every_line_can_be_recorded(line: str) -> None:
    for seed in range(6):
        case = draw_case(seed, "case", line)
        for plan in (*case.plans, case.kept_back):
            columns = case.measure(plan).columns
            assert all(np.all(np.isfinite(values)) for values in columns.values())
            assert not set(case.withheld) & set(columns)


@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_every_experiment_can_be_asked_for(experiment: str) -> None:
    measured = draw_case(3, "case", "usual").measure(RunPlan(experiment, 11))
    assert len(measured.columns["t_s"]) > 100
    assert all(np.all(np.isfinite(values)) for values in measured.columns.values())


def test_the_force_stays_near_the_peak_that_was_drawn() -> None:
    for seed in range(20):
        case = draw_case(seed, "case", "none")
        forces = [case.measure(plan).columns["force_N"].max() for plan in case.plans]
        assert 0.4 * case.peak_N < max(forces) < 1.02 * case.peak_N + 0.1


def test_a_challenge_mixes_all_lines_and_names_tell_nothing() -> None:
    cases = draw_challenge(seed=9, count=120)
    assert {case.line for case in cases} == set(LINES)
    assert [case.name for case in cases] == [f"case-{k:03d}" for k in range(1, 121)]
    assert len(draw_challenge(seed=9, count=7)) == 7


def test_a_case_survives_its_record() -> None:
    case = draw_case(2, "case", "form")
    assert asdict(msgspec.convert(asdict(case), SealedCase)) == asdict(case)


def test_distance_is_zero_without_a_cause_and_grows_with_its_size() -> None:
    case = draw_case(1, "case", "none")
    drifting = [
        replace(case, causes=(Cause("loadcell_drift", "catalogue", {"rate_N_per_s": r}),)) for r in (2e-4, 2e-3)
    ]
    assert distance_sigma(case) == 0.0
    assert distance_sigma(drifting[1]) == pytest.approx(10.0 * distance_sigma(drifting[0]), rel=1e-3)


def test_the_refit_finds_the_base_of_a_case_without_causes() -> None:
    case = draw_case(4, "case", "none")
    base = refit_base(case)
    for name in BASE:
        assert getattr(base, name) == pytest.approx(getattr(case.rig, name), rel=0.02)


def test_a_seal_opens_with_its_commitment_only() -> None:
    cases = draw_challenge(seed=1, count=2)
    contents = {case.name: "00" for case in cases}
    seal = seal_labels(cases, contents, seed=1, nonce="a")
    opened = open_seal(seal.text, seal.commitment)
    assert [asdict(label.case) for label in opened] == [asdict(case) for case in cases]
    assert seal_labels(cases, contents, seed=1, nonce="b").commitment != seal.commitment
    with pytest.raises(InputError, match=seal.commitment):
        open_seal(seal.text.replace('"seed":1', '"seed":2'), seal.commitment)
    for text in ("[" * 100_000, "[]", '{"schema":"no"}', seal.text.replace('"labels":[', '"labels":[7,')):
        with pytest.raises(InputError):
            open_seal(text, Seal(text).commitment)


def test_the_path_stays_when_a_base_parameter_moves() -> None:
    case = draw_case(4, "case", "one_run")
    softer = replace(case, rig=replace(case.rig, k1_N_mm=0.5 * case.rig.k1_N_mm, u0_mm=0.1))
    first, second = (c.measure(c.plans[0]).columns["stage_mm"] for c in (case, softer))
    assert np.array_equal(first, second)


def test_the_true_twin_realises_the_whole_shrink_of_large_and_small_causes() -> None:
    def shrink(effect: str, share: float, name: str, fitted: float) -> float:
        case = draw_case(6, "case", "usual")
        case = replace(case, causes=(Cause(effect, "catalogue", {"share": share, "tau_s": 4.0}),))
        base = {name: getattr(case.rig, name) for name in BASE}
        values = {name: {"value": fitted}, "tau": {"value": 4.0}}
        return explained_fraction(
            case, {"base": base, "causes": [{"effect": effect, "probability": 1.0, "parameters": values}]}
        )

    assert shrink("stress_relaxation", 0.1, "g", 0.1) > 0.95
    assert shrink("stress_relaxation", 0.1, "g", 0.05) < 0.9
    assert shrink("channel_creep", 0.01, "c", 0.01) > 0.98
