"""Mistakes of one run, or of a few samples, in drawn recordings that a simulator does not explain yet."""

from collections.abc import Callable

import numpy as np
import pytest

from softcal.core.gap.case import Case, Run
from softcal.core.gap.diagnosis import check_case
from softcal.core.gap.simulator import Simulator, candidate, recorded
from softcal.core.gap.simulator_model import check_simulator
from softcal.core.gap.twin import TWIN
from softcal.core.profiles import ramps
from softcal.core.twin.effects import Parameter
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.simulate import EffectSetting, Twin, simulate
from tests.layers import layered

Table = dict[str, np.ndarray]


def slide(inputs, p):
    v = inputs["v"]
    rubbing = p["rubbing.size"] * np.tanh(v / 0.01) + p["drag.size"] * v * np.abs(v)
    return {"force": p["mass"] * inputs["a"] + p["viscous"] * v + rubbing}


def warm_room(inputs, p):
    t_s, out, warm = inputs["t_s"], np.empty(len(inputs["t_s"])), p["start"]
    for n, step in enumerate(np.diff(t_s, append=t_s[-1])):
        out[n] = warm
        cooling = p["loss"] * (warm - 20.0) + 1e-3 * p["draught.size"] * np.abs(warm - 20.0) * (warm - 20.0)
        warm += step * (p["gain"] * inputs["power_W"][n] - cooling)
    return {"warm_C": out}


def of(name, high, usual):
    return candidate(name, "part", Parameter("size", "", -high, high, usual, neutral=0.0))


SLIDE = Simulator(
    "slide",
    slide,
    ("v", "a"),
    ("force",),
    (Parameter("mass", "kg", 0.0, 50.0, 1.0), Parameter("viscous", "N·s/m", -50.0, 50.0, 1.0)),
    (of("rubbing", 50.0, 1.0), of("drag", 50.0, 0.5)),
)
WARM_ROOM = Simulator(
    "room",
    warm_room,
    ("power_W",),
    ("warm_C",),
    (
        Parameter("gain", "K/J", 0.0, 1.0, 0.02),
        Parameter("loss", "1/s", 0.0, 1.0, 0.01),
        Parameter("start", "°C", -50.0, 90.0, 20.0),
    ),
    (of("draught", 10.0, 0.1),),
)


def slides(seed: int) -> list[Table]:
    """Four runs of a slide that rubs: the base leaves more than a tenth of the force."""
    rng, out = np.random.default_rng(seed), []
    size, rest = rng.uniform(0.8, 1.4), rng.uniform(0.1, 0.2)
    for _ in range(4):
        t_s = 0.01 * np.arange(500)
        turns, phases = rng.uniform(1.0, 7.0, 4), rng.uniform(0.0, 6.0, 4)
        v, a, q = (sum(f(w * t_s + x) * w**k for w, x in zip(turns, phases, strict=True)) for f, k in MOTION)
        p = {"mass": 0.2, "viscous": 1.0, "rubbing.size": size, "drag.size": 0.0}
        force = slide({"v": v, "a": a}, p)["force"] + rest * np.sin(2.0 * q) + rng.normal(0.0, 0.03, len(t_s))
        out.append({"t_s": t_s, "v": v, "a": a, "force": force})
    return out


MOTION = ((np.sin, 0), (np.cos, 1), (lambda x: -np.cos(x), -1))


def make_rooms(seed: int) -> list[Table]:
    rng, out = np.random.default_rng(seed), []
    for _ in range(4):
        t_s, power_W = 2.0 * np.arange(200), np.repeat(rng.uniform(0.0, 40.0, 10), 20)
        p = {"gain": 0.03, "loss": 0.012, "start": 20.0, "draught.size": 0.6}
        warm_C = warm_room({"t_s": t_s, "power_W": power_W}, p)["warm_C"] + rng.normal(0.0, 0.05, len(t_s))
        out.append({"t_s": t_s, "power_W": power_W, "warm_C": warm_C})
    return out


def set_to(name: str, make: Callable[[Table], np.ndarray]) -> Callable[[Table], Table]:
    return lambda table: table | {name: make(table)}


def with_samples(name: str, at, value: float | None) -> Callable[[Table], Table]:
    def spoil(table: Table) -> Table:
        values = table[name].copy()
        values[at] = values[at][0] if value is None else value
        return table | {name: values}

    return spoil


THREE, BUFFER = [40, 130, 300], slice(240, 260)
MISTAKES: dict[str, tuple[Callable[[Table], Table], tuple[str, str]]] = {
    "sign of the force": (set_to("force", lambda t: -t["force"]), ("sign", "force")),
    "sign of the speed": (set_to("v", lambda t: -t["v"]), ("sign", "v")),
    "two columns": (lambda t: t | {"v": t["force"], "force": t["v"]}, ("swapped_columns", "v+force")),
    "two inputs": (lambda t: t | {"v": t["a"], "a": t["v"]}, ("swapped_columns", "v+a")),
    "999 in the force": (with_samples("force", THREE, 999.0), ("out_of_range", "force")),
    "999 in the speed": (with_samples("v", THREE, 999.0), ("out_of_range", "v")),
    "a constant speed": (set_to("v", lambda t: np.full(len(t["v"]), 0.3)), ("constant", "v")),
}


