"""Held-out shrink, next run, identifiability, empirical terms and search on a linear model, by linear algebra."""

from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest

from softcal.core.gap.case import MenuEntry
from softcal.core.gap.diagnosis import DiagnosisVerdict, assess_search
from softcal.core.gap.empirical import learn_residual, splits
from softcal.core.gap.evidence import fault_locations, nearest, partial_of, ranked_causes, regime_locations
from softcal.core.gap.experiments import identifiability, propose_experiment, reasons
from softcal.core.gap.fit import Regime, fit, one_less
from softcal.core.gap.hypothesis import Hypothesis
from softcal.core.gap.method import METHOD
from softcal.core.gap.residual import gap_of_base, on_unseen, quantify, unsupported
from softcal.core.gap.search import Search
from softcal.core.gap.simulator import Experiment, planned
from softcal.core.gap.simulator_model import SimulatorModel
from softcal.core.gap.simulator_reach import terms_of
from softcal.core.messages.reason import Reason, reason
from tests.core import linear_mechanism as lm

COUNTS = (60, 71, 48)
RUNS = lm.runs_of({"bend.size": 0.3, "ripple.size": 0.05}, COUNTS)
PROBLEM = lm.problem_of(RUNS)
Y, N = lm.measured(RUNS), sum(COUNTS)
RUN = np.repeat(np.arange(3), COUNTS)
NOISE = lm.SIGMA


def held_out_residual(columns, members):
    """What least squares without these samples leaves on them."""
    return Y[members] - columns[members] @ lm.solved(columns[~members], Y[~members])


def shrunk(before, after):
    return 1.0 - max(after - NOISE, 0.0) / (before - NOISE)


@pytest.mark.parametrize("names", [("bend",), ("bend", "ripple")])
def test_the_held_out_gap_is_that_of_least_squares_without_each_run(names):
    causes = tuple(c for c in lm.CAUSES if c.id in names)
    base, best = lm.fitted(PROBLEM), lm.fitted(PROBLEM, *causes)
    quantified = quantify(base, best)
    errors = {}
    for what, columns in (("before", lm.design(RUNS)), ("after", lm.design(RUNS, *names))):
        errors[what] = np.concatenate([held_out_residual(columns, RUN == k) for k in range(3)])
    rms = {what: np.sqrt(np.mean(e**2)) for what, e in errors.items()}
    gap = quantified.gap["y"]
    assert (gap.rmse_before, gap.rmse_after) == pytest.approx((rms["before"], rms["after"]), rel=2e-3)
    assert gap.noise_floor == NOISE
    assert quantified.explained_fraction.held_out == pytest.approx(
        np.clip(shrunk(rms["before"], rms["after"]), 0, 1), abs=0.01
    )
    assert quantified.chosen == (best.ids,) * 3
    before, after = errors["before"] / lm.SIGMA, errors["after"] / lm.SIGMA
    assert quantified.held_out_gain == pytest.approx(before @ before - after @ after, rel=1e-2)
    assert quantified.gain_error == pytest.approx(2.0 * np.sqrt(np.sum((before - after) ** 2)), rel=1e-2)
    assert quantified.is_supported
    assert "run" in quantified.protocol


