"""Measured rigs that are no soft sensor: the diagnosis comes as close as plain least squares, on runs held out too."""

import importlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from softcal.core.gap.simulator import Simulator, SimulatorRun, recorded
from softcal.core.gap.simulator_model import diagnose_simulator

EXAMPLES = Path(__file__).parents[2] / "examples" / "simulators"
pytestmark = pytest.mark.long


def of_rig(name: str, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    return importlib.import_module(name).SIMULATOR


def runs_of(folder: Path, simulator: Simulator, numbers: str) -> list[SimulatorRun]:
    out = []
    for number in numbers:
        table = np.genfromtxt(folder / "runs" / number / "recording.csv", delimiter=",", names=True)
        out.append(recorded(simulator, number, {name: table[name] for name in table.dtype.names or ()}))
    return out


def rms(simulator: Simulator, runs: list[SimulatorRun], parameters: Any) -> float:
    channel = simulator.channels[0]
    errors = [simulator(run.columns, parameters)[channel] - run.columns[channel] for run in runs]
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


def test_a_motor_whose_friction_differs_by_direction(monkeypatch: pytest.MonkeyPatch, measured_data: Path) -> None:
    """Plain least squares: 38.1 rad/s, 47.4 held out; with friction of two sizes 16.9 and 23.3."""
    motor = of_rig("motor_drive", monkeypatch)
    fitted, held_out = (
        runs_of(measured_data / "rigs" / "motor", motor, "1245"),
        runs_of(measured_data / "rigs" / "motor", motor, "36"),
    )
    report = diagnose_simulator(motor, fitted).report()
    assert rms(motor, fitted, report["base"]) < 38.2 and rms(motor, held_out, report["base"]) < 47.6
    assert rms(motor, fitted, report["parameters"]) < 16.95 and rms(motor, held_out, report["parameters"]) < 23.4
    # Something is left that nobody has named.
    partial: Any = report["partial"]
    assert report["verdict"] == "unknown" and "two_sided_friction" in partial["effects"]


def test_a_heat_exchanger(monkeypatch: pytest.MonkeyPatch, measured_data: Path) -> None:
    """Plain least squares: 0.640 °C, 0.805 held out; with the two causes that take most of it 0.577 and 0.697."""
    exchanger = of_rig("heat_exchanger", monkeypatch)
    fitted, held_out = (
        runs_of(measured_data / "rigs" / "exchanger", exchanger, "12"),
        runs_of(measured_data / "rigs" / "exchanger", exchanger, "3"),
    )
    report = diagnose_simulator(exchanger, fitted).report()
    assert rms(exchanger, fitted, report["base"]) < 0.641 and rms(exchanger, held_out, report["base"]) < 0.807
    assert (
        rms(exchanger, fitted, report["parameters"]) < 0.578 and rms(exchanger, held_out, report["parameters"]) < 0.699
    )
    assert report["verdict"] == "unknown"


def test_two_tanks_whose_causes_gain_little_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawn from the example itself: a brim and a bent pump."""
    tanks = of_rig("two_tanks", monkeypatch)
    truth = {
        c.id + "." + p.name: v for c in tanks.candidates for p, v in zip(c.parameters, c.neutral_values, strict=True)
    }
    truth |= {"pump": 0.055, "upper_valve": 0.062, "lower_valve": 0.05, "upper_start": 5.0, "lower_start": 4.5}
    truth |= {"overflow.brim": 9.0, "pump_curve.bend": -0.05}
    rng, t_s, runs = np.random.default_rng(3), np.arange(500) * 4.0, []
    for name in ("1", "2"):
        waves = [np.sin(2 * np.pi * k * t_s / 2000 + rng.uniform(0, 6)) for k in range(1, 9)]
        inputs = {"t_s": t_s, "pump_V": np.clip(2.9 + 0.9 * np.sum(waves, axis=0), 0.0, 7.0)}
        level = tanks(inputs, truth)["level_V"] + rng.normal(0.0, 0.03, len(t_s))
        runs.append(recorded(tanks, name, inputs | {"level_V": level}))
    diagnosis = diagnose_simulator(tanks, runs)
    assert (diagnosis.verdict, diagnosis.best.hypothesis.ids) == ("explained", ("overflow", "pump_curve"))
    assert diagnosis.gap["level_V"].rmse_after < 0.032