def with_mistake(tables: list[Table], at: int, spoil: Callable[[Table], Table]) -> list[Table]:
    return [spoil(table) if k == at else table for k, table in enumerate(tables)]


def recordings(simulator: Simulator, tables: list[Table]):
    return [recorded(simulator, str(k), table) for k, table in enumerate(tables, start=1)]


SEEDS = layered(range(701, 706), (701,))


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", MISTAKES)
def test_one_run_that_was_recorded_otherwise_is_named_beside_a_gap(name: str, seed: int) -> None:
    spoil, (what, channel) = MISTAKES[name]
    mistakes, identifiability = check_simulator(SLIDE, recordings(SLIDE, with_mistake(slides(seed), seed % 4, spoil)))
    assert [(m.what, m.channel, m.runs) for m in mistakes] == [(what, channel, (seed % 4 + 1,))]
    assert identifiability is None


@pytest.mark.parametrize("seed", SEEDS)
def test_a_buffer_that_repeats_is_asked_about_with_its_time(seed: int) -> None:
    spoil = with_samples("force", BUFFER, None)
    mistakes, identifiability = check_simulator(SLIDE, recordings(SLIDE, with_mistake(slides(seed), seed % 4, spoil)))
    assert [(m.what, m.channel, m.runs) for m in mistakes] == [("repeats", "force", (seed % 4 + 1,))]
    assert identifiability is not None and "from 2.4 to 2.59 s" in str(mistakes[0].evidence)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("unit", "factor", "offset"), [("°F", 1.8, 32.0), ("K", 1.0, 273.15)])
def test_one_run_in_another_unit_of_temperature_is_named(unit: str, factor: float, offset: float, seed: int) -> None:
    spoil = set_to("warm_C", lambda t: factor * t["warm_C"] + offset)
    mistakes, identifiability = check_simulator(
        WARM_ROOM, recordings(WARM_ROOM, with_mistake(make_rooms(seed), seed % 4, spoil))
    )
    assert [(m.what, m.channel, m.runs) for m in mistakes] == [("unit_factor", "warm_C", (seed % 4 + 1,))]
    assert identifiability is None and unit in str(mistakes[0].repair)


@pytest.mark.parametrize("seed", layered(range(711, 723), (711, 712)))
def test_sound_runs_with_a_gap_hold_no_mistake(seed: int) -> None:
    assert check_simulator(SLIDE, recordings(SLIDE, slides(seed)))[0] == ()
    assert check_simulator(WARM_ROOM, recordings(WARM_ROOM, make_rooms(seed)))[0] == ()


def test_a_kick_that_is_meant_is_no_mistake() -> None:
    """The kick moves the mechanism: without it the simulator would agree less."""
    tables = []
    for table in slides(730):
        a = table["a"].copy()
        a[[50, 200, 350]] += 300.0
        tables.append(table | {"a": a, "force": table["force"] + 0.2 * (a - table["a"])})
    assert check_simulator(SLIDE, recordings(SLIDE, tables))[0] == ()


READOUT = ReadoutMetadata(3.3, 14, 10.0, 50.0)


def press_runs(seed: int) -> list[Run]:
    rng = np.random.default_rng(seed)
    rig = Twin(BaseParameters(kappa_per_N=0.06), (EffectSetting("channel_creep", {"c": 0.1, "tau": 3.0}),), READOUT)
    runs = []
    for k, speed in enumerate((0.5, 1.5, 3.0)):
        t_s, stage_mm = ramps([3.0] * (k + 2), speed).sample(50.0)
        force_N, output_V = simulate(rig, t_s, stage_mm, rng)
        temperature_C = 22.0 + 0.5 * np.sin(0.1 * t_s)
        runs.append(Run(str(k + 1), t_s, READOUT, stage_mm, force_N, output_V, temperature_C))
    return runs


@pytest.mark.parametrize(("unit", "factor", "offset"), [("°F", 1.8, 32.0), ("K", 1.0, 273.15)])
def test_a_run_of_a_sensor_with_another_unit_of_temperature_is_named(unit: str, factor: float, offset: float) -> None:
    runs = press_runs(1)
    warm = np.asarray(runs[1].temperature_C) * factor + offset
    runs[1] = Run("2", runs[1].t_s, READOUT, runs[1].stage_mm, runs[1].force_N, runs[1].output_V, warm)
    mistakes, identifiability = check_case(Case("T", tuple(runs)), TWIN)
    assert [(m.what, m.channel, m.runs) for m in mistakes] == [("unit_factor", "temperature", (2,))]
    assert identifiability is None and unit in str(mistakes[0].repair)


def test_a_code_that_a_buffer_repeats_while_the_stage_moves_is_asked_about() -> None:
    runs = press_runs(2)
    output_V = np.asarray(runs[2].output_V).copy()
    moving = int(np.argmax(np.asarray(runs[2].stage_mm) > 1.2))
    output_V[moving : moving + 20] = output_V[moving]
    runs[2] = Run("3", runs[2].t_s, READOUT, runs[2].stage_mm, runs[2].force_N, output_V, runs[2].temperature_C)
    mistakes, identifiability = check_case(Case("T", tuple(runs)), TWIN)
    assert [(m.what, m.channel, m.runs) for m in mistakes] == [
        ("repeats", "output_V", (3,))
    ] and identifiability is not None
    assert check_case(Case("T", tuple(press_runs(2))), TWIN)[0] == ()