def test_the_forecast_is_by_the_errors_of_the_parameters():
    """Before, the two fits part by so much; after, the parameters' uncertainty alone is left of a right hypothesis."""
    base, best = lm.fitted(PROBLEM), lm.fitted(PROBLEM, lm.BEND, lm.RIPPLE)
    fraction = quantify(base, best).explained_fraction
    whole, small = lm.design(RUNS, "bend", "ripple"), lm.design(RUNS)
    parted, spread = [], []
    for k in range(3):
        off = RUN == k
        parted.append(whole[off] @ lm.solved(whole[~off], Y[~off]) - small[off] @ lm.solved(small[~off], Y[~off]))
        covariance = lm.SIGMA**2 * np.linalg.inv(whole[~off].T @ whole[~off])
        spread.append(np.sqrt(np.einsum("ij,jk,ik->i", whole[off], covariance, whole[off])))
    part, wide = (np.sqrt(np.mean(np.concatenate(rows) ** 2)) for rows in (parted, spread))
    before, after = np.hypot(NOISE, part), np.hypot(NOISE, wide)
    assert fraction.predicted == pytest.approx(shrunk(before, after), abs=5e-3)
    error = lm.left_of(whole, Y) / lm.SIGMA
    remaining = NOISE * np.sqrt(max(0.0, np.mean(error**2) - 1.0 - np.sqrt(2.0 / N)))
    worst = shrunk(
        np.sqrt(NOISE**2 + part**2 + remaining**2), np.sqrt(NOISE**2 + (1.6 * remaining) ** 2 + (2.0 * wide) ** 2)
    )
    margin = max(METHOD.explained_fraction.min_margin, shrunk(before, after) - worst)
    assert fraction.predicted - fraction.low == pytest.approx(margin, abs=5e-3)
    expected = shrunk(before, NOISE)
    assert fraction.high == pytest.approx(min(1.0, max(fraction.predicted + margin, expected)), abs=5e-3)
    assert abs(fraction.held_out - fraction.predicted) < 0.1


def test_without_a_cause_nothing_shrinks():
    base = lm.fitted(PROBLEM)
    quantified = quantify(base, base)
    assert (quantified.explained_fraction.predicted, quantified.explained_fraction.held_out, quantified.chosen) == (
        0.0,
        0.0,
        (),
    )
    assert quantified.gap["y"].rmse_before == quantified.gap["y"].rmse_after
    assert not quantified.is_supported
    residual = lm.left_of(lm.design(RUNS), Y)
    assert gap_of_base(base)["y"].rmse_before == pytest.approx(np.sqrt(np.mean(residual**2)), rel=1e-6)
    assert gap_of_base(base)["y"].rmse_after == gap_of_base(base)["y"].rmse_before


def test_a_part_is_measured_by_what_would_be_chosen_without_it():
    """A kink that fits the whole best, but only by one run, gives way to the bend where that run is held back."""
    fits = lm.fits_of(PROBLEM, (lm.BEND,), (lm.KINK,), (lm.RIPPLE,))
    quantified = quantify(fits[()], fits["kink",], fits.values())
    assert quantified.chosen == (("bend",),) * 3
    chosen = quantify(fits[()], fits["kink",], fits.values(), is_chosen=True)
    assert chosen.chosen == (("kink",),) * 3
    after = np.concatenate([held_out_residual(lm.design(RUNS, "kink"), RUN == k) for k in range(3)])
    assert chosen.gap["y"].rmse_after == pytest.approx(np.sqrt(np.mean(after**2)), rel=2e-3)


def test_a_cause_that_lowers_nothing_held_back_is_unsupported():
    runs = lm.runs_of({"bend.size": 0.3}, COUNTS, seed=4)
    fits = lm.fits_of(lm.problem_of(runs), (lm.BEND,), (lm.RIPPLE,), (lm.BEND, lm.RIPPLE))
    idle = unsupported(fits["bend", "ripple"], {"bend": fits["ripple",], "ripple": fits["bend",]})
    y, gains = lm.measured(runs), {}
    for name, rest in (("bend", "ripple"), ("ripple", "bend")):
        gain = parted = 0.0
        for k in range(3):
            off = RUN == k
            less, more = (
                (y[off] - d[off] @ lm.solved(d[~off], y[~off])) / lm.SIGMA
                for d in (lm.design(runs, rest), lm.design(runs, "bend", "ripple"))
            )
            gain, parted = gain + less @ less - more @ more, parted + np.sum((less - more) ** 2)
        gains[name] = gain / (2.0 * np.sqrt(parted))
    assert (
        idle
        == [n for n in sorted(gains, key=lambda n: gains[n]) if gains[n] <= METHOD.explained_fraction.beyond]
        == ["ripple"]
    )
    # A rival that only adds such a cause is none.
    best, larger = fits["bend",], fits["bend", "ripple"]
    assert on_unseen((best, larger), set()) == ((best,), {"ripple"})
    assert on_unseen((best, fits["ripple",]), set()) == ((best, fits["ripple",]), set())
    assert on_unseen((fits["ripple",], larger), set()) == ((fits["ripple",], larger), set())
    assert on_unseen((fits["ripple",], larger), {"bend"}) == ((fits["ripple",],), {"bend"})


