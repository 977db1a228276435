"""What is stated of a mechanism before any run: priors, the noise of a sensor, a start that is not compared."""

from dataclasses import replace

import numpy as np
import pytest

from softcal.core.errors import InputError
from softcal.core.gap.case import Case
from softcal.core.gap.fit import fit
from softcal.core.gap.hypothesis import Hypothesis
from softcal.core.gap.model import Problem
from softcal.core.gap.residual import noise_levels
from softcal.core.gap.simulator import Simulator, candidate, recorded
from softcal.core.gap.simulator_model import SimulatorModel, check_simulator, diagnose_simulator
from softcal.core.gap.simulator_reach import SimulatorTerm, with_terms
from softcal.core.twin.effects import Parameter

SIGMA = 0.05


def weigh(inputs, p):
    """The force that moves a cart: a payload adds to its mass, the rail brakes it."""
    a = inputs["a_m_s2"]
    return {"F_N": (p["mass"] + p["payload.mass"]) * a + p["rail.brake"] * np.sign(inputs["v_m_s"])}


CART = Simulator(
    "cart",
    weigh,
    ("a_m_s2", "v_m_s"),
    ("F_N",),
    base=(Parameter("mass", "kg", 0.1, 10.0, 2.0),),
    candidates=(
        candidate("payload", "cart", Parameter("mass", "kg", -5.0, 5.0, 0.2, neutral=0.0)),
        candidate("rail", "rail", Parameter("brake", "N", -5.0, 5.0, 0.2, neutral=0.0)),
    ),
)
WEIGHED = replace(CART, priors={"mass": (1.5, 0.01)})


def rides(truth, simulator=CART, counts=(80, 90), noise=SIGMA):
    rng, out = np.random.default_rng(4), []
    for k, count in enumerate(counts):
        t_s = 0.05 * np.arange(count)
        inputs = {"t_s": t_s, "a_m_s2": np.cos((1.0 + k) * t_s), "v_m_s": np.sin((1.0 + k) * t_s + 0.3)}
        clean = weigh(inputs, {"mass": 1.5, "payload.mass": 0.0, "rail.brake": 0.0} | truth)["F_N"]
        out.append(recorded(simulator, str(k + 1), inputs | {"F_N": clean + rng.normal(0.0, noise, count)}))
    return out


def test_a_mass_that_stood_on_a_scale_leaves_the_rest_to_the_payload():
    runs = rides({"payload.mass": 0.4})
    assert diagnose_simulator(CART, runs).verdict == "no_gap"
    diagnosis = diagnose_simulator(WEIGHED, runs)
    assert (diagnosis.verdict, diagnosis.best.ids) == ("explained", ("payload",))
    parameters = diagnosis.report()["parameters"]
    assert parameters["mass"] == pytest.approx(1.5, abs=0.02)
    assert parameters["payload.mass"] == pytest.approx(0.4, abs=0.03)
    assert diagnosis.report()["priors"] == {"mass": {"mean": 1.5, "sd": 0.01, "fitted": parameters["mass"]}}
    (untold,) = (one for one in check_simulator(CART, runs)[1].unidentifiable)
    assert untold.name == "payload" and not check_simulator(WEIGHED, runs)[1].unidentifiable


def test_a_prior_and_runs_add_as_in_bayes_formula():
    """y = m·a with white noise and m ~ N(1.4, 0.05²): mean and variance of the posterior in closed form."""
    runs = rides({})
    problem = Problem(
        SimulatorModel(replace(CART, priors={"mass": (1.4, 0.05)})), Case("C1", tuple(runs)), {"F_N": SIGMA}
    )
    near = fit(problem, Hypothesis(of_all=CART.base), np.array([1.0]))
    result = fit(problem, near.hypothesis, near.coordinates + 1e-3)
    a, y = (np.concatenate([run.columns[name] for run in runs]) for name in ("a_m_s2", "F_N"))
    precision = a @ a / SIGMA**2 + 1.0 / 0.05**2
    mean = (a @ y / SIGMA**2 + 1.4 / 0.05**2) / precision
    assert result.coordinates[0] == pytest.approx(mean, rel=1e-6)
    assert result.covariance[0, 0] == pytest.approx(1.0 / precision, rel=1e-6)
    chi2 = np.sum((y - mean * a) ** 2) / SIGMA**2 + ((mean - 1.4) / 0.05) ** 2
    assert result.chi2 == pytest.approx(chi2, rel=1e-6)
    assert result.under(problem.with_noise({"F_N": 2.0 * SIGMA})).chi2 == pytest.approx(
        np.sum((y - mean * a) ** 2) / (4.0 * SIGMA**2) + ((mean - 1.4) / 0.05) ** 2, rel=1e-6
    )
    # A run that is only planned does not weigh the mass again.
    assert problem.of_run(runs[0]).priors == () and len(problem.priors) == 1


