"""What runs tell before any cause is tried, and which run would tell the rest."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from softcal.core.gap.simulator import Columns, Experiment, Simulator, SimulatorRun, candidate, recorded
from softcal.core.gap.simulator_model import check_simulator, diagnose_simulator
from softcal.core.twin.effects import Parameter

T = np.arange(300) * 0.02


def size(name: str, usual: float) -> Parameter:
    return Parameter(name, "", -9.0, 9.0, usual, neutral=0.0)


def beam(i: Columns, p: Mapping[str, float]) -> Columns:
    load = i["load_N"]
    deflection_mm = p["length"] * p["softness"] * load + p["heat.rate"] * i["warm_K"]
    return {
        "place_mm": deflection_mm
        + p["stiffens.a"] * load**3
        - p["slips.a"] * np.maximum(load - 4.0, 0.0)
        + p["wear.a"] * T
    }


SIMULATOR = Simulator(
    "a beam",
    beam,
    ("load_N", "warm_K"),
    ("place_mm",),
    (Parameter("length", "", 0.1, 9.0, 1.0), Parameter("softness", "", 0.1, 9.0, 1.0)),
    (
        candidate("heat", "beam", size("rate", 0.1)),
        candidate("stiffens", "beam", size("a", 0.001)),
        candidate("slips", "clamp", size("a", 0.1)),
        candidate("wear", "clamp", size("a", 0.01)),
    ),
    {
        "heavy": Experiment({"t_s": T, "load_N": 6.0 * np.sin(T) ** 2, "warm_K": 0.0 * T}, minutes=3.0),
        "oven": Experiment({"t_s": T, "load_N": 0.0 * T, "warm_K": 2.0 * np.sin(T)}, minutes=1.0),
    },
)


def run(name: str, inputs: Columns, **hidden: float) -> SimulatorRun:
    truth = {"length": 1.0, "softness": 0.7} | {f"{c.id}.{c.parameters[0].name}": 0.0 for c in SIMULATOR.candidates}
    place_mm = beam(inputs, truth | hidden)["place_mm"] + np.random.default_rng(len(name)).normal(0.0, 0.01, len(T))
    return recorded(SIMULATOR, name, {**inputs, "place_mm": place_mm})


LIGHT = {"t_s": T, "load_N": np.sin(2.0 * T) ** 2, "warm_K": 0.0 * T}


def test_what_no_run_moves_is_not_identifiable_and_the_quickest_run_that_would_is_named() -> None:
    mistakes, identifiability = check_simulator(SIMULATOR, [run("light", LIGHT)])
    assert not mistakes and identifiability is not None
    assert identifiability["heat"].sigma == 0.0 and identifiability["heat"].by == ("oven",)
    assert identifiability["slips"].sigma == 0.0 and identifiability["slips"].by == ("heavy",)
    # By hand: a drift of 0.01 per s under noise of 0.01, less what the load can imitate of it.
    load = LIGHT["load_N"]
    by_hand = np.linalg.norm(T - load * (T @ load) / (load @ load))
    assert identifiability["wear"].is_identifiable and identifiability["wear"].sigma == pytest.approx(by_hand, rel=0.1)


def test_two_parameters_that_act_as_a_product_are_not_identifiable_apart() -> None:
    _, identifiability = check_simulator(SIMULATOR, [run("light", LIGHT)])
    assert identifiability is not None
    assert (
        identifiability["length"].beside == ("softness",)
        and not identifiability["length"].is_identifiable
        and identifiability["length"].by == ()
    )


@pytest.mark.parametrize("name", SIMULATOR.experiments)
def test_once_that_run_is_made_the_cause_is_identifiable(name: str) -> None:
    _, before = check_simulator(SIMULATOR, [run("light", LIGHT)])
    _, after = check_simulator(SIMULATOR, [run("light", LIGHT), run(name, SIMULATOR.experiments[name].inputs)])
    assert before is not None and after is not None
    promised_names = {one.name for one in before.unidentifiable if name in one.by}
    assert promised_names and all(after[one].is_identifiable for one in promised_names)


def test_causes_that_move_a_channel_alike_are_reported() -> None:
    twice = candidate("stiffens_too", "rod", size("a", 0.01))

    def both(i: Columns, p: Mapping[str, float]) -> Columns:
        return beam(i, {**p, "stiffens.a": p["stiffens.a"] + 0.5 * p["stiffens_too.a"]})

    simulator = replace(SIMULATOR, run=both, candidates=(*SIMULATOR.candidates, twice))
    inputs = SIMULATOR.experiments["heavy"].inputs
    _, identifiability = check_simulator(simulator, [recorded(simulator, "1", run("heavy", inputs).columns)])
    assert identifiability is not None and identifiability.alike == (("stiffens", "stiffens_too"),)


def test_it_is_reported_before_the_search_and_stands_in_the_report() -> None:
    messages: list[str] = []
    diagnosis = diagnose_simulator(SIMULATOR, [run("light", LIGHT)], progress=messages.append)
    at = next(k for k, line in enumerate(messages) if line.startswith("heat "))
    assert at < messages.index("fitting 1 effect jointly with the base")
    report = diagnosis.report()["identifiability"]
    assert report["causes"]["heat"]["by"] == ["oven"] and not report["base"]["length"]["is_told"]
