"""Simulators of somebody else: offsets, delays, terms, calls, units and search starts, by their equations."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize

from softcal.core.errors import InputError
from softcal.core.gap.case import Case, DataMistake, RigScale, apart, numbers, of_gain, of_sign, of_unit, unit_of
from softcal.core.gap.fit import fit
from softcal.core.gap.hypothesis import Hypothesis, fit_scale, from_fit, start_coordinates, to_fit
from softcal.core.gap.method import METHOD
from softcal.core.gap.model import Problem
from softcal.core.gap.simulator import Experiment, Simulator, candidate, check_calls, planned, recorded
from softcal.core.gap.simulator_model import Calls, SimulatorModel, best_start, likeliest, scattered
from softcal.core.gap.simulator_reach import (
    CUBE,
    FACTORS,
    LEVEL,
    RATE,
    REMEMBERED,
    SIZED_TIME,
    SIZED_WAY,
    SQUARE,
    TIME,
    WAY,
    MistakeTest,
    SimulatorTerm,
    against_others,
    cut_off,
    recording_mistakes,
    shifted,
    term_of,
    terms_of,
    with_terms,
)
from softcal.core.messages.reason import Reason
from softcal.core.twin.effects import Parameter
from tests.core.linear_mechanism import (
    BEND,
    LINE,
    RIPPLE,
    SIGMA,
    design,
    fitted,
    measured,
    problem_of,
    runs_of,
    solved,
)
from tests.core.linear_mechanism import LEVEL as HEIGHT

CONFIG = METHOD.mistake
T_s = np.cumsum(np.random.default_rng(1).uniform(0.02, 0.08, 80))


# A channel some time later.


@pytest.mark.parametrize("delay_s", [0.05, -0.12, 0.0])
@pytest.mark.parametrize("linear_share", [0.0, 1.0, 0.3])
def test_a_late_channel_is_read_at_earlier_instants(delay_s, linear_share):
    values = np.sin(2.0 * T_s)
    late, rate, bent = shifted(values, T_s, delay_s, linear_share)
    at_s = np.clip(T_s - delay_s, T_s[0], T_s[-1])
    line, curve = np.interp(at_s, T_s, values), CubicSpline(T_s, values)
    np.testing.assert_allclose(late, linear_share * line + (1.0 - linear_share) * curve(at_s), atol=1e-12)
    np.testing.assert_allclose(bent, line - curve(at_s), atol=1e-12)
    eps = 1e-7
    moved = shifted(values, T_s, delay_s - eps, linear_share)[0]
    inside = (T_s - delay_s > T_s[0] + 1e-6) & (T_s - delay_s + eps < T_s[-1])
    np.testing.assert_allclose(rate[inside], ((moved - late) / eps)[inside], atol=1e-5)
    assert np.all(rate[T_s - delay_s <= T_s[0]] == 0.0)


LARGEST_OFFSETS = {"zero": 2.0, "gain": 0.3, "drift": 0.1, "delay": 0.2}


def smooth_runs(offsets=({}, {}), noise=0.0, count=80):
    """Runs of the line along a smooth input, each with offsets of its own."""
    rng, out = np.random.default_rng(3), []
    for k, mine in enumerate(offsets):
        t_s = np.arange(count) * 0.05 + 7.0 * k
        x = np.sin((1.3 + 0.4 * k) * (t_s - t_s[0]))
        late_s = t_s - t_s[0] - mine.get("delay", 0.0)
        y = 1.0 + 2.0 * CubicSpline(t_s - t_s[0], x)(np.clip(late_s, 0.0, None))
        y = y * (1.0 + mine.get("gain", 0.0)) + mine.get("zero", 0.0) + mine.get("drift", 0.0) * (t_s - t_s[0])
        out.append(recorded(LINE, f"{k + 1}", {"t_s": t_s, "x": x, "y": y + rng.normal(0.0, noise, count)}))
    return out


def simulator_with_offsets(*kinds):
    return replace(LINE, per_run={"y": {kind: LARGEST_OFFSETS[kind] for kind in kinds}})


EXACT = np.array([1.0, 2.0])
BASE = Hypothesis(of_all=LINE.base)


@pytest.mark.parametrize(
    ("kind", "sizes", "expected"),
    [
        ("zero", (0.5, -0.4), (0.5, -0.4)),
        ("drift", (0.05, -0.03), (0.05, -0.03)),
        # A gain that all runs share is the base's.
        ("gain", (0.1, -0.1, 0.02), (0.08, -0.12, 0.0)),
        ("delay", (0.06, -0.0, 0.03), (0.06, 0.0, 0.03)),
    ],
)
def test_the_offsets_of_each_run_are_read_off_it(kind, sizes, expected):
    runs = smooth_runs([{kind: s} for s in sizes])
    problem = problem_of(runs, 0.01, simulator_with_offsets(kind))
    offsets = problem.offset_sizes(BASE, EXACT)
    np.testing.assert_allclose([offsets[k][0] for k in range(len(sizes))], expected, atol=1e-3)
    if kind != "gain":
        np.testing.assert_allclose(problem.predict(BASE, EXACT), measured(runs), atol=2e-3)


def test_offsets_stay_within_their_largest():
    runs = smooth_runs([{"zero": 5.0}, {"zero": -9.0}])
    problem = problem_of(runs, 0.01, simulator_with_offsets("zero"))
    offsets = problem.offset_sizes(BASE, EXACT)
    assert (offsets[0][0], offsets[1][0]) == (2.0, -2.0)
    predicted = problem.predict(BASE, EXACT)
    np.testing.assert_allclose(measured(runs) - predicted, np.repeat([3.0, -7.0], 80), atol=1e-4)


def test_a_zero_and_a_drift_together_are_a_line_through_what_is_left():
    runs = smooth_runs([{"zero": 0.3, "drift": 0.02}, {"zero": -0.1, "drift": -0.05}], noise=0.05)
    problem = problem_of(runs, 0.05, simulator_with_offsets("zero", "drift"))
    offsets = problem.offset_sizes(BASE, EXACT)
    for k, run in enumerate(runs):
        t_s = run.t_s - run.t_s[0]
        residual = run.columns["y"] - 1.0 - 2.0 * run.columns["x"]
        slope, zero = np.polyfit(t_s, residual, 1)
        np.testing.assert_allclose(offsets[k], [zero, slope], rtol=1e-3, atol=1e-4)


def test_a_prediction_near_by_takes_the_offsets_along():
    runs = smooth_runs([{"zero": 0.5, "gain": 0.05}, {"delay": 0.05}])
    problem = problem_of(runs, 0.01, simulator_with_offsets("zero", "gain", "delay"))
    _, around = problem.predict_around(BASE, EXACT)
    for near in (EXACT, EXACT + [1e-3, 0.0], EXACT + [0.0, -1e-3]):
        np.testing.assert_allclose(around(BASE, near), problem.predict(BASE, near), atol=2e-4)


def test_offsets_are_put_into_a_prediction_as_they_are_declared():
    runs = smooth_runs()
    problem = problem_of(runs, 0.01, simulator_with_offsets("zero", "gain", "drift", "delay"))
    assert problem.model.simulator.offsets == (
        ("y", "zero"),
        ("y", "gain"),
        ("y", "drift"),
        ("y", "delay"),
        ("y", "straight"),
    )
    np.testing.assert_allclose(problem.largest_offsets, [2.0, 0.3, 0.1, 0.2, 1.0])
    assert list(problem.are_relative) == [False, True, False, False, False]
    assert list(problem.model.are_bending) == [False, False, False, True, False]
    sizes = {k: np.array([0.4, 0.1, 0.03, 0.06, 0.0]) for k in range(2)}
    clean, out = problem.clean(BASE, EXACT, {}), problem.clean(BASE, EXACT, sizes)
    for k, block in enumerate(problem.blocks):
        t_s = runs[k].elapsed_s
        late = CubicSpline(t_s, clean[block.rows])(np.clip(t_s - 0.06, 0.0, None))
        np.testing.assert_allclose(out[block.rows], late * 1.1 + 0.4 + 0.03 * t_s, atol=1e-12)
    rows = problem.directions(BASE, EXACT, out, sizes)
    for k in range(2):
        zero, gain, drift, delay, _ = rows[k]
        late = (out[problem.blocks[k].rows] - 0.4 - 0.03 * runs[k].elapsed_s) / 1.1
        np.testing.assert_allclose(gain, late, atol=1e-9)
        np.testing.assert_allclose([zero, drift], [np.ones(80), runs[k].elapsed_s])
        np.testing.assert_allclose(delay[5:-1], -np.gradient(late, runs[k].elapsed_s)[5:-1], atol=2e-2)


def test_a_simulator_without_offsets_is_itself():
    problem = problem_of(smooth_runs())
    assert problem.model.simulator.offsets == () and len(problem.largest_offsets) == 0
    assert problem.bare.has_offsets is False
    assert (problem.model.smooth_order, problem.scored_channels) == (2, ["y"])
    assert problem.model.times_slower(problem.case) == pytest.approx(0.05 / 0.02)


def test_answers_are_kept_and_failures_counted():
    calls = []

    def counted(inputs, p):
        calls.append(dict(p))
        if p["slope"] > 5.0:
            raise ArithmeticError("too steep")
        return LINE.run(inputs, p)

    problem = problem_of(smooth_runs(), simulator=replace(LINE, run=counted))
    problem.predict(BASE, EXACT)
    problem.predict(BASE, EXACT)
    assert len(calls) == 2
    assert np.all(np.isnan(problem.predict(BASE, np.array([1.0, 6.0]))))
    assert problem.model.calls(problem.case).record()["evaluations"] == 1
    assert problem.model.calls(problem.case).record()["of"] == 2
    assert "too steep" in problem.model.calls(problem.case).record()["first"]
    assert Calls().record() is None
    for k in range(210):
        problem.predict(BASE, np.array([1.0, 1.0 + 0.001 * k]))
    assert len(problem.model.calls(problem.case).answers) == 200
    before = len(calls)
    problem.predict(BASE, np.array([1.0, 1.209]))
    assert len(calls) == before
    problem.predict(BASE, EXACT)
    assert len(calls) > before


# Terms.


def term(kind, signal="x", **more):
    parameters = {"coefficient": 0.5, "middle": 0.2, "half": 1.6, "per_s": 0.7, "tau_s": 0.3, "span": 4.0} | more
    return SimulatorTerm("y_mm", kind, signal, **parameters)


def test_what_a_term_follows_is_its_equation():
    x = np.sin(2.0 * T_s)
    z, columns = (x - 0.2) / 1.6, {"x": x}
    t_s = T_s - T_s[0]
    rate = np.gradient(z, T_s) / 0.7
    way = np.tanh(rate / 0.05)
    expected = {
        TIME: t_s,
        LEVEL: z,
        SQUARE: z**2,
        CUBE: z**3,
        RATE: rate,
        WAY: way,
        SIZED_WAY: z * way,
        SIZED_TIME: z * t_s,
    }
    for kind, values in expected.items():
        np.testing.assert_allclose(term(kind).values(T_s, columns), values, atol=1e-12)
    # τ·dy/dt = x − y, straight from sample to sample.
    memory = term(REMEMBERED).values(T_s, columns)
    y = 0.0
    for k in range(1, len(T_s)):
        steps = 400
        h = (T_s[k] - T_s[k - 1]) / steps
        for i in range(steps):
            at = z[k - 1] + (z[k] - z[k - 1]) * (i + 0.5) / steps
            y += h / 0.3 * (at - y)
        assert memory[k] == pytest.approx(y, abs=2e-4)


def test_a_term_says_what_it_is():
    assert term(TIME, "").formula == "y_mm += 0.5 mm/s · t"
    assert term(SIZED_TIME).unit == "mm/s"
    assert term(SQUARE).formula == "y_mm += 0.5 mm · x²"
    assert term(REMEMBERED).variable == "memory of x over 0.3 s"
    assert replace(term(LEVEL), place="angle").unit == ""
    assert replace(term(TIME, ""), place="angle").unit == "1/s"
    (size,) = term(SQUARE).effect.parameters
    assert (size.neutral, size.usual) == (0.0, pytest.approx(0.04))
    assert size.low == -size.high < -4.0


def test_terms_that_may_be_tried_are_scaled_by_what_was_recorded():
    runs = smooth_runs()
    fit = fitted(problem_of(runs))
    every = list(terms_of(LINE, fit))
    x = np.concatenate([r.columns["x"] for r in runs])
    of_x = [t for t in every if t.signal == "x"]
    rate = np.concatenate([np.abs(np.gradient(r.columns["x"], r.t_s)) for r in runs])
    half = 0.5 * np.ptp(x)
    for one in of_x:
        assert (one.middle, one.half) == pytest.approx((0.5 * (x.max() + x.min()), half))
        assert one.per_s == pytest.approx(np.median(rate) / half)
        assert one.span == pytest.approx(max(np.ptp(r.columns["y"]) for r in runs))
    assert {t.kind for t in of_x} == {LEVEL, SQUARE, CUBE, RATE, WAY, SIZED_WAY, SIZED_TIME, REMEMBERED}
    assert {t.signal for t in every} == {"", "x", "y"}
    longest_s = max(r.elapsed_s[-1] for r in runs)
    assert [t.tau_s for t in of_x if t.kind == REMEMBERED] == pytest.approx(
        [s * longest_s for s in (0.01, 0.03, 0.1, 0.3)]
    )
    still = [replace(r, columns={**r.columns, "x": np.ones(80)}) for r in runs]
    assert not [t for t in terms_of(LINE, fitted(problem_of(still))) if t.signal == "x"]


def test_a_simulator_with_terms_adds_them():
    added = replace(term(SQUARE), place="y")
    richer = with_terms(LINE, [added, replace(added, kind=LEVEL, coefficient=-0.2)])
    runs = smooth_runs()
    inputs, values = runs[0].columns, {"level": 1.0, "slope": 2.0} | LINE.neutral_values
    z = (inputs["x"] - 0.2) / 1.6
    np.testing.assert_allclose(richer(inputs, values)["y"], LINE(inputs, values)["y"] + 0.5 * z**2 - 0.2 * z)
    assert term_of(added.record(), "a file") == added
    for broken in ({**added.record(), "half": None}, {**added.record(), "half": np.nan}, {"place": "y"}, 3):
        with pytest.raises(InputError, match="a file"):
            term_of(broken, "a file")


def test_a_hypothesis_with_terms_predicts_them():
    runs = smooth_runs()
    problem, added = problem_of(runs), replace(term(SQUARE), place="y")
    hypothesis = BASE.adding(added.effect)
    out = problem.predict(hypothesis, np.array([1.0, 2.0, 0.7]))
    z = (np.concatenate([r.columns["x"] for r in runs]) - 0.2) / 1.6
    np.testing.assert_allclose(out, design(runs) @ EXACT + 0.7 * z**2)


# What is refused.


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"channels": ()}, "no channel"),
        ({"channels": ("y", "y")}, "two of the channels"),
        ({"base": ()}, "no base parameter"),
        ({"candidates": ()}, "no candidate"),
        ({"candidates": (BEND, BEND)}, "two of the candidates"),
        ({"base": (Parameter("a", "m", 2.0, 1.0, 1.5),)}, "the smaller first"),
        ({"base": (Parameter("a", "m", 1.0, 1.0, 1.0),)}, "the smaller first"),
        ({"base": (Parameter("a", "m", -np.inf, 1.0, 0.0),)}, "the smaller first"),
        ({"base": (Parameter("a", "m", 0.0, 1.0, 0.5, scale="log"),)}, "above 0"),
        ({"base": (Parameter("a", "m", 0.0, 1.0, 1.5),)}, "within"),
        ({"base": (Parameter("a", "m", 0.0, 1.0, -0.5),)}, "within"),
        ({"per_run": {"z": {"zero": 1.0}}}, "per_run has z"),
        ({"per_run": {"y": {"tilt": 1.0}}}, "tilt"),
        ({"per_run": {"y": {"zero": 0.0}}}, "zero of y is 0.0"),
        ({"per_run": {"y": {"zero": np.inf}}}, "zero of y is inf"),
    ],
)
def test_a_simulator_that_contradicts_itself_is_refused(wrong, message):
    with pytest.raises(InputError, match=message):
        replace(LINE, **wrong)


def test_bounds_themselves_are_allowed():
    replace(LINE, base=(Parameter("a", "m", 0.0, 1.0, 1.0), Parameter("b", "m", 0.1, 1.0, 0.1, scale="log")))


def test_names_and_neutral_values_are_those_of_every_parameter():
    two = candidate(
        "wear", "pad", Parameter("size", "", 0.0, 1.0, 0.1, neutral=0.0), Parameter("tau", "s", 1.0, 9.0, 3.0)
    )
    simulator = replace(LINE, candidates=(BEND, two))
    assert simulator.parameter_names == ["level", "slope", "bend.size", "wear.size", "wear.tau"]
    assert simulator.neutral_values == {"bend.size": 0.0, "wear.size": 0.0, "wear.tau": 3.0}
    values = simulator.parameter_values(Hypothesis((two,), of_all=LINE.base), np.array([1.0, 2.0, 0.3, 4.0]))
    assert values == {"level": 1.0, "slope": 2.0, "bend.size": 0.0, "wear.size": 0.3, "wear.tau": 4.0}


@pytest.mark.parametrize(
    ("gives", "message"),
    [
        ({"z": np.ones(80)}, "gives no y; it gives z"),
        ({}, "gives no y; it gives nothing"),
        (None, "it gives NoneType"),
        ({"y": "high"}, "no array of numbers"),
        ({"y": np.ones(79)}, "shape"),
        ({"y": np.where(np.arange(80) == 7, np.nan, 1.0)}, "nan at sample 7"),
    ],
)
def test_an_answer_that_is_no_channel_is_reported(gives, message):
    simulator = replace(LINE, run=lambda inputs, p: gives)
    with pytest.raises(InputError, match=message):
        simulator(smooth_runs()[0].columns, {"level": 1.0})


def test_recordings_must_have_what_the_simulator_needs():
    columns = dict(smooth_runs()[0].columns)
    with pytest.raises(InputError, match="x missing"):
        recorded(LINE, "1", {k: v for k, v in columns.items() if k != "x"})
    with pytest.raises(InputError, match="29 samples"):
        recorded(LINE, "1", {k: v[:29] for k, v in columns.items()})
    assert len(recorded(LINE, "1", {k: v[:30] for k, v in columns.items()})) == 30
    back = columns["t_s"].copy()
    back[40] = back[39]
    with pytest.raises(InputError, match="sample 40"):
        recorded(LINE, "1", columns | {"t_s": back})
    gap = columns["y"].copy()
    gap[3] = np.inf
    with pytest.raises(InputError, match="y"):
        recorded(LINE, "1", columns | {"y": gap})
    short = recorded(LINE, "1", columns | {"spare": np.ones(80)}, "swept")
    assert set(short.columns) == {"t_s", "x", "y"} and short.profile == "swept"


def test_a_planned_run_has_empty_channels():
    entry = planned(replace(LINE, experiments={"e": Experiment({"t_s": np.arange(40.0), "x": np.ones(40)}, 3.0)}), "e")
    assert np.all(entry.columns["y"] == 0.0) and np.all(entry.columns["x"] == 1.0)


def checked(run, simulator=LINE):
    check_calls(replace(simulator, run=run), smooth_runs())


def test_a_sound_simulator_is_called_and_accepted():
    checked(LINE.run)
    checked(lambda inputs, p: LINE.run(inputs, dict(p)))
    checked(lambda inputs, p: LINE.run(inputs, {**p}))


@pytest.mark.parametrize(
    "copied",
    [lambda p: dict(p), lambda p: {**p}, lambda p: p | {}, lambda p: dict(p.items()), lambda p: (lambda **q: q)(**p)],
    ids=["dict", "display", "union", "items", "keywords"],
)
def test_a_candidate_that_changes_nothing_is_refused_where_all_are_copied(copied):
    with pytest.raises(InputError, match=r"kink\.size"):
        checked(lambda i, p: LINE.run(i, {**copied(p), "kink.size": 0.0}))
    checked(lambda i, p: LINE.run(i, copied(p)))


def test_what_a_fit_could_not_use_is_refused():
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match="equal arguments"):
        checked(lambda i, p: {"y": LINE.run(i, p)["y"] + rng.normal(0.0, 1e-4, 80)})
    checked(lambda i, p: {"y": LINE.run(i, p)["y"] + rng.normal(0.0, 1e-9, 80)})
    with pytest.raises(InputError, match="rounds"):
        checked(lambda i, p: {"y": np.round(LINE.run(i, p)["y"], 2)})
    checked(lambda i, p: {"y": np.round(LINE.run(i, p)["y"], 9)})
    with pytest.raises(InputError, match=r"kink\.size is never read"):
        checked(
            lambda i, p: {
                "y": p["level"] + p["slope"] * i["x"] + p["bend.size"] * i["x"] ** 2 + p["ripple.size"] * i["x"]
            }
        )

    def writes(inputs, p):
        out = LINE.run(inputs, p)
        inputs["x"][0] += 1.0
        return out

    with pytest.raises(InputError, match="writes into x"):
        checked(writes)
    state = {"last": 0.0}

    def leaks(inputs, p):
        out = {"y": LINE.run(inputs, p)["y"] + state["last"]}
        state["last"] = p["bend.size"]
        return out

    with pytest.raises(InputError, match="other parameters"):
        checked(leaks)

    def turns(inputs, p):
        out = LINE.run(inputs, p)
        p["level"] = 9.0
        return out

    with pytest.raises(InputError, match="writes into level"):
        checked(turns)


def test_a_parameter_at_its_upper_bound_is_moved_down():
    at_top = replace(LINE, base=(replace(HEIGHT, high=1.0), LINE.base[1]))

    def walled(inputs, p):
        assert p["level"] <= 1.0
        return LINE.run(inputs, p)

    calls = []
    check_calls(replace(at_top, run=lambda i, p: calls.append(p["level"]) or walled(i, p)), smooth_runs())
    assert min(calls) < 1.0 == max(calls)
    calls.clear()
    check_calls(replace(LINE, run=lambda i, p: calls.append(p["level"]) or LINE.run(i, p)), smooth_runs())
    assert max(calls) > 1.0 == min(calls)


# Units, signs, dead channels.


def test_a_factor_is_a_unit_where_it_is_near_to_its_own():
    units = {"inch": 25.4, "m": 1000.0}
    same = CONFIG.same_factor
    for factor in (25.4, 25.4 * same * 0.999, 25.4 / same * 1.001):
        assert unit_of(factor, units, same) == "inch"
    for factor in (25.4 * same * 1.001, 25.4 / same * 0.999, 200.0, 0.0, -25.4):
        assert unit_of(factor, units, same) == ""
    assert unit_of(25.4 * same * 1.001, units, same, others=0.01) == "inch"
    one = apart("force", 3, 25.4, units, same)
    assert (one.what, one.channel, one.runs, one.factor) == ("unit_factor", "force", (3,), 25.4)
    assert one.evidence.values["ratio"] == pytest.approx(1.0 / 25.4)
    other = apart("force", 3, 7.0, units, same)
    assert (other.what, other.factor) == ("gain", 7.0)
    assert of_sign("force", (1,), Reason("data.sign")).factor == -1.0
    assert of_gain("force", (), 2.0, Reason("data.sign")).what == "gain"
    assert of_unit("stage", (2,), "inch", 25.4, Reason("data.sign")).factor == 25.4


def test_runs_are_numbered_by_their_names_or_their_places():
    runs = runs_of({})
    assert numbers(Case("A", tuple(replace(r, name=n) for r, n in zip(runs, ("7", "3"), strict=True)))) == [7, 3]
    assert numbers(Case("A", tuple(replace(r, name=n) for r, n in zip(runs, ("a", "3"), strict=True)))) == [1, 2]
    reason = Reason("data.repair.dead")
    whole = DataMistake("sign", "force", (), -1.0, reason, reason)
    assert whole.record()["runs"] == "all" and replace(whole, runs=(2,)).record()["runs"] == [2]


def case_of(*columns):
    return Case("A", tuple(recorded(LINE, str(k + 1), c) for k, c in enumerate(columns)))


def plain(count=60, step_s=0.05, **more):
    rng = np.random.default_rng(count)
    x = np.sin(np.arange(count) * 0.2) + 0.01 * rng.normal(size=count)
    return {"t_s": step_s * np.arange(count), "x": x, "y": 1.0 + 2.0 * x} | more


def test_another_unit_of_time_is_shown_by_its_steps():
    rows = (plain(), plain(61), plain(62, step_s=50.0))
    (one,) = recording_mistakes(LINE, case_of(*rows), CONFIG)
    assert (one.channel, one.runs, one.factor) == ("t_s", (3,), 1e-3)
    assert recording_mistakes(LINE, case_of(*rows[1:]), CONFIG) == ()
    assert recording_mistakes(LINE, case_of(plain(), plain(61), plain(62, step_s=0.4)), CONFIG) == ()
    assert (
        recording_mistakes(LINE, case_of(plain(), plain(61), plain(62, step_s=0.05 / 60.0)), CONFIG)[0].factor == 60.0
    )


def test_a_dead_channel_is_shown():
    (one,) = recording_mistakes(LINE, case_of(plain(), plain(61, y=np.ones(61))), CONFIG)
    assert (one.what, one.channel, one.runs) == ("constant", "y", (2,))
    (one,) = recording_mistakes(LINE, case_of(plain(y=np.ones(60)), plain(61, y=np.ones(61))), CONFIG)
    assert one.runs == ()


def test_a_channel_cut_off_is_asked_about():
    y = plain(400)["y"]
    top = np.minimum(y, np.quantile(y, 0.9))
    (one,) = cut_off(LINE, case_of(plain(400, y=top)), CONFIG)
    assert one.evidence.values["count"] == np.sum(top == top.max())
    assert one.evidence.values["level"] == top.max()
    (one,) = cut_off(LINE, case_of(plain(400, y=np.maximum(y, np.quantile(y, 0.1)))), CONFIG)
    assert cut_off(LINE, case_of(plain(400)), CONFIG) == ()
    # One sample is the largest of every run; in a short one it is no small share.
    assert cut_off(LINE, case_of(plain(60)), CONFIG) == ()
    # An encoder repeats its values everywhere.
    assert cut_off(LINE, case_of(plain(400, y=np.round(top, 1))), CONFIG) == ()


def three_runs(spoil, noise=0.02):
    rng = np.random.default_rng(2)
    rows = []
    for k in range(3):
        t_s = 0.05 * np.arange(90)
        x = np.sin((0.8 + 0.3 * k) * t_s) + 0.2 * k
        row = {"t_s": t_s, "x": x, "y": 1.0 + 2.0 * x + rng.normal(0.0, noise, 90)}
        rows.append(spoil(row) if k == 1 else row)
    return case_of(*rows)


@pytest.mark.parametrize(
    ("spoil", "what", "channel", "factor"),
    [
        (lambda c: c | {"y": c["y"] / 25.4}, "unit_factor", "y", 25.4),
        (lambda c: c | {"y": 4.0 * c["y"]}, "gain", "y", 0.25),
        (lambda c: c | {"y": -c["y"]}, "sign", "y", -1.0),
        (lambda c: c | {"x": c["x"] * 1000.0}, "unit_factor", "x", 1e-3),
    ],
)
def test_one_run_in_another_unit_or_sign_is_found(spoil, what, channel, factor):
    scaled = replace(LINE, candidates=(RIPPLE,), run=lambda i, p: LINE.run(i, p | {"bend.size": 0.0, "kink.size": 0.0}))
    case = Case("A", three_runs(spoil).runs)
    model = SimulatorModel(scaled)
    mistakes = against_others(model, model.base_fit(case))
    assert (mistakes.mistake.what, mistakes.mistake.channel, mistakes.mistake.runs) == (what, channel, (2,))
    assert mistakes.mistake.factor == pytest.approx(factor, rel=0.05)
    assert mistakes.is_claim
    assert against_others(model, model.base_fit(three_runs(lambda c: c))) is None


def test_a_claim_is_a_repair_that_nothing_else_reaches():
    one = of_sign("y", (1,), Reason("data.sign"))
    share = CONFIG.repaired
    for share_left, unrepaired, by_causes, is_enough, is_alone in (
        (share * 0.5, 0.5, 0.4, True, True),
        (share * 0.5 + 1e-9, 0.5, 0.4, False, True),
        (share * 0.5, 0.5, share * 0.5, True, False),
    ):
        test = MistakeTest(one, share_left, unrepaired, by_causes, CONFIG.repaired)
        assert (test.is_enough, test.is_alone, test.is_claim) == (is_enough, is_alone, is_enough and is_alone)


def test_factors_of_units_are_those_of_the_world():
    assert FACTORS["inch"] == 25.4 and FACTORS["kgf"] == 9.80665 and FACTORS["min"] == 60.0
    assert FACTORS["lbf"] == pytest.approx(0.45359237 * 9.80665, rel=1e-5)
    assert FACTORS["degree"] * FACTORS["rad"] == pytest.approx(1.0)
    assert FACTORS["degree"] == pytest.approx(np.deg2rad(1.0))
    for name, factor in FACTORS.items():
        size = name.replace(" x the unit", "").replace("the unit / ", "1/")
        if size[0].isdigit():
            assert factor == pytest.approx(float(size) if "/" not in size else 1.0 / float(size[2:]))


# Where fits begin.


MIXED = (
    Parameter("a", "", -2.0, 3.0, 0.5),
    Parameter("b", "s", 0.01, 100.0, 1.0, scale="log"),
    Parameter("c", "", -1e4, 1e4, 1.0),
    Parameter("d", "V", 0.5, 50.0, 5.0, neutral=np.inf, scale="inverse_square"),
    Parameter("e", "", 1.0, 1e4, 3.0),
)


def test_scattered_starts_lie_within_bounds_the_usual_first():
    starts = scattered(MIXED, 200)
    assert starts.shape == (200, 5)
    for k, p in enumerate(MIXED):
        low, high = sorted((to_fit(p, p.low), to_fit(p, p.high)))
        assert starts[0, k] == to_fit(p, p.usual)
        assert np.all((starts[:, k] >= low) & (starts[:, k] <= high))
    # Half near the usual value, half far: both signs where both are allowed, orders of magnitude away.
    assert 0.3 < np.mean(np.abs(starts[:, 0] - 0.5) < 0.5) < 0.9
    assert starts[:, 0].min() < -1.5 and starts[:, 0].max() > 2.5
    assert starts[:, 1].min() < -3.0 and starts[:, 1].max() > 3.0
    assert np.all(np.abs(starts[:, 1]) <= 4.2)
    assert starts[:, 2].min() < -10.0 and starts[:, 2].max() > 10.0 and np.abs(starts[:, 2]).max() < 32.0
    assert 0.25 < np.mean(np.abs(starts[:, 2] - 1.0) > 2.0) < 0.6 or np.abs(starts[:, 2]).min() < 0.1
    assert starts[:, 4].min() >= 1.0 and starts[:, 4].max() > 30.0
    np.testing.assert_array_equal(scattered(MIXED, 200), starts)


def test_the_likeliest_places_leave_least_and_failures_come_last():
    runs = runs_of({})

    def walled(inputs, p):
        return LINE.run(inputs, p) if p["level"] > -1.0 else {"y": np.full(len(inputs["x"]), np.nan)}

    problem = problem_of(runs, simulator=replace(LINE, run=walled))
    starts = [np.array(p) for p in ([-2.0, 2.0], [5.0, 2.0], [1.0, 2.0], [1.3, 2.0])]
    ranked = likeliest(problem, BASE, starts)
    assert [list(p) for p in ranked] == [[1.0, 2.0], [1.3, 2.0], [5.0, 2.0], [-2.0, 2.0]]


def test_a_fit_from_many_starts_finds_the_least_of_several_minima():
    def wave(inputs, p):
        return {"y": np.sin(p["pitch"] * inputs["x"]) + p["off.size"]}

    simulator = Simulator("wave", wave, ("x",), ("y",), (Parameter("pitch", "", 0.2, 20.0, 1.0, scale="log"),),
                          (candidate("off", "y", Parameter("size", "", -1.0, 1.0, 0.1, neutral=0.0)),))  # fmt: skip
    rng = np.random.default_rng(1)
    x = np.linspace(0.0, 4.0, 120)
    run = recorded(
        simulator, "1", {"t_s": 0.1 * np.arange(120), "x": x, "y": np.sin(5.0 * x) + rng.normal(0, 0.05, 120)}
    )
    problem = Problem(SimulatorModel(simulator), Case("W", (run,)), {"y": 0.05})
    hypothesis = Hypothesis(of_all=simulator.base)
    best_fit = best_start(problem, hypothesis)
    exact = minimize(lambda p: np.sum((run.columns["y"] - np.sin(p[0] * x)) ** 2), [5.0])
    assert np.exp(best_fit.coordinates[0]) == pytest.approx(exact.x[0], rel=1e-3)
    assert fit(problem, hypothesis, np.array([0.0])).chi2 > 2.0 * best_fit.chi2


def test_the_base_is_fitted_with_the_noise_of_its_own_residual():
    runs = runs_of({}, (600, 700), noise=0.3)
    fit = SimulatorModel(LINE).base_fit(Case("A", tuple(runs)))
    np.testing.assert_allclose(fit.coordinates, solved(design(runs), measured(runs)), atol=1e-4)
    assert fit.problem.sigma["y"] == pytest.approx(0.3, rel=0.1)
    rough = SimulatorModel(LINE).rough_problem(Case("A", tuple(runs)))
    assert rough.sigma["y"] == pytest.approx(0.02 * np.std(measured(runs)))
    with pytest.raises(InputError, match="fails at all"):
        SimulatorModel(replace(LINE, run=lambda i, p: 1 / 0)).base_fit(Case("A", tuple(runs)))


def test_halves_of_a_channel_are_those_above_its_median_and_rate():
    fit = fitted(problem_of(smooth_runs()))
    for block in fit.problem.blocks:
        is_high, is_quick = fit.problem.model.halves(fit, block)
        level = fit.predicted[block.rows]
        np.testing.assert_array_equal(is_high, level > np.median(level))
        rate = np.abs(np.gradient(level, fit.problem.case.runs[block.run].t_s))
        np.testing.assert_array_equal(is_quick, rate > np.median(rate))


def test_what_a_residual_may_follow_lies_within_1():
    fit = fitted(problem_of(smooth_runs()))
    groups = fit.problem.model.followed(fit, "y")
    # Level, way, rate, memory and time, of the input and of the channel.
    assert len(groups) == 10
    level_of_x = np.array(groups[0])
    np.testing.assert_allclose(level_of_x.sum(axis=0), 1.0, atol=1e-12)
    x = np.concatenate([r.columns["x"] for r in smooth_runs()])
    assert np.argmax(level_of_x[-1]) == np.argmax(x) and np.argmax(level_of_x[0]) == np.argmin(x)


# Coordinates of a fit.


@pytest.mark.parametrize("p", MIXED, ids=lambda p: p.name)
def test_coordinates_go_there_and_back(p):
    for value in (p.low, p.usual, p.high):
        assert from_fit(p, to_fit(p, value)) == pytest.approx(value)


def test_coordinates_of_scales_are_their_formulas():
    plain_, log, _, level, _ = MIXED
    assert (to_fit(plain_, 1.5), to_fit(log, np.e), to_fit(level, 2.0)) == pytest.approx((1.5, 1.0, 0.25))
    assert to_fit(level, np.inf) == 0.0 and from_fit(level, 0.0) == np.inf and from_fit(level, -1.0) == np.inf
    assert from_fit(level, 0.25) == pytest.approx(2.0)
    assert np.isfinite(from_fit(log, 1e9))
    assert (fit_scale(plain_), fit_scale(log), fit_scale(level)) == pytest.approx((0.5, 1.0, 1 / 25.0))
    assert fit_scale(Parameter("f", "", -3.0, 1.0, 0.0)) == pytest.approx(0.4)
    assert fit_scale(Parameter("f", "", -300.0, 100.0, 0.0)) == 1.0
    assert fit_scale(Parameter("f", "", -3.0, 1.0, -0.7)) == pytest.approx(0.7)
    effects = (candidate("one", "", replace(MIXED[0], neutral=0.0), MIXED[1]), candidate("two", "", MIXED[3]))
    with pytest.raises(InputError, match="neutral"):
        candidate("none", "", MIXED[1])
    np.testing.assert_allclose(start_coordinates(effects, [[0.5, np.e], [2.0]]), [0.5, 1.0, 0.25])


def test_units_grow_with_the_rig():
    scale = RigScale((("N", 2.0), ("mm", 3.0), ("ohm", 5.0), ("V", 7.0)))
    for unit, factor in (("N", 2), ("mm", 3), ("N/mm", 2 / 3), ("N/mm³", 2 / 27), ("1/N", 1 / 2), ("1/N²", 1 / 4),
                         ("ohm", 5), ("V/s", 7), ("s", 1), ("", 1), ("1/K", 1), ("mm²", 9), ("mm/N", 1.5)):  # fmt: skip
        assert scale.factor(unit) == pytest.approx(factor), unit
    sized = scale.sized(Parameter("k", "N/mm", 1.0, 3.0, 1.5, neutral=None))
    assert (sized.low, sized.high, sized.usual) == pytest.approx((2 / 3, 2.0, 1.0))
    assert RigScale().factor("N/mm") == 1.0


def test_sigma_is_what_was_drawn():
    assert SIGMA == 0.05
