"""Presence and completeness are two numbers: on a line with a rest of known size, and on a measured axis."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from softcal.core.gap.diagnosis import closest_set, genuine_probabilities
from softcal.core.gap.evidence import Consistency, bounds_reached, consistency_of, list_completeness, rest_energy
from softcal.core.gap.method import METHOD
from softcal.core.gap.residual import ExplainedFraction, noise_chance
from softcal.core.gap.search import Search
from softcal.core.gap.simulator import Experiment, Simulator, candidate, recorded
from softcal.core.gap.simulator_model import diagnose_simulator
from softcal.core.twin.effects import Parameter
from tests.core.linear_mechanism import (
    BEND,
    CAUSES,
    KINK,
    LINE,
    RIPPLE,
    SIGMA,
    design,
    fits_of,
    fitted,
    left_of,
    measured,
    problem_of,
    runs_of,
)

SIZE, WIDTH = Parameter("size", "", -50.0, 50.0, 0.2, neutral=0.0), 0.5


def with_rest(size, curvature=0.5, seed=5):
    """Recorded runs of a line that moves smoothly, bent or not, with a cube that no candidate has."""
    rng, runs = np.random.default_rng(seed), []
    for run, count in enumerate((160, 171, 148)):
        t_s = 0.05 * np.arange(count)
        x = 0.3 * run - 0.2 + (1.5 + 0.2 * run) * np.sin(t_s * (0.9 + 0.3 * run))
        y = 1.0 + 2.0 * x + curvature * x**2 + size * x**3 + rng.normal(0.0, SIGMA, count)
        runs.append(recorded(LINE, str(run + 1), {"t_s": t_s, "x": x, "y": y}))
    return runs


@pytest.fixture(scope="module")
def in_part():
    return diagnose_simulator(LINE, with_rest(0.08))


def test_a_cause_beside_a_rest_is_named_and_the_list_is_not_complete(in_part):
    assert in_part.verdict == "explained_in_part" and "bend" in in_part.best.ids
    (first, *others) = in_part.causes
    assert (first.effect, first.probability > 0.9) == ("bend", True)
    assert all(c.probability < 0.5 for c in others)
    assert first.parameters["size"].value == pytest.approx(0.5, rel=0.2)
    assert in_part.list_complete < 0.5


def test_every_section_is_of_one_set(in_part):
    report = in_part.report()
    named_causes = {c["effect"] for c in report["causes"] if c["shrink"] is not None}
    assert named_causes == set(report["partial"]["effects"]) == set(in_part.best.ids)
    off = LINE.neutral_values
    assert {n.partition(".")[0] for n, v in report["parameters"].items() if n in off and v != off[n]} == named_causes
    locations = report["where"][: len(named_causes) + 1]
    assert {location["stage"] for location in locations} == {f"part of {cause}" for cause in named_causes} | {"unknown"}
    assert sum(location["share"] for location in locations) == pytest.approx(1.0)
    assert locations[-1]["share"] == pytest.approx(1.0 - report["partial"]["share"])
    value = next(c for c in report["causes"] if c["effect"] == "bend")["parameters"]["size"]["value"]
    assert value == pytest.approx(report["parameters"]["bend.size"])


def test_a_rest_alone_names_nothing():
    diagnosis = diagnose_simulator(LINE, with_rest(0.15, curvature=0.0))
    assert diagnosis.verdict == "unknown" and diagnosis.list_complete < 0.05
    assert all(c.probability < 0.5 for c in diagnosis.causes)


def test_how_a_cause_stands_to_a_rest_is_that_of_its_algebra():
    """Of the bend's column only what the others leave counts; what each quarter of a run asks for is its own slope."""
    runs = with_rest(0.2)
    fit = fitted(problem_of(runs), BEND, RIPPLE)
    columns, y = design(runs, "bend", "ripple"), measured(runs)
    size = fit.effect_values[0][0]
    visible = left_of(np.delete(columns, 2, axis=1), columns[:, 2]) * size / SIGMA
    residual = left_of(columns, y) / SIGMA
    rest = residual @ residual - len(y)
    assert rest_energy(fit, 0.0) == pytest.approx(rest, rel=1e-3)
    assert rest_energy(fit, 0.5) == 0.0
    consistency, asked, start = consistency_of(fit, "bend", rest), 0.0, 0
    for run in runs:
        for part in np.array_split(np.arange(start, start + len(run)), 4):
            asked += (visible[part] @ residual[part]) ** 2 / (visible[part] @ visible[part])
        start += len(run)
    assert consistency.energy_share == pytest.approx(visible @ visible / (visible @ visible + rest), rel=1e-3)
    assert consistency.disagreement == pytest.approx(np.sqrt(asked / (visible @ visible)), rel=1e-2)
    visible_over_base = left_of(columns[:, :2], columns[:, 2]) * size / SIGMA
    assert consistency.cancelled == pytest.approx(
        1.0 - visible @ visible / (visible_over_base @ visible_over_base), abs=1e-3
    )
    assert not consistency.is_on_bound