# The next experiment.


def experiment(name, x, minutes=1.0):
    t_s = 0.05 * np.arange(len(x))
    simulator = replace(lm.LINE, experiments={name: Experiment({"t_s": t_s, "x": x}, minutes)})
    (entry,) = SimulatorModel(simulator).menu(lm.fitted(PROBLEM))
    return entry


NEAR = experiment("near", np.linspace(-0.2, 0.2, 40))
FAR = experiment("far", np.linspace(-4.0, 4.0, 40), 2.0)
SHORT = experiment("short", np.linspace(-4.0, 4.0, 31), 1.0)


def distance(x, mine, other):
    """How far a second prediction stays from a first that is refitted to the old runs and to it."""
    columns = [np.column_stack([np.ones(len(x)), x, *((x**2, np.sin(3 * x))[("bend", "ripple").index(i)] for i in ids)])
               for ids in (mine, other)]  # fmt: skip
    theirs = columns[1] @ lm.solved(lm.design(RUNS, *other), Y) - columns[0] @ lm.solved(lm.design(RUNS, *mine), Y)
    stacked = np.vstack([lm.design(RUNS, *mine), columns[0]])
    target = np.concatenate([np.zeros(N), theirs])
    return np.linalg.norm(lm.left_of(stacked, target)) / lm.SIGMA


def test_the_run_is_proposed_that_separates_refitted_hypotheses():
    candidates = [lm.fitted(PROBLEM, lm.BEND), lm.fitted(PROBLEM, lm.RIPPLE)]
    for entry in (FAR, SHORT):
        x = entry.run.columns["x"]
        both = [distance(x, ("bend",), ("ripple",)), distance(x, ("ripple",), ("bend",))]
        proposal = propose_experiment([NEAR, entry], candidates)
        assert proposal.profile == entry.name
        assert proposal.separation_sigma == pytest.approx(min(both), rel=1e-3)
        assert proposal.minutes == entry.minutes
    # Both tell: the quicker wins, where what it tells per minute is more.
    bound = 10 * METHOD.telling.enough_sigma
    per_minute = {
        e.name: min(propose_experiment([e], candidates).separation_sigma, bound) / e.minutes for e in (FAR, SHORT)
    }
    assert propose_experiment([FAR, SHORT], candidates).profile == max(per_minute, key=lambda n: per_minute[n])


def test_a_larger_set_is_asked_whether_the_smaller_one_reaches_it():
    candidates = [lm.fitted(PROBLEM, lm.BEND), lm.fitted(PROBLEM, lm.BEND, lm.RIPPLE)]
    proposal = propose_experiment([FAR], candidates)
    x = FAR.run.columns["x"]
    expected = distance(x, ("bend",), ("bend", "ripple"))
    if expected >= METHOD.telling.enough_sigma:
        assert proposal.separation_sigma == pytest.approx(expected, rel=1e-3)
    else:
        assert proposal.profile == "none"


def test_no_run_tells_what_no_run_parts():
    louder = lm.problem_of(RUNS, 4.0)
    candidates = [lm.fitted(louder, lm.BEND), lm.fitted(louder, lm.RIPPLE)]
    proposal = propose_experiment([NEAR], candidates)
    assert (proposal.profile, proposal.separation_sigma) == ("none", 0.0)


def halves(inputs, p):
    """A bend on the right alone, a ripple on the left alone."""
    x = inputs["x"]
    right, left_half = np.maximum(x, 0.0) ** 2, np.maximum(-x, 0.0) ** 2
    return {"y": p["level"] + p["slope"] * x + p["bend.size"] * right + p["ripple.size"] * left_half}


