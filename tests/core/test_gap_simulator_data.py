"""Mistakes in recordings of any mechanism: named before a cause is sought, and none where the recordings are sound."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest

from softcal.core.errors import InputError
from softcal.core.gap.simulator import Columns, Simulator, SimulatorRun, candidate, recorded
from softcal.core.gap.simulator_model import check_simulator, diagnose_simulator
from softcal.core.twin.effects import Parameter

T = np.arange(300) * 0.02


def lift(i: Columns, p: Mapping[str, float]) -> Columns:
    force = p["force_per_A"] * i["drive_A"] + p["bend.a"] * i["drive_A"] ** 3
    return {"force_N": force, "place_mm": p["zero"] + 0.2 * force * np.exp(-0.1 * T)}


SIMULATOR = Simulator(
    "a lift",
    lift,
    ("drive_A",),
    ("force_N", "place_mm"),
    (Parameter("force_per_A", "N/A", -100.0, 100.0, 5.0), Parameter("zero", "mm", -50.0, 50.0, 5.0)),
    (candidate("bend", "coil", Parameter("a", "N/A³", -1.0, 1.0, 0.1, neutral=0.0)),),
)


def sound(curvature: float = 0.0) -> list[dict[str, np.ndarray]]:
    rng, out = np.random.default_rng(2), []
    for run in range(4):
        drive_A = (1.0 + 0.4 * run) * np.sin((0.7 + 0.3 * run) * T)
        gives = lift({"drive_A": drive_A}, {"force_per_A": 3.0, "zero": 7.0, "bend.a": curvature})
        noisy = {name: v + rng.normal(0.0, 0.02, len(T)) for name, v in gives.items()}
        out.append({"t_s": T, "drive_A": drive_A, **noisy})
    return out


def runs(tables: list[dict[str, np.ndarray]]) -> list[SimulatorRun]:
    return [recorded(SIMULATOR, str(k), table) for k, table in enumerate(tables, start=1)]


def times(name: str, factor: float, run: int | None = 2) -> Callable[[list[dict[str, np.ndarray]]], None]:
    def spoil(tables: list[dict[str, np.ndarray]]) -> None:
        for k, table in enumerate(tables):
            if run is None or k == run:
                table[name] = factor * table[name]

    return spoil


def freeze_reference(tables: list[dict[str, np.ndarray]]) -> None:
    tables[1]["place_mm"] = np.full(len(T), 3.0)


def exchanged(tables: list[dict[str, np.ndarray]]) -> None:
    for table in tables:
        table["force_N"], table["place_mm"] = table["place_mm"], table["force_N"]


MISTAKES = [
    (times("force_N", 1.0 / 9.80665), ("unit_factor", "force_N", (3,), 9.80665)),
    (times("force_N", 3.3), ("gain", "force_N", (3,), 1.0 / 3.3)),
    (times("force_N", -1.0), ("sign", "force_N", (3,), -1.0)),
    (times("drive_A", 1e3), ("unit_factor", "drive_A", (3,), 1e-3)),
    (times("drive_A", -1.0), ("sign", "drive_A", (3,), -1.0)),
    (times("t_s", 1e3), ("unit_factor", "t_s", (3,), 1e-3)),
    (freeze_reference, ("constant", "place_mm", (2,), None)),
    (exchanged, ("swapped_columns", "force_N+place_mm", (), None)),
]


@pytest.mark.parametrize("curvature", [0.0, 0.08])
@pytest.mark.parametrize(("spoil", "expected"), MISTAKES)
def test_a_mistake_is_named_with_its_run_and_repair(spoil, expected, curvature: float) -> None:
    tables = sound(curvature)
    spoil(tables)
    diagnosis = diagnose_simulator(SIMULATOR, runs(tables))
    (mistake,) = diagnosis.mistakes
    what, channel, at, factor = expected
    assert (diagnosis.verdict, mistake.what, mistake.channel, mistake.runs) == ("data", what, channel, at)
    assert mistake.factor == (None if factor is None else pytest.approx(factor, rel=0.03))
    assert diagnosis.report()["data"] and all(cause.probability == 0.0 for cause in diagnosis.causes)


@pytest.mark.parametrize("curvature", [0.0, 0.08, 0.3])
def test_sound_recordings_hold_no_mistake_whatever_is_missing(curvature: float) -> None:
    diagnosis = diagnose_simulator(SIMULATOR, runs(sound(curvature)))
    assert not diagnosis.mistakes and diagnosis.verdict == ("explained" if curvature else "no_gap")


def test_a_channel_that_may_be_cut_off_is_asked_about_and_diagnosed() -> None:
    tables = sound(0.08)
    for table in tables:
        table["force_N"] = np.minimum(table["force_N"], 5.0)
    diagnosis = diagnose_simulator(SIMULATOR, runs(tables))
    assert {m.what for m in diagnosis.mistakes} == {"out_of_range"} and diagnosis.verdict != "data"
    assert {m.channel for m in check_simulator(SIMULATOR, runs(tables))[0]} == {"force_N"}


def test_an_encoder_with_coarse_steps_is_not_cut_off() -> None:
    tables = sound()
    for table in tables:
        table["place_mm"] = np.round(table["place_mm"] / 0.2) * 0.2
    assert check_simulator(SIMULATOR, runs(tables))[0] == ()


def test_time_that_does_not_go_on_is_refused_in_one_line() -> None:
    table = sound()[0]
    table["t_s"] = np.where(np.arange(len(T)) == 70, 0.5, T)
    with pytest.raises(InputError, match="t_s does not go on at sample 70"):
        recorded(replace(SIMULATOR), "1", table)


def soft(i: Columns, p: Mapping[str, float]) -> Columns:
    return {"sunk_mm": p["softness"] * i["load_N"] + p["softening.a"] * np.sqrt(np.abs(i["load_N"]))}


SOFT = Simulator(
    "a foam",
    soft,
    ("load_N",),
    ("sunk_mm",),
    (Parameter("softness", "mm/N", -100.0, 100.0, 1.0),),
    (candidate("softening", "foam", Parameter("a", "mm/N^0.5", -10.0, 10.0, 0.1, neutral=0.0)),),
)


def foam_runs() -> list[SimulatorRun]:
    """A foam that softens under load; its base agrees better once the two columns are exchanged."""
    rng, out = np.random.default_rng(4), []
    for k, speed in enumerate((0.7, 1.1, 1.9)):
        load_N = 5.0 * np.abs(np.sin(speed * T))
        sunk_mm = soft({"load_N": load_N}, {"softness": 0.1, "softening.a": 0.6})["sunk_mm"]
        columns = (load_N, sunk_mm + rng.normal(0.0, 0.005, len(T)))
        out.append(recorded(SOFT, str(k), {"t_s": T, **dict(zip(("load_N", "sunk_mm"), columns, strict=True))}))
    return out


def test_a_gap_that_exchanged_columns_would_lessen_a_little_is_diagnosed() -> None:
    diagnosis = diagnose_simulator(SOFT, foam_runs())
    assert diagnosis.verdict == "explained" and [c.effect for c in diagnosis.causes if c.probability > 0.5] == [
        "softening"
    ]
    assert not any(m.what == "swapped_columns" for m in diagnosis.mistakes)


def test_a_mistake_that_leaves_much_is_a_question_beside_a_whole_diagnosis() -> None:
    """Without a cause that could explain it, the exchange is worth asking about, and no more."""
    nothing = candidate("tide", "earth", Parameter("a", "mm", -1.0, 1.0, 0.1, neutral=0.0))

    def run(i: Columns, p: Mapping[str, float]) -> Columns:
        return {"sunk_mm": p["softness"] * i["load_N"] + p["tide.a"] * np.sin(40.0 * i["t_s"])}

    diagnosis = diagnose_simulator(replace(SOFT, run=run, candidates=(nothing,)), foam_runs())
    assert diagnosis.verdict == "unknown" and [m.what for m in diagnosis.mistakes] == ["swapped_columns"]