def test_what_a_rest_has_of_the_shape_of_a_cause_is_that_of_its_algebra():
    """The bend at a size of its own for every level of x and y, and in time, beside what the fit takes."""
    runs = with_rest(0.2)
    fit = fitted(problem_of(runs), BEND)
    columns, y, x = design(runs, "bend"), measured(runs), np.concatenate([run.columns["x"] for run in runs])
    t_s = np.concatenate([run.elapsed_s for run in runs]) / max(run.elapsed_s[-1] for run in runs)
    states = [t_s, t_s**2]
    for signal in (x, columns @ np.linalg.lstsq(columns, y, rcond=None)[0]):
        scaled = 2.0 * (signal - signal.min()) / np.ptp(signal) - 1.0
        hats = [np.maximum(0.0, 1.0 - 2.5 * np.abs(scaled - level)) for level in (-1.0, -0.6, -0.2, 0.2, 0.6, 1.0)]
        states += [*hats, np.abs(scaled), scaled**2]
    residual = left_of(columns, y) / SIGMA
    rows = np.array([left_of(columns, state * x**2) for state in states])
    size = np.linalg.norm(rows, axis=1)
    axes, strength, _ = np.linalg.svd((rows / size[:, None]).T, full_matrices=False)
    axes = axes[:, strength**2 > 1e-6 * strength[0] ** 2]
    rest = residual @ residual - len(y)
    expected = (np.sum((axes.T @ residual) ** 2) - axes.shape[1]) / rest
    assert consistency_of(fit, "bend", 2.0 * rest).bent == pytest.approx(expected / 2.0, abs=2e-3)
    assert consistency_of(fit, "bend", rest).bent == 1.0
    assert consistency_of(fit, "bend", 0.0).bent == 0.0


def test_a_law_of_the_list_that_resembles_a_cause_is_its_kin():
    """The squared cosine of bend and kink, beyond level and slope."""
    runs = with_rest(0.2)
    fit = fitted(problem_of(runs), BEND)
    columns = design(runs, "bend", "kink", "ripple")
    bend, kink, ripple = (left_of(columns[:, :2], column) for column in columns.T[2:])
    expected = (bend @ kink) ** 2 / ((bend @ bend) * (kink @ kink))
    rows = [np.array(column) for column in (columns[:, 4], columns[:, 3], columns[:, 1])]
    assert consistency_of(fit, "bend", 1.0, rows).kin == pytest.approx(expected, abs=1e-6)
    assert (bend @ ripple) ** 2 / ((bend @ bend) * (ripple @ ripple)) < expected
    assert consistency_of(fit, "bend", 1.0).kin == 0.0


FOREIGN = METHOD.for_simulators.presence


def test_a_rest_of_its_own_shape_speaks_against_a_law_unless_its_kin_was_tried():
    chances = [Consistency(0.99, 0.03, bent=bent).genuine_chance(FOREIGN) for bent in (0.0, 0.5, 0.9, 1.0)]
    assert chances == sorted(chances, reverse=True) and chances[0] > 0.9 > 0.7 > chances[2]
    assert Consistency(0.99, 0.03, bent=1.0, kin=0.9).genuine_chance(FOREIGN) == chances[0]
    cancelled = [Consistency(0.99, 0.03, 0.8, bent=bent, kin=0.9).genuine_chance(FOREIGN) for bent in (0.0, 1.0)]
    assert cancelled[1] < 0.7 * cancelled[0]
    assert Consistency(0.99, 0.03, bent=1.0, kin=0.5).genuine_chance(FOREIGN) == chances[-1]
    assert Consistency(1.0, 0.001, is_on_bound=True).genuine_chance(FOREIGN) < 0.3
    assert Consistency(1.0, 0.001).genuine_chance(FOREIGN) > 0.95
    # The catalogue fits other forms of its laws.
    assert Consistency(1.0, 0.001, is_on_bound=True, bent=1.0).genuine_chance(METHOD.presence) == 1.0