def test_a_run_that_separates_more_hypotheses_comes_first():
    base = lm.fitted(lm.problem_of(RUNS, simulator=replace(lm.LINE, run=halves)))
    candidates = []
    # The kink does nothing here: it is the base by another name.
    for cause in (lm.KINK, lm.BEND, lm.RIPPLE):
        problem, hypothesis = base.problem, base.hypothesis.adding(cause)
        at = np.append(base.coordinates, 1.0)
        candidates.append(fit(problem, hypothesis, at, steps=0))
    right = experiment("right", np.linspace(0.0, 3.0, 40), 0.2)
    both = experiment("both", np.linspace(-3.0, 3.0, 40), 5.0)
    assert propose_experiment([right, both], candidates).profile == "both"
    assert propose_experiment([right, both], candidates[:2]).profile == "right"
    alone = propose_experiment([right], candidates)
    assert alone.profile == "right" and alone.why.code == "gap.next.separates_most"
    assert alone.why.values["others"] == 1
    assert propose_experiment([both], candidates).why.code == "gap.next.separates"


# What the runs tell.


def test_the_visible_part_of_a_parameter_is_what_the_others_leave():
    base = lm.fitted(PROBLEM)
    answers = identifiability(base, lm.CAUSES)
    columns = lm.design(RUNS)
    for k, name in enumerate(("level", "slope")):
        usual = (1.0, 2.0)[k]
        others = np.delete(columns, k, axis=1)
        residual = lm.left_of(others, columns[:, k])
        assert answers[name].sigma == pytest.approx(usual * np.linalg.norm(residual) / lm.SIGMA, rel=1e-4)
        assert answers[name].hidden == pytest.approx(
            1.0 - residual @ residual / (columns[:, k] @ columns[:, k]), rel=1e-3
        )
        assert answers[name].is_base and answers[name].is_identifiable and answers[name].beside == ()
    for cause in lm.CAUSES:
        shape = lm.design(RUNS, cause.id)[:, 2]
        residual = lm.left_of(columns, shape)
        one = answers[cause.id]
        assert one.sigma == pytest.approx(0.2 * np.linalg.norm(residual) / lm.SIGMA, rel=1e-4)
        assert one.hidden == pytest.approx(1.0 - residual @ residual / (shape @ shape), rel=1e-3)
        assert not one.is_base and one.own == 0.0 and not one.is_run_nuisance
    shapes = {c.id: lm.left_of(columns, lm.design(RUNS, c.id)[:, 2]) for c in lm.CAUSES}
    alike = [
        pair for pair in combinations(shapes, 2)
        if abs(shapes[pair[0]] @ shapes[pair[1]]) > METHOD.telling.alike
        * np.linalg.norm(shapes[pair[0]]) * np.linalg.norm(shapes[pair[1]])
    ]  # fmt: skip
    assert list(answers.alike) == alike


def test_causes_of_one_shape_are_alike_and_are_said_to_be():
    def same(inputs, p):
        return lm.LINE.run(inputs, {**p, "bend.size": p["bend.size"] - 0.7 * p["kink.size"], "kink.size": 0.0})

    answers = identifiability(lm.fitted(lm.problem_of(RUNS, simulator=replace(lm.LINE, run=same))), lm.CAUSES)
    assert answers.alike == (("bend", "kink"),)
    assert len(reasons(answers)) == 1
    assert answers.record()["alike"] == [["bend", "kink"]]


def test_what_is_too_small_is_identified_by_a_run_that_shows_it():
    narrow = [replace(r, columns={**r.columns, "x": 0.02 * r.columns["x"]}) for r in RUNS]
    base = lm.fitted(lm.problem_of(narrow, 0.4))
    answers = identifiability(base, (lm.BEND,), [FAR, NEAR, SHORT])
    columns = np.column_stack([np.ones(N), np.concatenate([r.columns["x"] for r in narrow])])
    level, slope = columns.T
    slope_residual = lm.left_of(level[:, None], slope)
    assert answers["slope"].sigma == pytest.approx(2.0 * np.linalg.norm(slope_residual) / 0.4, rel=1e-3)
    assert not answers["slope"].is_identifiable and not answers["bend"].is_identifiable
    # The quickest first; the near one shows neither.
    assert answers["slope"].by == answers["bend"].by == ("short", "far")
    assert answers["level"].by == ()
    assert answers["slope"].beside == ()
    untold = [one.name for one in answers.unidentifiable]
    assert untold == ["slope", "bend"]
    assert set(answers.record()["causes"]) == {"bend"} and set(answers.record()["base"]) == {"level", "slope"}