def test_the_prior_of_a_value_on_a_logarithmic_scale_is_relative():
    scaled = replace(CART, base=(Parameter("mass", "kg", 0.1, 10.0, 2.0, scale="log"),), priors={"mass": (1.6, 0.08)})
    (prior,) = SimulatorModel(scaled).priors
    assert (prior.index, prior.mean, prior.sd) == (0, pytest.approx(np.log(1.6)), pytest.approx(0.05))


def test_what_is_known_of_a_start_holds_in_every_run():
    def fall(inputs, p):
        return {"h": p["start"] - p["rate"] * inputs["t_s"] + p["haze.size"] * np.sin(inputs["t_s"])}

    lamp = Simulator(
        "fall",
        fall,
        (),
        ("h",),
        (Parameter("rate", "", 0.0, 9.0, 1.0),),
        (candidate("haze", "air", Parameter("size", "", -1.0, 1.0, 0.1, neutral=0.0)),),
        run_parameters=(Parameter("start", "", 0.0, 20.0, 4.0),),
        priors={"start": (5.0, 0.1), "start@2": (6.0, 0.2)},
    ).of_runs(["1", "2"])
    assert [p.usual for p in lamp.base] == [1.0, 5.0, 6.0]
    assert [(one.index, one.mean, one.sd) for one in SimulatorModel(lamp).priors] == [(1, 5.0, 0.1), (2, 6.0, 0.2)]


def test_noise_that_is_stated_is_not_read_off_what_is_left():
    runs = rides({"rail.brake": 0.6})
    with_noise = replace(CART, noise={"F_N": SIGMA})
    base = SimulatorModel(with_noise).base_fit(Case("C1", tuple(runs)))
    assert base.problem.sigma == {"F_N": SIGMA} and noise_levels(base) == {"F_N": SIGMA}
    diagnosis = diagnose_simulator(with_noise, runs)
    assert (diagnosis.verdict, diagnosis.best.ids) == ("explained", ("rail",))
    assert diagnosis.gap["F_N"].noise_floor == SIGMA
    assert diagnosis.mistakes == ()


def test_a_noise_that_is_stated_far_too_small_is_a_question():
    diagnosis = diagnose_simulator(replace(CART, noise={"F_N": SIGMA / 4.0}), rides({}))
    (question,) = diagnosis.mistakes
    assert (question.what, question.channel) == ("noise", "F_N")
    assert "0.0125" in str(question.evidence) and "F_N" in str(question.repair)


def start_up(inputs, p):
    """A pump whose hose fills first: it gives half for a second."""
    return {"flow": p["gain"] * inputs["drive"] + p["bend.size"] * inputs["drive"] ** 2}


PUMP = Simulator(
    "pump",
    start_up,
    ("drive",),
    ("flow",),
    (Parameter("gain", "", 0.0, 10.0, 1.0),),
    (candidate("bend", "pump", Parameter("size", "", -5.0, 5.0, 0.2, neutral=0.0)),),
)


def pumped(simulator, curvature=0.0, first_s=1.0):
    rng, out = np.random.default_rng(8), []
    for k in range(2):
        t_s = 3.0 + 0.02 * np.arange(200)
        drive = 1.0 + np.sin((2.0 + k) * t_s)
        flow = 2.0 * drive + curvature * drive**2
        flow = np.where(t_s - t_s[0] < first_s, 0.5 * flow, flow) + rng.normal(0.0, 0.01, len(t_s))
        out.append(recorded(simulator, str(k + 1), {"t_s": t_s, "drive": drive, "flow": flow}))
    return out


def test_a_start_that_is_skipped_is_simulated_and_not_compared():
    assert diagnose_simulator(PUMP, pumped(PUMP)).verdict == "unknown"
    skipping = replace(PUMP, skip_s=1.0)
    runs = pumped(skipping)
    assert [len(run) for run in runs] == [150, 150] and runs[0].t_s[0] == pytest.approx(4.0)
    diagnosis = diagnose_simulator(skipping, runs)
    assert (diagnosis.verdict, diagnosis.best.ids) == ("no_gap", ())
    lengths = []

    def spying(inputs, p):
        lengths.append(len(inputs["t_s"]))
        return start_up(inputs, p)

    bent = diagnose_simulator(replace(skipping, run=spying), pumped(skipping, curvature=0.3))
    assert (bent.verdict, bent.best.ids) == ("explained", ("bend",)) and set(lengths) == {200}


