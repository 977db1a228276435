"""Simulators that are no function of columns: a right-hand side for SciPy, an FMU, and a command on CSV files.

SIMULATOR = Simulator(name="pendulum", run=integrate_rhs(swing, start=lambda p: (p["angle"], 0.0),
                      read_out=lambda t_s, state, p: {"angle_rad": state[0]}), ...)
SIMULATOR = Simulator(name="rig", run=run_command(["./rig_model"], channels=("force_N",)), ...)
SIMULATOR = Simulator(name="crane", run=run_fmu("crane.fmu", {"angle_rad": "load.phi"}, {"pull_N": "rope.f"}), ...)
"""

import csv
import json
import subprocess
import tempfile
from collections.abc import Callable, Mapping, Sequence
from itertools import count
from pathlib import Path
from typing import TypeAlias

import numpy as np
from scipy.integrate import solve_ivp

from softcal.app.extras import lacking
from softcal.core.errors import InputError
from softcal.core.gap.simulator import Columns, Simulate
from softcal.core.recording import Array

Parameters: TypeAlias = Mapping[str, float]

Rhs: TypeAlias = Callable[[float, Array, Mapping[str, float], Parameters], Sequence[float]]
"""(time in s, state, inputs at that time, parameters) -> rates of the state."""

ReadOut: TypeAlias = Callable[[Array, Array, Parameters], Columns]
"""(times in s, (states, times), parameters) -> channels."""

MAX_RATES = 1000
"""Calls of a right-hand side per sample beyond which it has run away."""

TOLERANCE = 1e-9
"""Relative tolerance of the integrator: derivatives of the fit are taken as differences."""


def integrate_rhs(  # noqa: V103
    rhs: Rhs, start: Callable[[Parameters], Sequence[float]], read_out: ReadOut, method: str = "LSODA"
) -> Simulate:
    """Return a simulator's `run` that integrates a right-hand side from sample to sample (`scipy.integrate.solve_ivp`).

    Inputs are straight lines between samples; runs may be sampled unevenly.

    Args:
        start: the state at the first sample.
        method: a method of `solve_ivp`.
    """

    def run(inputs: Columns, parameters: Parameters) -> Columns:
        t_s = np.asarray(inputs["t_s"])
        driving = {name: np.asarray(values) for name, values in inputs.items() if name != "t_s"}

        calls = count(1)

        def rates(t: float, state: Array) -> Sequence[float]:
            if next(calls) > MAX_RATES * len(t_s):
                raise ArithmeticError(f"the integrator does not get beyond {t:.4g} s")
            now = {name: float(np.interp(t, t_s, values)) for name, values in driving.items()}
            return rhs(t, state, now, parameters)

        solved = solve_ivp(
            rates,
            (float(t_s[0]), float(t_s[-1])),
            np.asarray(start(parameters), dtype=np.float64),
            method=method,
            t_eval=t_s,
            rtol=TOLERANCE,
            atol=TOLERANCE,
            max_step=float(np.max(np.diff(t_s))),
        )
        if not solved.success:
            raise ArithmeticError(f"the integrator stopped at {solved.t[-1] if len(solved.t) else t_s[0]:.4g} s")
        return read_out(t_s, solved.y, parameters)

    return run


def run_command(command: Sequence[str], channels: Sequence[str], timeout_s: float = 600.0) -> Simulate:  # noqa: V103
    """Return a simulator's `run` that calls a command: `WORDS inputs.csv parameters.json outputs.csv`.

    The command reads the columns of a run and the parameters by name, and writes the channels as columns, a row a
    sample. It must give them in full precision.

    Args:
        channels: columns that it writes.
        timeout_s: seconds after which a call has failed.
    """

    def run(inputs: Columns, parameters: Parameters) -> Columns:
        with tempfile.TemporaryDirectory() as folder:
            inputs_file, parameters_file, outputs_file = (
                Path(folder) / name for name in ("inputs.csv", "parameters.json", "outputs.csv")
            )
            with inputs_file.open("w", newline="") as file:
                writer = csv.writer(file)
                writer.writerow(inputs)
                writer.writerows(zip(*(map(repr, np.asarray(v).tolist()) for v in inputs.values()), strict=True))
            parameters_file.write_text(json.dumps({k: v if np.isfinite(v) else None for k, v in parameters.items()}))
            call = [*command, str(inputs_file), str(parameters_file), str(outputs_file)]
            process = subprocess.run(call, capture_output=True, text=True, timeout=timeout_s, check=False)
            if process.returncode != 0:
                last = (process.stderr.strip().splitlines() or ["no message"])[-1]
                raise RuntimeError(f"{command[0]} ended with exit code {process.returncode}: {last}")
            with outputs_file.open(newline="") as file:
                rows = list(csv.DictReader(file))
        return {channel: np.array([float(row[channel]) for row in rows]) for channel in channels}

    return run


def run_fmu(  # noqa: V103
    path: str | Path,
    channels: Mapping[str, str],
    inputs: Mapping[str, str] | None = None,
    parameters: Mapping[str, str] | None = None,
    max_step_s: float | None = None,
) -> Simulate:
    """Return a simulator's `run` that steps a functional mock-up unit (FMI 2 and 3, by the package fmpy).

    Args:
        channels, inputs: variables of the unit by column.
        parameters: variables of the unit by parameter, where their names differ; one that is infinite, as a candidate
            that is off may be, is left at the value that the unit begins with.
        max_step_s: longest step; the shortest time between two samples where None.

    Raises:
        InputError: the package is missing, or the unit cannot be read or lacks a variable.
    """
    try:
        import fmpy
    except ImportError as error:
        raise InputError(f"{path}: {lacking('fmpy', 'a functional mock-up unit') or error}") from error
    try:
        description, folder = fmpy.read_model_description(str(path)), fmpy.extract(str(path))
    except Exception as error:
        raise InputError(f"{path}: no functional mock-up unit that can be read: {error}") from error
    of_inputs, of_parameters = dict(inputs or {}), dict(parameters or {})
    names = {variable.name for variable in description.modelVariables}
    if missing := sorted({*channels.values(), *of_inputs.values(), *of_parameters.values()} - names):
        raise InputError(f"{path}: has no variable {', '.join(missing)}; it has {', '.join(sorted(names)[:20])}")

    def run(columns: Columns, values: Parameters) -> Columns:
        t_s = np.asarray(columns["t_s"], dtype=np.float64)
        rows = np.zeros(len(t_s), dtype=[("time", float), *((variable, float) for variable in of_inputs.values())])
        rows["time"] = t_s - t_s[0]
        for column, variable in of_inputs.items():
            rows[variable] = columns[column]
        step_s = max_step_s or float(np.min(np.diff(t_s)))
        result = fmpy.simulate_fmu(
            folder,
            model_description=description,
            start_time=0.0,
            stop_time=float(rows["time"][-1]),
            output_interval=step_s,
            step_size=step_s,
            start_values={of_parameters.get(k, k): v for k, v in values.items() if np.isfinite(v)},
            input=rows if of_inputs else None,
            output=list(channels.values()),
        )
        return {column: np.interp(rows["time"], result["time"], result[of]) for column, of in channels.items()}

    return run