def test_a_parameter_that_another_imitates_names_it():
    far_off = [replace(r, columns={**r.columns, "x": 1.0 + 1e-3 * r.columns["x"]}) for r in RUNS]
    answers = identifiability(lm.fitted(lm.problem_of(far_off)), ())
    assert answers["slope"].beside == ("level",) and answers["level"].beside == ("slope",)
    assert answers["slope"].hidden > 0.999


def test_what_changes_nothing_does_not_show():
    base = lm.fitted(
        lm.problem_of(RUNS, simulator=replace(lm.LINE, run=lambda i, p: lm.LINE.run(i, {**p, "slope": 2.0})))
    )
    answers = identifiability(base, (lm.BEND,))
    assert (answers["slope"].sigma, answers["slope"].hidden) == (0.0, 0.0)
    assert not answers["slope"].is_identifiable


def test_a_cause_that_each_run_may_have_of_its_own_is_an_offset():
    zeroed = replace(
        lm.LINE,
        per_run={"y": {"zero": 50.0}},
        run=lambda i, p: lm.LINE.run(
            i, {**p, "bend.size": 0.0, "level": p["level"] + p["bend.size"] * (1 + 1e-3 * i["x"] ** 2)}
        ),
    )
    answers = identifiability(lm.fitted(lm.problem_of(RUNS, simulator=zeroed)), (lm.BEND, lm.RIPPLE))
    # Each run's own zero takes the shape of the level, and of a bend that is next to level.
    assert answers["bend"].offset in ("", "zero of y")
    columns = lm.design(RUNS, "ripple")
    run_offsets = np.column_stack([(RUN == k).astype(float) for k in range(3)])
    before_offsets, after = (
        lm.left_of(columns[:, :2], columns[:, 2]),
        lm.left_of(np.column_stack([columns[:, 1], run_offsets]), columns[:, 2]),
    )
    assert answers["ripple"].own == pytest.approx(1.0 - after @ after / (before_offsets @ before_offsets), abs=1e-3)
    assert answers["ripple"].sigma == pytest.approx(0.2 * np.linalg.norm(after) / lm.SIGMA, rel=1e-3)


# Empirical terms.


def test_what_is_held_back_are_runs_and_then_quarters():
    cells = frozenset((k, q) for k in (0, 2) for q in range(3))
    by_run, by_quarter = splits(cells)
    assert by_run == [frozenset((k, q) for q in range(3)) for k in (0, 2)]
    assert by_quarter == [frozenset((k, q) for k in (0, 2)) for q in range(3)]
    assert splits(frozenset((1, q) for q in range(2))) == [[frozenset({(1, 0)}), frozenset({(1, 1)})]]
    assert splits(frozenset({(1, 1)})) == []


def test_a_learned_term_is_what_least_squares_gives_it():
    runs = lm.runs_of({"bend.size": 0.6}, COUNTS)
    base = lm.fitted(lm.problem_of(runs))
    squares = [t for t in terms_of(lm.LINE, base) if t.signal == "x" and t.kind in ("²", "³")]
    learned = learn_residual(base, (base,), squares)
    (one,) = learned.terms
    extra = np.concatenate([one.term.values(r.t_s, r.columns) for r in runs])
    columns = np.column_stack([lm.design(runs), extra])
    exact = lm.solved(columns, lm.measured(runs))
    assert one.term.coefficient == pytest.approx(exact[2], rel=1e-4)
    residual = lm.left_of(columns, lm.measured(runs)) / lm.SIGMA
    worse = max(1.0, np.sqrt(residual @ residual / N))
    assert one.standard_error == pytest.approx(
        worse * lm.SIGMA * np.sqrt(np.linalg.inv(columns.T @ columns)[2, 2]), rel=1e-3
    )
    assert one.chosen == 1.0
    assert learned.without == 0.0 and learned.other_causes == ()
    assert (
        learned.explained_fraction.low < learned.explained_fraction.predicted <= learned.explained_fraction.high <= 1.0
    )
    assert learned.explained_fraction.predicted > 0.9
    record = learned.record()
    assert record["terms"][0]["coefficient"] == one.term.coefficient
    assert record["beside"] == []


