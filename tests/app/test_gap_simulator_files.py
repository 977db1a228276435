"""A report of a simulator is written whatever its values are, and its parameters run the simulator again."""

import hashlib
import importlib.util
import json
import os
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import softcal
from softcal.app.cli.main import main
from softcal.app.gap.simulator import read_parameters
from softcal.core.errors import InputError
from softcal.core.gap.simulator import Simulator

EXAMPLES = Path(__file__).parents[2] / "examples" / "simulators"


@pytest.fixture(autouse=True)
def among_the_examples(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(EXAMPLES)


def example(name: str) -> Simulator:
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    simulator = module.SIMULATOR
    assert isinstance(simulator, Simulator)
    return simulator


def record_runs(simulator: Simulator, rig: Path, parameters: dict[str, float], rows: int) -> None:
    """Write runs that the simulator itself makes, with white noise of 0.3 % of the span."""
    rng = np.random.default_rng(3)
    for number, experiment in enumerate(list(simulator.experiments.values())[:2], start=1):
        inputs = {name: np.asarray(values)[:rows] for name, values in experiment.inputs.items()}
        channels = dict(simulator(inputs, parameters))
        columns = inputs | {c: v + rng.normal(0.0, 0.003 * np.ptp(v), len(v)) for c, v in channels.items()}
        folder = rig / "runs" / str(number)
        folder.mkdir(parents=True)
        table = np.column_stack([*columns.values()])
        np.savetxt(folder / "recording.csv", table, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")


def usual(simulator: Simulator, *on: str) -> dict[str, float]:
    values = {p.name: p.usual for p in simulator.base}
    for effect in simulator.candidates:
        for p, neutral in zip(effect.parameters, effect.neutral_values, strict=True):
            values[f"{effect.id}.{p.name}"] = p.usual if effect.id in on else neutral
    return values


def read_report(path: Path) -> dict[str, Any]:
    def refuse(constant: str) -> float:
        raise ValueError(f"{constant} is no JSON")

    report: dict[str, Any] = json.loads(path.read_text(), parse_constant=refuse)
    return report


def assert_provenance(content: dict[str, Any], case: Path, module: Path) -> None:
    """A report says what made it, when, and the SHA-256 of every file it was made from."""
    provenance = content["provenance"]
    files = {
        **{str(path.relative_to(case)): path for path in case.rglob("*.csv")},
        os.path.relpath(module, case): module,
    }
    assert provenance["inputs"] == {k: hashlib.sha256(path.read_bytes()).hexdigest() for k, path in files.items()}
    assert provenance["version"] == softcal.__version__ and provenance["build"] and provenance["actor"]
    assert len(provenance["method"]) == 64
    assert abs(datetime.fromisoformat(provenance["made_at"]) - datetime.now(UTC)) < timedelta(minutes=10)


ROWS = {"two_tanks": 160, "mass_spring_damper": 200, "motor_drive": 200, "heat_exchanger": 250, "cubic_oscillator": 300}
ROWS |= {"mujoco_finger": 200}
HIDDEN = {
    "two_tanks": "leak",
    "mass_spring_damper": "dry_friction",
    "motor_drive": "dry_friction",
    "heat_exchanger": "curved_cooling",
    "cubic_oscillator": "cubic_spring",
    "mujoco_finger": "dry_joint",
}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name == "two_tanks" else pytest.mark.long) for name in ROWS]
)
def test_what_an_example_diagnoses_is_applied_read_and_run(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    simulator, report, out = example(name), tmp_path / "report.json", tmp_path / "parameters.json"
    hidden = usual(simulator, HIDDEN[name])
    record_runs(simulator, tmp_path / "rig", hidden, ROWS[name])
    diagnose = ["gap", "diagnose", str(tmp_path / "rig"), "--simulator", f"{name}:SIMULATOR", "--json", str(report)]
    assert main(diagnose) == 0
    assert HIDDEN[name] in capsys.readouterr().out
    content = read_report(report)
    assert_provenance(content, tmp_path / "rig", EXAMPLES / f"{name}.py")
    off = [key for key, value in content["parameters"].items() if value is None]
    assert off == [key for key, value in usual(simulator).items() if np.isinf(value)]
    assert main(["gap", "apply", "--report", str(report), "--out", str(out)]) == 0
    read_report(out)
    parameters = read_parameters(out, simulator)
    experiment = next(iter(simulator.experiments.values()))
    inputs = {key: np.asarray(values)[: ROWS[name]] for key, values in experiment.inputs.items()}
    for channel, values in simulator(inputs, parameters).items():
        assert values == pytest.approx(np.asarray(simulator(inputs, hidden)[channel]), abs=0.05 * np.ptp(values))


def test_the_table_is_printed_although_the_report_cannot_be_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    simulator, target = example("two_tanks"), tmp_path / "rig" / "runs" / "1" / "recording.csv" / "report.json"
    record_runs(simulator, tmp_path / "rig", usual(simulator, "leak"), 160)
    diagnose = ["gap", "diagnose", str(tmp_path / "rig"), "--simulator", "two_tanks:SIMULATOR", "--json", str(target)]
    assert main(diagnose) == 2
    assert "verdict" in capsys.readouterr().out


@pytest.mark.parametrize(("name", "value"), [("pump", None), ("leak.rate", None), ("pump", "off"), ("pump", True)])
def test_a_parameter_that_is_not_off_is_a_number(name: str, value: object, tmp_path: Path) -> None:
    simulator, path = example("two_tanks"), tmp_path / "parameters.json"
    values: dict[str, object] = {k: None if np.isinf(v) else v for k, v in usual(simulator).items()}
    record = {"schema": "softcal.simulator/1", "simulator": simulator.name, "parameters": values | {name: value}}
    path.write_text(json.dumps(record))
    with pytest.raises(InputError, match=name):
        read_parameters(path, simulator)
