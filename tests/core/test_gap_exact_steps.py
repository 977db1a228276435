"""Single steps of the search, of mistakes and of reasons, each at its threshold."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from softcal.core.gap.case import Case
from softcal.core.gap.experiments import (
    Identifiability,
    ParameterIdentifiability,
    explain_unidentifiable,
    identifiability,
)
from softcal.core.gap.fault_location import loose_noise
from softcal.core.gap.fit import Candidate, fit, structure
from softcal.core.gap.hypothesis import Hypothesis, Probe
from softcal.core.gap.linear import NoiseCorrelation
from softcal.core.gap.method import METHOD
from softcal.core.gap.mistakes import outlier_run_with_causes
from softcal.core.gap.model import Nearby, Problem
from softcal.core.gap.residual import noise_chance
from softcal.core.gap.search import fit_jointly, screen
from softcal.core.gap.simulator import candidate
from softcal.core.gap.simulator_model import SimulatorModel
from softcal.core.gap.simulator_reach import against_others
from softcal.core.gap.twin import TWIN, TwinModel
from softcal.core.messages.reason import Reason
from softcal.core.twin.catalogue import EFFECTS
from softcal.core.twin.effects import Parameter
from tests.core.linear_mechanism import (
    BEND,
    CAUSES,
    LINE,
    SIGMA,
    design,
    fitted,
    measured,
    problem_of,
    runs_of,
    size,
    solved,
)
from tests.core.test_gap_exact_twin import AT, CASE, PROBLEM, case_of, fit_with_change, run_of

IDENTIFIABILITY, OUTLIER, FAULT_LOCATION = METHOD.telling, METHOD.outlier, METHOD.fault_location
RUNS = runs_of({"bend.size": 0.3, "ripple.size": 0.2}, (60, 71, 48))
Y, N = measured(RUNS), 179


# Growing.


def test_a_joined_fit_begins_anew_where_it_brings_too_little(monkeypatch):
    base = fitted(problem_of(RUNS))
    starts, gains = [], []

    def noted(problem, hypothesis, start, steps=20):
        starts.append((tuple(np.round(start, 9)), steps))
        result = fit(problem, hypothesis, start, steps)
        return replace(result, chi2=base.chi2 - gains[len(starts) - 1])

    monkeypatch.setattr("softcal.core.gap.search.fit", noted)
    lead_candidate = Candidate(BEND, (0.4,), 100.0, 0.0, np.array([0.1, -0.2]))
    for drops, calls, best in (
        ([10.1], 1, 10.1),
        ([9.9, 10.1], 2, 10.1),
        ([5.0, 7.0, 6.0], 3, 7.0),
        ([1.0, 0.0, 0.0], 3, 1.0),
    ):
        gains[:] = drops
        starts.clear()
        assert fit_jointly(base, lead_candidate).chi2 == pytest.approx(base.chi2 - best)
        assert len(starts) == calls
        shares = (1.0, 0.1, 0.003)[:calls]
        for (start, steps), share in zip(starts, shares, strict=True):
            expected = [*(base.coordinates + share * lead_candidate.shift), 0.4 * share]
            np.testing.assert_allclose(start, expected, atol=1e-8)
            assert steps == (20 if share == 1.0 else 40)


def test_a_level_begins_farther_away_at_a_small_share():
    level = candidate("stop", "wall", Parameter("at", "mm", 1.0, 1e4, 50.0, neutral=np.inf, scale="inverse_square"))
    lead_candidate = Candidate(level, (10.0,), 1.0, 0.0, np.zeros(2))
    base = fitted(problem_of(RUNS))
    assert lead_candidate.start(base)[2] == pytest.approx(1.0 / 10.0**2)
    assert lead_candidate.start(base, 0.1)[2] == pytest.approx(1.0 / 100.0**2)


def test_a_candidate_of_a_level_moves_by_the_root_of_its_predicted_gain():
    def walled(inputs, p):
        return {"y": LINE.run(inputs, p)["y"] + 30.0 / p["stop.at"] ** 2 * inputs["x"] ** 2}

    stop = candidate("stop", "wall", Parameter("at", "mm", 1.0, 1e4, 50.0, neutral=np.inf, scale="inverse_square"))
    simulator = replace(LINE, run=walled, candidates=(stop, *CAUSES))
    runs = [replace(r, columns={**r.columns, "y": r.columns["y"]}) for r in RUNS]
    base = fitted(problem_of(runs, simulator=simulator))
    (lead_candidate,) = screen(base, [Probe(stop, (20.0,), True)])
    exact = solved(design(RUNS, "bend"), Y)[2]
    # 30/at² is the size of the bend; the probe may be stretched thirtyfold.
    times = min(exact / (30.0 / 20.0**2), 30.0)
    assert lead_candidate.values[0] == pytest.approx(20.0 / np.sqrt(times), rel=1e-3)


# Offsets that all runs share.


def test_offsets_nearby_add_what_least_squares_finds():
    with_offsets = replace(LINE, per_run={"y": {"zero": 5.0}})
    problem = problem_of(RUNS, simulator=with_offsets)
    clean = problem.bare.predict(Hypothesis(of_all=LINE.base), np.array([0.8, 2.0]))
    rows = problem.directions(Hypothesis(of_all=LINE.base), np.array([0.8, 2.0]), clean, {})
    near = Nearby(rows)
    sizes = near.sizes(problem, clean)
    for k, block in enumerate(problem.blocks):
        assert sizes[k][0] == pytest.approx(np.mean((Y - clean)[block.rows]), rel=1e-4)
    out = near.added(problem, clean)
    for k, block in enumerate(problem.blocks):
        np.testing.assert_allclose(out[block.rows], clean[block.rows] + sizes[k][0])
    moved = Nearby(rows, {k: np.array([0.1]) for k in range(3)})
    for k in range(3):
        assert moved.sizes(problem, clean)[k][0] == pytest.approx(sizes[k][0], abs=1e-4)


# What is said of what the runs do not tell.


def make_identifiability(**change):
    fields = {"name": "slope", "is_base": True, "sigma": 1.0, "hidden": 0.5}
    return ParameterIdentifiability(**(fields | change))


@pytest.mark.parametrize(
    ("one", "code"),
    [
        (make_identifiability(offset="zero of y"), "gap.told.own"),
        (make_identifiability(offset="zero of y", beside=("level",)), "gap.told.own"),
        (make_identifiability(beside=("level",)), "gap.told.beside"),
        (make_identifiability(beside=("level",), sigma=0.0), "gap.told.beside"),
        (make_identifiability(sigma=IDENTIFIABILITY.nothing), "gap.told.small"),
        (make_identifiability(sigma=0.99 * IDENTIFIABILITY.nothing), "gap.told.never"),
    ],
)
def test_a_reason_is_the_first_that_holds(one, code):
    assert explain_unidentifiable(one).code == code
    assert explain_unidentifiable(one).values["cure"].code == "gap.told.no_run"
    assert explain_unidentifiable(replace(one, by=("wide",))).values["cure"].code == "gap.told.run"


def test_what_is_identifiable_shows_by_so_many_sigma_and_is_no_offset():
    assert (
        make_identifiability(sigma=IDENTIFIABILITY.sigma).is_identifiable
        and not make_identifiability(sigma=IDENTIFIABILITY.sigma - 1e-9).is_identifiable
    )
    assert (
        not make_identifiability(sigma=99.0, offset="zero of y").is_identifiable
        and make_identifiability(offset="zero of y").is_run_nuisance
    )
    every = Identifiability(
        (make_identifiability(sigma=99.0), make_identifiability(name="bend", is_base=False)), (("a", "b"),)
    )
    assert [one.name for one in every.unidentifiable] == ["bend"] and every["bend"].sigma == 1.0
    record = every.record()
    assert record["base"]["slope"]["is_told"] is True and record["causes"]["bend"]["is_told"] is False
    assert len(record["untold"]) == 2


def test_a_cause_that_fills_an_offset_to_its_bound_is_no_offset():
    """A zero that most runs would need beyond what each may have is a cause of all of them."""
    tilt = replace(
        LINE, run=lambda i, p: {"y": p["level"] + p["slope"] * i["x"] + p["bend.size"] * (i["t_s"] - i["t_s"][0])}
    )
    runs = [replace(r, columns={**r.columns, "y": 1 + 2 * r.columns["x"] + 0.4 * r.elapsed_s}) for r in RUNS]
    for largest, is_run_nuisance in ((5.0, True), (0.1, False)):
        with_offsets = replace(tilt, per_run={"y": {"drift": largest}}, candidates=(BEND,))
        base = fitted(problem_of(runs, simulator=with_offsets))
        one = identifiability(base, (BEND,))["bend"]
        assert one.own > IDENTIFIABILITY.offset_share
        assert one.is_run_nuisance is is_run_nuisance and one.offset == ("drift of y" if is_run_nuisance else "")


# Mistakes beside causes.


def test_a_mistake_beside_a_cause_must_be_far_ahead():
    drift = EFFECTS["loadcell_drift"]
    runs = [run_of(k, 400) for k in (1, 2, 3)]
    runs = [replace(r, force_N=r.force_N + 0.03 * r.t_s) for r in runs]
    mistaken_runs = [replace(runs[0], force_N=1.3 * runs[0].force_N), *runs[1:]]
    for these, is_mistake in ((mistaken_runs, True), (runs, False)):
        problem = Problem(TWIN, Case("B", tuple(these)), PROBLEM.sigma)
        base = fit(problem, Hypothesis(), AT)
        alone = fit(problem, Hypothesis((drift,)), np.append(base.coordinates, 0.03))
        search = SimpleNamespace(
            base=base, best=alone, fits={(): base, alone.ids: alone}, model=TWIN,
            is_explained=posterior_clean, grown_from=lambda fitted: [],
        )  # fmt: skip
        mistake = outlier_run_with_causes(search)
        assert (mistake is not None) is is_mistake
        if mistake:
            assert (mistake.what, mistake.channel, mistake.runs) == ("gain", "force", (1,))


def posterior_clean(posterior):
    return not structure(posterior).is_significant


def test_exchanged_columns_are_found_by_the_simulator():
    # A line of unequal inputs: exchanged with its output it fits nothing.
    def bent(inputs, p):
        return {"y": p["level"] + p["slope"] * inputs["x"] ** 3 + p["bend.size"] * inputs["x"]}

    simulator = replace(LINE, run=bent, candidates=(BEND,))
    rng, runs = np.random.default_rng(4), []
    for run in RUNS:
        x = np.sign(run.columns["x"]) * np.abs(run.columns["x"])
        runs.append(replace(run, columns={**run.columns, "y": 1.0 + 2.0 * x**3 + rng.normal(0, SIGMA, len(x))}))
    swapped = [replace(r, columns={**r.columns, "x": r.columns["y"], "y": r.columns["x"]}) for r in runs]
    model = SimulatorModel(simulator)
    mistakes = against_others(model, model.base_fit(Case("X", tuple(swapped))))
    assert (mistakes.mistake.what, mistakes.mistake.channel, mistakes.mistake.runs) == ("swapped_columns", "x+y", ())
    assert mistakes.is_claim and mistakes.residual < 0.05
    assert against_others(model, model.base_fit(Case("X", tuple(runs)))) is None


# Places.


def test_a_tone_beside_a_named_line_is_the_lines():
    fit = fit_with_change("output_V", lambda r: 0.0012 * np.sin(2 * np.pi * 8.2 * r.t_s))
    hum = EFFECTS["mains_hum"].of_runs(2)
    for amplitude, frequency_Hz, is_found in (
        (0.004, 8.0, False),
        (0.004, 8.0 - FAULT_LOCATION.breathes_Hz, True),
        (0.0012, 8.0, True),
    ):
        at = np.array([*AT, amplitude, frequency_Hz, 0.0, 0.0])
        with_line_named = replace(fit, hypothesis=fit.hypothesis.adding(hum), coordinates=at)
        assert (loose_noise(with_line_named) is not None) is is_found


def test_without_a_stage_or_an_output_nothing_is_loose():
    assert (
        loose_noise(fit(Problem(TWIN, case_of(run_of(output_V=None)), PROBLEM.sigma).bare, Hypothesis(), AT, steps=0))
        is None
    )


# Noise of several channels.


class Lone(TwinModel):
    """A twin of which nothing is known that a residual may follow, but another channel."""

    def followed(self, fit, channel):
        return [[]]


def test_what_another_channel_leaves_tells_too():
    """Two channels that err together err by one cause, however small each is."""
    lone, rng = Lone(EFFECTS), np.random.default_rng(5)
    common = [rng.normal(0.0, 1.0, len(r)) for r in CASE.runs]
    runs = [
        replace(r, force_N=r.force_N + 0.004 * c, output_V=r.output_V + 0.0004 * c)
        for r, c in zip(CASE.runs, common, strict=True)
    ]
    together = fit(Problem(lone, Case("T", tuple(runs)), PROBLEM.sigma).bare, Hypothesis(), AT)
    apart = fit(replace(PROBLEM, model=lone).bare, Hypothesis(), AT)
    assert noise_chance(together) < 1e-3 < noise_chance(apart)
    assert noise_chance(apart, ("output_V",)) >= noise_chance(apart)


def test_a_colour_stays_where_none_is_given():
    correlated = PROBLEM.with_noise(PROBLEM.sigma, {"output_V": NoiseCorrelation(0.002, 0.5)})
    assert correlated.with_noise({"force_N": 1.0, "output_V": 1.0}).correlation == correlated.correlation
    assert correlated.with_noise(PROBLEM.sigma, {}).correlation == {}
    assert correlated.of_run(CASE.runs[0]).correlation == correlated.correlation
    weighted = correlated.seeing(np.ones(len(correlated.measured)))
    np.testing.assert_allclose(weighted.whitened(correlated.measured), correlated.whitened(correlated.measured))


# Free forms.


def test_sizes_of_other_kinds_have_no_reason_without_values():
    assert Reason("gap.told.no_run").values == {} and size().neutral == 0.0 and PROBLEM.count == len(PROBLEM.measured)