@pytest.mark.parametrize("is_fitted_alone", [True, False])
def test_beside_a_law_on_its_bound_a_cause_counts_as_it_does_without_it(is_fitted_alone):
    """So far as the two cancel; a smaller set without a fit says nothing for it."""
    short = candidate("bend", "shape", Parameter("size", "", -50.0, 0.3, 0.2, neutral=0.0))
    fits = fits_of(problem_of(with_rest(0.0)), (short, KINK), (KINK,))
    search, both = Search(fits[()], CAUSES), fits["bend", "kink"]
    search.fits = {ids: fit for ids, fit in fits.items() if is_fitted_alone or ids != ("kink",)}

    def chance(fit, cause):
        others = [row for name, rows in search.laws.items() if name != cause for row in rows]
        how = consistency_of(fit, cause, rest_energy(fit, noise_chance(fit)), others)
        return how.genuine_chance(FOREIGN), how.cancelled

    (bend, _), (kink, cancelled), (alone, _) = chance(both, "bend"), chance(both, "kink"), chance(fits["kink",], "kink")
    alone *= is_fitted_alone
    expected = max(kink - (1.0 - bend) * cancelled * max(kink - alone, 0.0), (1.0 - bend) * alone)
    found = genuine_probabilities(search, ("bend", "kink"), {(): {}})
    assert bounds_reached(both) and bend < 0.2
    assert found["kink"] == pytest.approx(expected, rel=1e-9) and found["kink"] < kink or alone > kink


def rubbing(inputs, p):
    v = inputs["v_m_s"]
    way = np.tanh(v / 0.01)
    out = p["mass"] * inputs["a_m_s2"] + p["viscous"] * v + p["dry_friction.size"] * way
    out = out + p["drag.size"] * v * np.abs(v) + p["spring.size"] * inputs["q_m"]
    return {"F_N": out + p["stribeck.size"] * way * np.exp(-((v / p["stribeck.speed"]) ** 2))}


RUBBING = Simulator(
    "slide",
    rubbing,
    ("q_m", "v_m_s", "a_m_s2"),
    ("F_N",),
    (Parameter("mass", "kg", 0.0, 50.0, 1.0), Parameter("viscous", "N·s/m", -50.0, 50.0, 1.0)),
    tuple(
        candidate(name, "guide", Parameter("size", "N", -30.0, 30.0, 1.0, neutral=0.0), *more)
        for name, more in {
            "dry_friction": (),
            "drag": (),
            "spring": (),
            "stribeck": (Parameter("speed", "m/s", 0.15, 0.6, 0.3, scale="log"),),
        }.items()
    ),
)


def rubbed(simulator, **sizes):
    """Recorded runs of three speeds; noise of a fiftieth."""
    rng, runs, off = np.random.default_rng(3), [], RUBBING.neutral_values | {"stribeck.speed": 0.3}
    for run, fastest in enumerate((1.0, 3.0, 0.5)):
        t_s, turns = np.arange(0.0, 20.0, 0.04), np.array([0.3, 0.55, 0.8, 1.0]) * fastest
        phases, sizes_m = rng.uniform(0.0, 6.0, 4), 0.3 / np.array([0.3, 0.55, 0.8, 1.0])
        angle = turns[:, None] * t_s + phases[:, None]
        columns = {
            "t_s": t_s,
            "q_m": 0.4 * sizes_m @ np.sin(angle),
            "v_m_s": 0.4 * (sizes_m * turns) @ np.cos(angle),
            "a_m_s2": -0.4 * (sizes_m * turns**2) @ np.sin(angle),
        }
        values = {"mass": 1.3, "viscous": 0.8} | off | {f"{name}.size": size for name, size in sizes.items()}
        force_N = rubbing(columns, values)["F_N"] + rng.normal(0.0, 0.02, len(t_s))
        runs.append(recorded(simulator, str(run + 1), columns | {"F_N": force_N}))
    return runs


def without(name):
    return replace(
        RUBBING,
        run=lambda i, p: rubbing(i, RUBBING.neutral_values | {"stribeck.speed": 0.3} | dict(p)),
        candidates=tuple(c for c in RUBBING.candidates if c.id != name),
    )


@pytest.mark.parametrize(("hidden", "twin"), [("stribeck", "dry_friction"), ("dry_friction", "stribeck")])
def test_a_law_that_is_not_in_the_list_is_not_named_by_the_one_that_resembles_it(hidden, twin):
    """Friction that falls with speed, or does not: alone each takes 95 % of the other's gap and more."""
    listed = without(hidden)
    chances = {c.effect: c.probability for c in diagnose_simulator(listed, rubbed(listed, **{hidden: 1.0})).causes}
    assert max(chances.values()) < 0.9
    chances = {c.effect: c.probability for c in diagnose_simulator(RUBBING, rubbed(RUBBING, **{hidden: 1.0})).causes}
    assert chances[hidden] > 0.9 > 0.5 > chances[twin]