def test_nothing_is_learned_where_nothing_is_left():
    runs = lm.runs_of({}, COUNTS)
    base = lm.fitted(lm.problem_of(runs))
    assert learn_residual(base, (base,), list(terms_of(lm.LINE, base))) is None


# The search.


def search_of(runs, problem=None):
    base = lm.fitted(problem or lm.problem_of(runs))
    return Search(base, lm.CAUSES)


@pytest.mark.parametrize("names", [(), ("bend",), ("bend", "ripple")])
def test_a_search_finds_the_set_that_is_there(names):
    runs = lm.runs_of({f"{name}.size": 0.4 for name in names}, COUNTS, seed=2)
    search = search_of(runs)
    search.run()
    assert search.best.ids == names
    for ids, fit_of_set in search.fits.items():
        if fit_of_set.problem.sigma["y"] == lm.SIGMA:
            columns = lm.design(runs, *ids)
            assert fit_of_set.chi2 >= np.sum(lm.left_of(columns, lm.measured(runs)) ** 2) / lm.SIGMA**2 - 1e-6
    assert search.closest.chi2 == min(f.chi2 for f in search.fits.values())


def hand_search(runs=RUNS):
    return lm.search_with(lm.fits_of(lm.problem_of(runs), (lm.BEND,), (lm.RIPPLE,), (lm.BEND, lm.RIPPLE)))


def test_a_share_is_of_what_the_base_leaves_above_the_noise():
    search = hand_search()
    for ids, fit_of_set in search.fits.items():
        excess = [np.sum(lm.left_of(lm.design(RUNS, *i), Y) ** 2) / lm.SIGMA**2 - N for i in ((), ids)]
        assert search.share(fit_of_set) == pytest.approx(1.0 - excess[1] / excess[0], abs=1e-4)
        assert search.explained_share(fit_of_set) == np.clip(search.share(fit_of_set), 0.0, 1.0)
    louder = lm.problem_of(RUNS, 10.0)
    noise = Search(lm.fitted(louder), lm.CAUSES)
    assert noise.share(noise.base) == 1.0


def test_one_less_are_the_sets_without_each_cause():
    search = hand_search()
    both = search.fits["bend", "ripple"]
    assert {i: f.ids for i, f in one_less(search.fits, both).items()} == {"bend": ("ripple",), "ripple": ("bend",)}
    assert {i: f.ids for i, f in one_less(search.fits, search.fits["bend",]).items()} == {"bend": ()}


def test_of_two_fits_of_one_set_the_likelier_is_kept():
    search = hand_search()
    good = search.fits["bend",]
    worse = replace(good, chi2=good.chi2 + 50.0)
    search.store(worse)
    assert search.fits["bend",] is good
    better = replace(good, chi2=good.chi2 - 1.0)
    search.store(better)
    assert search.fits["bend",] is better
    search.store(replace(search.fits["ripple",], chi2=np.inf))
    assert search.fits["ripple",].chi2 < np.inf


def test_what_is_explained_is_by_the_share_for_its_count():
    search = hand_search()
    search.model = SimpleNamespace(is_clean=lambda fit_of_set: False)
    enough = METHOD.search.enough
    for count, min_share in enumerate(enough[:2], start=1):
        fit_of_set = search.fits[("bend", "ripple")[:count]]
        gap = search.base.chi2 - search.base.problem.count
        for share, is_enough in ((min_share + 1e-4, True), (min_share - 1e-4, False)):
            assert (
                search.is_explained(replace(fit_of_set, chi2=fit_of_set.problem.count + (1.0 - share) * gap))
                is is_enough
            )


# From a search to a report.