def test_a_run_with_a_start_that_is_skipped_is_held_against_the_others_as_a_whole():
    def remembers(inputs, p):
        # What came before the first sample that is compared still acts.
        return {"flow": 5.0 + p["gain"] * np.cumsum(inputs["drive"]) * 0.02 + p["bend.size"] * inputs["drive"] ** 2}

    simulator = replace(PUMP, run=remembers, skip_s=1.0)
    rng, runs = np.random.default_rng(2), []
    for k in range(4):
        t_s = 0.02 * np.arange(200)
        drive = 1.0 + np.sin((2.0 + k) * t_s)
        flow = 5.0 + 2.0 * np.cumsum(drive) * 0.02 + rng.normal(0.0, 0.01, len(t_s))
        columns = {"t_s": t_s, "drive": drive / (25.4 if k == 2 else 1.0), "flow": flow}
        runs.append(recorded(simulator, str(k + 1), columns))
    diagnosis = diagnose_simulator(simulator, runs)
    (mistake,) = diagnosis.mistakes
    assert (diagnosis.verdict, mistake.channel, mistake.runs, mistake.factor) == ("data", "drive", (3,), 25.4)


def test_terms_stand_where_the_run_is_compared():
    term = SimulatorTerm("flow", "t", "", 0.5, 0.0, 1.0, 1.0, 0.0, 4.0)
    described = with_terms(replace(PUMP, skip_s=1.0), [term])
    t_s = 3.0 + 0.5 * np.arange(5)
    flow = described({"t_s": t_s, "drive": np.ones(5)}, {"gain": 2.0, "bend.size": 0.0})["flow"]
    assert flow.tolist() == [2.0, 2.0, 2.0, 2.25, 2.5]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"priors": {"mas": (1.0, 0.1)}}, "priors has mas; one of mass"),
        ({"priors": {"mass": (1.0, 0.0)}}, "a deviation above 0"),
        ({"priors": {"mass": (11.0, 0.1)}}, "within 0.1 and 10"),
        ({"noise": {"F": 0.1}}, "one of F_N"),
        ({"noise": {"F_N": 0.0}}, "above 0"),
        ({"skip_s": -1.0}, "seconds from 0"),
    ],
)
def test_what_is_stated_wrongly_is_refused_in_one_line(wrong, message):
    with pytest.raises(InputError, match=message):
        replace(CART, **wrong)


def test_a_run_that_is_skipped_nearly_whole_is_refused():
    with pytest.raises(InputError, match="20 samples after skip_s = 3 s"):
        rides({}, replace(CART, skip_s=3.0), counts=(80,))


def test_several_calls_are_asked_at_once_and_give_the_same_diagnosis():
    batch_sizes, alone_asked = [], []

    def many(calls):
        batch_sizes.append(len(calls))
        return [weigh(inputs, parameters) for inputs, parameters in calls]

    def one(inputs, p):
        alone_asked.append(1)
        return weigh(inputs, p)

    runs = rides({"rail.brake": 0.6})
    alone, at_once = diagnose_simulator(CART, runs), diagnose_simulator(replace(CART, run=one, run_many=many), runs)
    reports = [diagnosis.report() for diagnosis in (at_once, alone)]
    # What is asked for in one go may not all be needed.
    assert reports[0].pop("calls") >= reports[1].pop("calls") >= 2 * 60
    assert reports[0] == reports[1]
    assert max(batch_sizes) >= 2 * 30 and sum(batch_sizes) > sum(alone_asked)


def test_a_call_that_fails_among_several_is_counted_and_avoided():
    def narrow(inputs, p):
        if p["rail.brake"] > 3.0:
            raise ValueError("the rail locks")
        return weigh(inputs, p)

    def many(calls):
        out = []
        for inputs, parameters in calls:
            try:
                out.append(narrow(inputs, parameters))
            except ValueError as error:
                out.append(error)
        return out

    runs = rides({"rail.brake": 0.6})
    reports = [diagnose_simulator(replace(CART, run=narrow, run_many=one), runs).report() for one in (None, many)]
    assert reports[0]["parameters"] == reports[1]["parameters"]