def test_more_of_the_gap_and_less_disagreement_make_a_cause_likelier():
    chances = [
        Consistency(explained, 0.15).genuine_chance(METHOD.presence)
        for explained in (0.0, 0.5, 0.8, 0.9, 0.95, 0.99, 1.0)
    ]
    assert chances == sorted(chances) and chances[0] == 0.0 and chances[-1] == 1.0
    chances = [Consistency(0.9, apart).genuine_chance(METHOD.presence) for apart in (0.5, 0.2, 0.1, 0.01)]
    assert chances == sorted(chances)
    assert (
        Consistency(0.75, 0.4).genuine_chance(METHOD.presence)
        < 0.05
        < 0.9
        < Consistency(0.97, 0.1).genuine_chance(METHOD.presence)
    )


def stepping(inputs, p):
    x = inputs["x"]
    out = p["level"] + p["slope"] * x + p["step.size"] * np.tanh(x / p["step.width"])
    return {"y": out + p["bump.size"] * np.exp(-((x / 0.4) ** 2))}


STEP = Simulator(
    "step",
    stepping,
    ("x",),
    ("y",),
    LINE.base,
    (
        candidate("step", "sensor", SIZE, Parameter("width", "", WIDTH / 2.0, 2.0 * WIDTH, WIDTH, scale="log")),
        candidate("bump", "sensor", SIZE),
    ),
)


def test_a_law_that_ends_on_its_bound_beside_a_rest_is_not_named():
    """A sharp edge takes the step to the least of its widths, where it takes 95 % of the gap and more."""
    runs = []
    for run, bare in enumerate(with_rest(0.0, curvature=0.0)):
        x = bare.columns["x"]
        y = bare.columns["y"] + 0.8 * np.sign(x)
        runs.append(recorded(STEP, str(run + 1), {"t_s": bare.columns["t_s"], "x": x, "y": y}))
    diagnosis = diagnose_simulator(STEP, runs)
    assert all(cause.probability < 0.5 for cause in diagnosis.causes)
    assert diagnosis.list_complete < 0.5 and diagnosis.verdict == "unknown"
    # What the law can reach is named.
    runs = [
        replace(
            run,
            columns={
                **run.columns,
                "y": run.columns["y"] + 0.8 * (np.tanh(run.columns["x"] / 0.5) - np.sign(run.columns["x"])),
            },
        )
        for run in runs
    ]
    diagnosis = diagnose_simulator(STEP, runs)
    assert (
        diagnosis.verdict == "explained"
        and diagnosis.causes[0].effect == "step"
        and diagnosis.causes[0].probability > 0.9
    )


def test_noise_leaves_a_list_complete_and_a_departure_outside_does_not():
    assert list_completeness(0.4, 0.5, False, METHOD.presence) > 0.8
    assert list_completeness(1e-9, 0.3, False, METHOD.presence) < 0.05
    assert list_completeness(0.4, 0.0, True, METHOD.presence) < 0.1
    rests = [list_completeness(1e-12, share, False, METHOD.presence) for share in (0.001, 0.01, 0.05, 0.2, 1.0)]
    assert rests == sorted(rests, reverse=True)


def test_a_forecast_that_its_own_samples_contradict_is_left_out():
    assert ExplainedFraction.checked((0.0, 0.0, 0.02), 0.83, METHOD.explained_fraction) == ExplainedFraction(
        None, None, None, 0.83
    )
    assert ExplainedFraction.checked((0.9, 0.8, 0.95), 0.83, METHOD.explained_fraction).predicted == 0.9


@pytest.mark.parametrize(("low", "high", "reached"), [(-50.0, 0.1, 0.1), (0.9, 50.0, 0.9), (-50.0, 50.0, None)])
def test_a_cause_on_its_bound_is_reported(low, high, reached):
    cause = candidate("bend", "shape", Parameter("size", "", low, high, 0.2, neutral=0.0))
    bounds_hit = bounds_reached(fitted(problem_of(with_rest(0.0)), cause))
    assert bounds_hit == ({} if reached is None else {"bend.size": pytest.approx(reached)})