def test_the_nearest_is_the_simplest_that_takes_nearly_the_most():
    search = hand_search()
    gap = search.base.chi2 - N
    near = METHOD.verdict.near_share
    for lacks, ids in ((0.5 * near, ("bend",)), (1.5 * near, ("bend", "ripple"))):
        both = replace(search.fits["bend", "ripple"], chi2=N + 0.10 * gap)
        one = replace(search.fits["bend",], chi2=N + (0.10 + lacks) * gap)
        fits = {(): search.base, ("bend",): one, ("bend", "ripple"): both}
        assert nearest(fits).ids == ids
        assert partial_of(fits, search.base).effects == ids
        assert partial_of(fits, search.base).share == pytest.approx(0.9 - (lacks if ids == ("bend",) else 0.0))
        # Where a set stands it is that one.
        assert partial_of(fits, one).effects == ("bend",)
    assert partial_of({(): search.base}, search.base) is None


def test_a_rest_without_a_name_is_left_where_the_gap_is_not_explained():
    search = hand_search()
    assessment = assess_search(search)
    verdicts = get_args(DiagnosisVerdict)
    assert {v for v in verdicts if replace(assessment, verdict=v).is_partial} == {"unknown", "explained_in_part"}


def test_what_several_causes_take_is_split_by_the_mean_of_first_and_last():
    search = hand_search()
    best, chi2 = search.fits["bend", "ripple"], {ids: f.chi2 for ids, f in search.fits.items()}
    chances = {"bend": 0.7, "ripple": 0.9, "kink": 0.0}
    rows = ranked_causes(search.fits, best, lm.CAUSES, (best,), chances, 0.8)
    assert [r.effect for r in rows] == ["ripple", "bend", "kink"]
    worth = {
        "bend": 0.5 * (chi2[()] - chi2["bend",] + chi2["ripple",] - chi2["bend", "ripple"]),
        "ripple": 0.5 * (chi2[()] - chi2["ripple",] + chi2["bend",] - chi2["bend", "ripple"]),
    }
    for row in rows[:2]:
        assert row.shrink == pytest.approx(0.8 * worth[row.effect] / sum(worth.values()))
        assert row.parameters["size"].value == pytest.approx(best.effect_values[best.ids.index(row.effect)][0])
        assert row.stage == f"part of {row.effect}"
    assert rows[2].shrink is None and rows[2].alone is None and rows[2].added is None
    excess = chi2[()] - N
    for row, other in zip(rows[:2], ("bend", "ripple"), strict=True):
        assert row.alone == pytest.approx(np.clip((chi2[()] - chi2[row.effect,]) / excess, 0.0, 1.0))
        assert row.added == pytest.approx((chi2[other,] - chi2["bend", "ripple"]) / excess)
    (alone, *_) = ranked_causes(search.fits, search.fits["bend",], lm.CAUSES, (best,), {**chances, "bend": 1.0}, 0.8)
    assert (alone.effect, alone.shrink) == ("bend", pytest.approx(0.8))
    nothing = ranked_causes(search.fits, search.base, lm.CAUSES, (), chances, 0.8)
    assert all(r.shrink is None for r in nothing)
    locations = fault_locations(
        rows[:2], "y", Reason("gap.regime.everywhere"), lambda i: reason("gap.effect", effect=i)
    )
    assert [p.share for p in locations] == pytest.approx([r.shrink / 0.8 for r in rows[:2]])
    assert [p.stage for p in locations] == [r.stage for r in rows[:2]]


def test_the_first_four_regimes_are_listed():
    regimes_seen = [Regime("y", Reason("gap.regime.start"), 0.1 * k, 2.0) for k in range(1, 7)]
    locations = regime_locations("pad", regimes_seen, "gap.seen.energy")
    assert [p.share for p in locations] == [0.1, 0.2, pytest.approx(0.3), 0.4]
    assert {p.stage for p in locations} == {"pad"}


def test_a_planned_run_is_predicted_like_any_other():
    entry = planned(
        replace(lm.LINE, experiments={"e": Experiment({"t_s": 0.05 * np.arange(40), "x": np.ones(40)})}), "e"
    )
    problem = PROBLEM.of_run(entry)
    np.testing.assert_allclose(problem.predict(Hypothesis(of_all=lm.LINE.base), np.array([1.0, 2.0])), 3.0)
    assert problem.sigma == PROBLEM.sigma and problem.scale == PROBLEM.scale


def test_a_search_of_the_twin_is_an_effect_search():
    assert issubclass(Search, Search)
    assert isinstance(NEAR, MenuEntry)
