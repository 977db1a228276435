"""Evidence of a lot, verdicts, and reports on a linear mechanism: sums that can be done by hand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from softcal.core import lot_diagnosis
from softcal.core.errors import InputError
from softcal.core.gap import search
from softcal.core.gap.case import of_gain
from softcal.core.gap.diagnosis import Diagnosis, assess_search
from softcal.core.gap.evidence import probabilities
from softcal.core.gap.fit import Regime, Yardstick, exact_log_evidence, log_evidences, misfit, penalty, structure
from softcal.core.gap.method import METHOD
from softcal.core.gap.residual import ExplainedFraction, Quantified
from softcal.core.gap.search import search_under_correlated_noise
from softcal.core.gap.simulator import Experiment
from softcal.core.gap.simulator_model import check_simulator, diagnose_simulator
from softcal.core.lot_diagnosis import UnitSearch, diagnose_lot, joint_logs, lot_logs
from softcal.core.messages.reason import Reason
from softcal.core.twin.catalogue import EFFECTS
from tests.core import linear_mechanism as lm

EVIDENCE, COMPETING, VERDICT = METHOD.evidence, METHOD.competing, METHOD.verdict
SETS = ((lm.BEND,), (lm.RIPPLE,), (lm.BEND, lm.RIPPLE))


def unit(seed, curvature=0.3, counts=(60, 71), sets=SETS):
    return lm.fits_of(lm.problem_of(lm.runs_of({"bend.size": curvature}, counts, seed=seed)), *sets)


UNITS = [unit(k, 0.25 + 0.05 * k, (50 + 5 * k, 61)) for k in range(3)]
SEARCHED = [UnitSearch.from_fits(fits) for fits in UNITS]
PRIOR = np.log(EVIDENCE.prior_odds)


def test_what_a_unit_leaves_for_its_lot():
    one, fits = SEARCHED[0], UNITS[0]
    assert one.logs == log_evidences(fits)
    assert one.top == max(one.logs.values())
    assert one.misfit_and_penalty == {ids: (f.chi2, penalty(f)) for ids, f in fits.items()}
    assert one.shared(("bend",)) == pytest.approx(one.logs["bend",] - PRIOR)
    assert one.shared(("bend", "ripple")) == pytest.approx(one.logs["bend", "ripple"] - 2 * PRIOR)
    # What was not fitted has its bound.
    assert one.shared(("kink",)) == pytest.approx(one.top - PRIOR)
    assert one.stray == pytest.approx(np.log(EVIDENCE.stray_odds) + one.top)
    odds = EVIDENCE.stray_odds
    expected = np.log((1 - odds) * np.exp(one.shared(("ripple",)) - one.top) + odds) + one.top
    assert one.log_term(("ripple",)) == pytest.approx(expected)
    np.testing.assert_allclose(one.fitted(("bend",)).coordinates, fits["bend",].coordinates, atol=1e-6)


def test_what_a_unit_did_not_try_is_fitted_from_another():
    for sign in (1.0, -1.0):
        short = UnitSearch.from_fits(unit(5, sign * 0.4, sets=((lm.RIPPLE,),)))
        donor = SEARCHED[1].fits["bend",]
        short.add(("bend",), donor)
        runs = lm.runs_of({"bend.size": sign * 0.4}, seed=5)
        columns = lm.design(runs, "bend")
        np.testing.assert_allclose(short.fits["bend",][1], lm.solved(columns, lm.measured(runs)), atol=1e-3)
        assert short.misfit_and_penalty["bend",][0] == pytest.approx(
            np.sum(lm.left_of(columns, lm.measured(runs)) ** 2) / lm.SIGMA**2, abs=0.05
        )
        assert short.logs["bend",] == pytest.approx(short.yardstick.log_evidence(short.fitted(("bend",))), abs=0.1)


def test_the_misfits_of_units_add_and_are_scored_as_one():
    sets = list(SEARCHED[0].logs)
    logs = joint_logs(SEARCHED, sets)
    sizes = sum(np.log(s.problem.count) for s in SEARCHED[1:])
    misfits = {ids: sum(s.misfit_and_penalty[ids][0] for s in SEARCHED) + len(ids) * sizes for ids in sets}
    noise_floor = sum(s.yardstick.noise_floor for s in SEARCHED)
    for ids in sets:
        cost = np.mean([s.misfit_and_penalty[ids][1] for s in SEARCHED])
        assert logs[ids] == pytest.approx(
            -0.5 * (misfit(noise_floor + misfits[ids] - min(misfits.values()), EVIDENCE.modes) + cost)
        )
    assert max(logs, key=lambda ids: logs[ids]) == ("bend",)


def test_a_lot_pays_the_odds_of_a_cause_once():
    votes, ruled_out = lot_logs(SEARCHED)
    for ids, vote in votes.items():
        assert vote == pytest.approx(len(ids) * PRIOR + sum(s.log_term(ids) for s in SEARCHED))
    assert ruled_out == len(SEARCHED[0].logs) - len(votes)
    # What lies so far behind at its bound is not fitted.
    best = max(votes.values())
    assert all(vote >= best - 3 * COMPETING.negligible for vote in votes.values())
    assert max(votes, key=lambda ids: votes[ids]) == ("bend",)


def test_a_set_that_one_unit_lacks_is_fitted_to_it():
    units = [UnitSearch.from_fits(unit(7, 0.3)), UnitSearch.from_fits(unit(8, 0.3, sets=((lm.RIPPLE,),)))]
    votes, _ = lot_logs(units)
    assert ("bend",) in units[1].logs and ("bend",) in votes


def stub_diagnosis(fits, verdict="explained"):
    best = fits[max(log_evidences(fits), key=lambda i: log_evidences(fits)[i])]
    return SimpleNamespace(
        verdict=verdict, best=best, competing_hypotheses=(best,), case=best.problem.case, mistakes=()
    )


def test_a_lot_is_diagnosed_from_its_units(monkeypatch):
    outlier = lm.fits_of(lm.problem_of(lm.runs_of({"ripple.size": 0.8}, (60, 71), seed=9)), *SETS)
    mistaken = unit(11)
    every = {"u1": UNITS[0], "u2": UNITS[1], "u3": UNITS[2], "odd": outlier, "spoilt": mistaken}

    def diagnose(name, on_fits):
        if name != "spoilt":
            on_fits(every[name])
        return stub_diagnosis(every[name], "data" if name == "spoilt" else "explained")

    monkeypatch.setattr(lot_diagnosis, "diagnose", diagnose)
    messages = []
    diagnosis = diagnose_lot({name: name for name in every}, messages.append)
    assert (diagnosis.verdict, diagnosis.causes) == ("explained", ("bend",))
    assert (diagnosis.outliers, diagnosis.excluded) == (["odd"], ["spoilt"])
    assert diagnosis.logs == joint_logs(SEARCHED, diagnosis.logs)
    assert diagnosis.probability["bend"] == pytest.approx(probabilities(diagnosis.logs, ["bend"])["bend"])
    by_name = {m.name: m for m in diagnosis.members}
    for name, one in zip(("u1", "u2", "u3"), SEARCHED, strict=True):
        row = by_name[name]
        assert row.follows and row.log_odds == pytest.approx(one.shared(("bend",)) - one.stray)
        assert row.sizes["bend"]["size"].value == pytest.approx(one.fits["bend",][1][2], abs=1e-6)
    assert by_name["odd"].log_odds < 0.0 and by_name["odd"].sizes == {}
    assert by_name["spoilt"].fit is None and by_name["spoilt"].log_odds is None
    report = diagnosis.report()
    assert report["causes"][0] == {"effect": "bend", "probability": diagnosis.probability["bend"], "shared": True}
    assert [u["unit"] for u in report["units"]] == list(every)
    assert report["units"][0]["follows"] is True and report["units"][0]["own"] == ["bend"]
    assert "unit 1 of 5" in messages[0]
    with pytest.raises(InputError, match="1 unit"):
        diagnose_lot({"u1": "u1"})
    pair = diagnose_lot({"u1": "u1", "u2": "u2"})
    assert pair.causes == ("bend",)


def test_a_lot_of_mistakes_alone_gets_no_diagnosis(monkeypatch):
    monkeypatch.setattr(lot_diagnosis, "diagnose", lambda name, on_fits: stub_diagnosis(UNITS[0], "data"))
    diagnosis = diagnose_lot({"a": "a", "b": "b"})
    assert (diagnosis.verdict, diagnosis.causes, diagnosis.excluded) == ("data", (), ["a", "b"])


def test_probabilities_of_an_unknown_lot_are_trusted_less(monkeypatch):
    def diagnose(name, on_fits):
        on_fits(UNITS[int(name)])
        return stub_diagnosis(UNITS[int(name)], "unknown")

    monkeypatch.setattr(lot_diagnosis, "diagnose", diagnose)
    diagnosis = diagnose_lot({"0": "0", "1": "1", "2": "2"})
    assert diagnosis.verdict == "unknown"
    assert diagnosis.probability["bend"] == pytest.approx(
        VERDICT.unknown_trust * probabilities(diagnosis.logs, ["bend"])["bend"]
    )


# From a search to a verdict.


def search_of(
    truth,
    seed=2,
    counts=(60, 71, 48),
    sets=((lm.BEND,), (lm.RIPPLE,), (lm.KINK,), (lm.BEND, lm.RIPPLE)),
    best=("bend",),
):
    search = lm.search_with(lm.fits_of(lm.problem_of(lm.runs_of(truth, counts, seed=seed)), *sets))
    search.best = search.fits[best]
    return search


def test_an_explained_gap_has_the_probabilities_of_bayes():
    search = search_of({"bend.size": 0.5})
    diagnosis = assess_search(search)
    assert diagnosis.verdict == "explained" and [f.ids for f in diagnosis.group] == [("bend",)]
    assert diagnosis.quantified.explained_fraction.held_out > 0.95 and diagnosis.list_complete > 0.75
    bayes = probabilities(log_evidences(search.fits), [c.id for c in lm.CAUSES])
    # Sets of less than a thousandth say nothing.
    assert diagnosis.chances == pytest.approx(bayes, abs=5e-3)


def test_a_cause_that_lowers_nothing_is_taken_out_of_the_best():
    search = search_of({"bend.size": 0.5}, best=("bend", "ripple"))
    assess_search(search)
    assert search.best.ids == ("bend",)


def test_a_cause_held_open_counts_by_the_mean_of_two_readings():
    search = search_of({"bend.size": 0.5})
    larger = search.fits["bend", "ripple"]
    search.not_excluded = {"ripple": larger}
    diagnosis = assess_search(search)
    group, chances = diagnosis.group, diagnosis.chances
    if larger in group:
        exact = probabilities({f.ids: exact_log_evidence(f) for f in (search.best, larger)}, ["ripple"])["ripple"]
        plain = probabilities(log_evidences(search.fits), ["ripple"])["ripple"]
        assert chances["ripple"] == pytest.approx(VERDICT.surrogate_trust * 0.5 * (plain + exact), abs=1e-3)
    else:
        plain = probabilities(log_evidences(search.fits), ["ripple"])["ripple"]
        assert chances["ripple"] == pytest.approx(VERDICT.surrogate_trust * plain, abs=1e-3)


def quantified(held_out=0.99, gain=100.0):
    return Quantified({}, ExplainedFraction(held_out, held_out, held_out, held_out), "", (), gain, 1.0)


DOWN, CHANCE = VERDICT.down_to_noise, VERDICT.doubted_chance


@pytest.mark.parametrize(
    ("gain", "error", "held_out", "is_confirmed"),
    [(1.65, 1.0, 0.5, True), (1.63, 1.0, 0.5, False), (1.65, 1.0, 0.0, False), (0.0, 0.0, 0.5, False)],
)
def test_causes_stand_by_their_gain_on_samples_held_back(gain, error, held_out, is_confirmed):
    quantified_set = Quantified({}, ExplainedFraction(0.5, 0.4, 0.6, held_out), "", (), gain, error)
    assert quantified_set.is_supported is is_confirmed


def test_another_noise_is_kept_only_where_it_explains(monkeypatch):
    model = SimpleNamespace(is_clean=lambda fit: fit == "clean", is_uneven=lambda fit: False)
    start = SimpleNamespace(hypothesis=SimpleNamespace(of_base=slice(0, 0)), coordinates=np.zeros(0))
    closest = SimpleNamespace(hypothesis=None, coordinates=np.zeros(0), chi2=1.0)
    first = SimpleNamespace(
        model=model, best="left", closest=closest, start=start, candidates=(), on_progress=lambda _: None
    )
    monkeypatch.setattr(search, "with_correlated_noise", lambda fit: None)
    assert search_under_correlated_noise(first) is first
    monkeypatch.setattr(search, "with_correlated_noise", lambda fit: "problem")
    monkeypatch.setattr(search, "fit", lambda problem, hypothesis, start, steps=20: closest)
    for unmodelled, best, is_noise_before, is_noise, is_accepted in (
        (None, "clean", True, True, True),
        ("x", "clean", True, True, False),
        (None, "left", True, True, False),
        (None, "clean", True, False, False),
        (None, "clean", False, True, False),
    ):
        again = SimpleNamespace(unmodelled=unmodelled, best=best, run=lambda: None)
        answers = {id(closest): is_noise_before, id(best): is_noise}
        monkeypatch.setattr(search, "is_noise", lambda fit, answers=answers: answers[id(fit)])
        monkeypatch.setattr(search, "Search", lambda base, candidates, say, again=again: again)
        assert (search_under_correlated_noise(first) is again) is is_accepted
    assert search_under_correlated_noise(SimpleNamespace(model=model, best="clean", closest=closest)).best == "clean"


def test_mistaken_recordings_name_and_foretell_nothing():
    base = UNITS[0][()]
    diagnosis = Diagnosis.stopped(base.problem.model, base, (of_gain("y", (1,), 2.0, Reason("gap.next.no_gap")),))
    assert diagnosis.verdict == "data" and {c.probability for c in diagnosis.causes} == {0.0}
    assert diagnosis.explained_fraction.predicted == diagnosis.explained_fraction.held_out == 0.0
    assert diagnosis.next_experiment.profile == "none" and diagnosis.identifiability is None
    assert diagnosis.case is base.problem.case
    assert diagnosis.gap["y"].rmse_before == pytest.approx(np.sqrt(np.mean((measured_of(base) - base.predicted) ** 2)))


def measured_of(diagnosis):
    return diagnosis.problem.measured


# The whole diagnosis of a mechanism.


EXPERIMENTS = {"wide": Experiment({"t_s": 0.05 * np.arange(60), "x": np.linspace(-4, 4, 60)}, 2.0)}


@pytest.fixture(scope="module")
def line_diagnosis():
    runs = lm.runs_of({"bend.size": 0.5}, (60, 71, 48), seed=3)
    return runs, diagnose_simulator(replace(lm.LINE, experiments=EXPERIMENTS), runs, "S7")


def test_the_diagnosis_of_a_line_is_that_of_its_algebra(line_diagnosis):
    runs, diagnosis = line_diagnosis
    assert (diagnosis.verdict, diagnosis.best.ids) == ("explained", ("bend",))
    exact = lm.solved(lm.design(runs, "bend"), lm.measured(runs))
    report = diagnosis.report()
    assert report["parameters"]["bend.size"] == pytest.approx(exact[2], abs=1e-3)
    assert report["parameters"]["level"] == pytest.approx(exact[0], abs=1e-3)
    assert report["base"]["bend.size"] == 0.0 and report["base"]["slope"] == pytest.approx(
        lm.solved(lm.design(runs), lm.measured(runs))[1], abs=1e-3
    )
    assert report["simulator"] == "line" and report["failed"] is None and report["offsets"] == []
    assert report["serial"] == "S7" and report["ambiguous_with"] == []
    cause = diagnosis.causes[0]
    assert (cause.effect, cause.stage) == ("bend", "part of bend") and cause.probability > 0.95
    assert cause.shrink == pytest.approx(diagnosis.explained_fraction.held_out)
    assert cause.parameters["size"].low < exact[2] < cause.parameters["size"].high
    residual = lm.left_of(lm.design(runs), lm.measured(runs))
    gap = diagnosis.gap["y"]
    assert gap.noise_floor == pytest.approx(lm.SIGMA, rel=0.15) and gap.rmse_after < 1.2 * lm.SIGMA
    assert gap.rmse_before == pytest.approx(np.sqrt(np.mean(residual**2)), rel=0.1)
    shape = lm.design(runs, "bend")[:, 2]
    hidden = 1 - np.sum(lm.left_of(lm.design(runs), shape) ** 2) / np.sum(shape**2)
    assert diagnosis.hidden_fraction["bend"] == pytest.approx(hidden, abs=1e-3)
    assert diagnosis.locations[0].stage == "part of bend" and diagnosis.locations[0].share == pytest.approx(1.0)
    assert diagnosis.explained_share > 0.95 and diagnosis.partial is None and diagnosis.residual is None
    assert diagnosis.next_experiment.profile == "none"
    assert len(diagnosis.chosen) == 3


def test_no_gap_and_an_unknown_one():
    clean = diagnose_simulator(lm.LINE, lm.runs_of({}, (60, 71, 48), seed=4))
    assert clean.verdict == "no_gap" and clean.locations == () and clean.best.ids == ()
    assert clean.next_experiment.why.code == "gap.next.no_gap"
    strange = [
        replace(r, columns={**r.columns, "y": r.columns["y"] + 0.3 * np.sign(np.sin(5 * r.columns["x"]))})
        for r in lm.runs_of({}, (80, 91, 78), seed=4)
    ]
    unknown = diagnose_simulator(lm.LINE, strange)
    assert unknown.verdict == "unknown" and unknown.locations[0].stage == "unknown"
    assert unknown.next_experiment.why.code == "gap.next.add_candidate"
    assert all(c.probability < 0.31 for c in unknown.causes)
    with pytest.raises(InputError, match="no run"):
        diagnose_simulator(lm.LINE, [])


def test_a_check_gives_identifiability_without_a_search():
    mistakes, identifiability = check_simulator(lm.LINE, lm.runs_of({"bend.size": 0.2}))
    assert mistakes == () and identifiability["bend"].is_identifiable
    dead = [replace(r, columns={**r.columns, "y": np.ones(len(r))}) if r.name == "2" else r for r in lm.runs_of({})]
    mistakes, identifiability = check_simulator(lm.LINE, dead)
    assert mistakes[0].what == "constant" and identifiability is None
    with pytest.raises(InputError, match="no run"):
        check_simulator(lm.LINE, [])


# Places and next runs of the soft sensor's twin.


REGIMES = (
    Regime("force", Reason("gap.regime.loading"), 0.7, 2.0),
    Regime("output", Reason("gap.regime.hold"), 0.4, 2.0),
)


def cause(effect_id, share):
    return SimpleNamespace(effect=effect_id, stage=EFFECTS[effect_id].stage, shrink=share)


def test_the_yardstick_is_of_the_closest():
    fits = UNITS[0]
    assert Yardstick.from_fits(fits.values()).chi2 == min(f.chi2 for f in fits.values())
    assert structure(lm.fitted(lm.problem_of(lm.runs_of({})))).z < METHOD.structure.structured_z