def test_a_bound_that_switches_a_cause_off_is_none():
    cause = candidate("bend", "shape", Parameter("size", "", 0.0, 50.0, 0.2, neutral=0.0))
    assert bounds_reached(fitted(problem_of(with_rest(0.0, curvature=-0.5)), cause)) == {}


def force(inputs, p):
    v = inputs["v_m_s"]
    out = p["mass"] * inputs["a_m_s2"] + p["viscous"] * v + p["dry_friction.size"] * np.sign(v) + p["offset.size"]
    out = out + p["drag.size"] * v * np.abs(v) + p["spring.size"] * inputs["q_m"]
    return {"F_N": out + p["stribeck.size"] * np.sign(v) * np.exp(-np.abs(v) / p["stribeck.speed"])}


def sized(name, usual, limit, *more):
    return candidate(name, "axis", Parameter("size", "N", -limit, limit, usual, neutral=0.0), *more)


AXIS = Simulator(
    "axis",
    force,
    ("q_m", "v_m_s", "a_m_s2"),
    ("F_N",),
    (Parameter("mass", "kg", 0.0, 1e3, 80.0), Parameter("viscous", "N·s/m", 0.0, 5e3, 200.0)),
    (
        sized("dry_friction", 10.0, 500.0),
        sized("offset", 2.0, 100.0),
        sized("drag", 50.0, 1e4),
        sized("stribeck", 5.0, 100.0, Parameter("speed", "m/s", 1e-3, 0.1, 0.01, scale="log")),
        sized("spring", 10.0, 1e3),
    ),
)


def test_the_friction_of_a_measured_axis_is_named_in_its_published_size(measured_data):
    """Published by Janot, Gautier and Brunot (2019): dry friction 20.4 N, offset −3.2 N, mass 95 kg."""
    runs = []
    for number in "123":
        table = np.genfromtxt(
            measured_data / "rigs" / "axis" / "runs" / number / "recording.csv", delimiter=",", names=True
        )
        runs.append(recorded(AXIS, number, {name: table[name] for name in table.dtype.names or ()}))
    report = diagnose_simulator(AXIS, runs).report()
    first = report["causes"][0]
    assert (first["effect"], report["verdict"]) == ("dry_friction", "explained_in_part")
    assert first["probability"] > 0.9 > 0.5 > report["list_complete"]
    assert first["parameters"]["size"]["value"] == pytest.approx(20.4, rel=0.03)
    assert report["parameters"]["offset.size"] == pytest.approx(-3.2, rel=0.1)
    assert report["parameters"]["mass"] == pytest.approx(95.0, rel=0.01)
    assert first["alone"] > 0.5


def test_of_an_unknown_gap_the_set_that_is_handed_on_may_have_a_cause_more_than_were_tried():
    """Least squares on a run held back takes all three laws, of which a search has tried two at a time."""
    problem = problem_of(runs_of({"bend.size": 0.9, "ripple.size": 0.8, "kink.size": 0.7}))
    search = Search(fitted(problem), CAUSES)
    search.fits = fits_of(problem, *((cause,) for cause in CAUSES), *combinations(CAUSES, 2))
    assert closest_set(search).ids == ("bend", "kink", "ripple")
    without = problem_of(runs_of({"bend.size": 0.9}))
    search = Search(fitted(without), CAUSES)
    search.fits = fits_of(without, *((cause,) for cause in CAUSES), *combinations(CAUSES, 2))
    assert closest_set(search).ids == ("bend",)


def experiments(count=120):
    t_s = 0.05 * np.arange(count)
    return {
        "short stroke": Experiment({"t_s": t_s, "x": 0.3 * np.sin(t_s)}),
        "long stroke": Experiment({"t_s": t_s, "x": 4.0 * np.sin(t_s)}),
    }


@pytest.mark.parametrize("curvature", [0.0, 0.5])
def test_the_run_that_separates_a_rest_from_every_cause_is_proposed(curvature):
    """The rest is a cube: far out it stands apart from square, wave and kink, close to 0 it does not."""
    both = experiments()
    diagnosis = diagnose_simulator(replace(LINE, experiments=both), with_rest(0.15, curvature=curvature))
    assert diagnosis.verdict in ("unknown", "explained_in_part") and diagnosis.residual is not None
    proposed = diagnosis.next_experiment
    assert proposed.profile == "long stroke" and proposed.separation_sigma > 10.0
    turned = {name: both[name] for name in reversed(both)}
    assert (
        diagnose_simulator(replace(LINE, experiments=turned), with_rest(0.15, curvature=curvature)).next_experiment
        == proposed
    )
