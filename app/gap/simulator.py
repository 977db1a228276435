"""Diagnose the gap between a simulator of the user's own and recordings of its mechanism."""

import importlib
import json
import multiprocessing
import sys
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from softcal.app.files.atomic import write_text
from softcal.app.files.case_folder import METADATA, RECORDING, read_json
from softcal.app.files.recording_file import ColumnNames, read_times
from softcal.app.gap.diagnose import NO_TERMS
from softcal.app.tables.options import DETECT, TableOptions
from softcal.app.tables.read import read_table
from softcal.app.tables.time_column import find_time_column
from softcal.core.errors import InputError
from softcal.core.gap.simulator import (
    Columns,
    Experiment,
    Simulator,
    SimulatorFailed,
    SimulatorRun,
    candidate,
    recorded,
)
from softcal.core.gap.simulator_reach import term_of, with_terms
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect, Parameter

PARAMETERS_SCHEMA = "softcal.simulator/1"


def load_simulator(reference: str) -> Simulator:
    """Return the simulator `module:name`; the module is looked for in the working folder too.

    Raises:
        InputError: no such module or name, or what it names is no `Simulator`.
    """
    module_name, _, name = reference.partition(":")
    if not module_name or not name:
        raise InputError(f"--simulator {reference}: module:name was expected, such as my_rig:SIMULATOR")
    folder = str(Path.cwd())
    sys.path.insert(0, folder)
    try:
        module = importlib.import_module(module_name)
    except (Exception, SystemExit) as error:
        raise InputError(
            f"--simulator {reference}: {module_name} cannot be imported ({type(error).__name__}: {error}); "
            f"it is looked for in {folder} and among installed packages"
        ) from error
    finally:
        sys.path.remove(folder)
    simulator = getattr(module, name, None)
    try:
        declared = simulator() if callable(simulator) and not isinstance(simulator, Simulator) else simulator
    except Exception as error:
        raise InputError(
            f"--simulator {reference}: {name}() raises {type(error).__name__}: {error}; it must return a Simulator"
        ) from error
    if isinstance(declared, Mapping):
        return simulator_of(declared, module_name)
    if not isinstance(declared, Simulator):
        raise InputError(
            f"--simulator {reference}: {name} is {type(declared).__name__}; a dictionary, a "
            "softcal.core.gap.simulator.Simulator, or a function without arguments that returns one, was expected"
        )
    return declared


REQUIRED_KEYS = ("run", "inputs", "channels", "base", "candidates")
"""What a dictionary must say of a simulator."""


def simulator_of(declared: Mapping[str, Any], name: str) -> Simulator:
    """Return the simulator that a dictionary declares; its keys are the arguments of `Simulator`.

    A parameter is (low, high, usual), with its unit as a fourth where it has one, or the arguments of `Parameter` as a
    dictionary. A candidate is a dictionary of parameters; the first one switches it off at 0.

    Args:
        name: for reports, where the dictionary has none.

    Raises:
        InputError: a key is missing or none of these, or a parameter is none.
    """
    field_names = [f.name for f in fields(Simulator)]
    if faulty_keys := sorted({*REQUIRED_KEYS} - set(declared)) or sorted(set(declared) - set(field_names)):
        raise InputError(
            f"simulator {name}: {', '.join(faulty_keys)} missing or unknown; known are {', '.join(field_names)}"
        )
    values = {"name": name, **declared}
    values |= {key: tuple(values[key]) for key in ("inputs", "channels") if not isinstance(values[key], str)}
    for key in ("base", "run_parameters"):
        if isinstance(values.get(key), Mapping):
            values[key] = tuple(_parameter(name, one, row) for one, row in values[key].items())
    if isinstance(values["candidates"], Mapping):
        values["candidates"] = tuple(_candidate(name, one, rows) for one, rows in values["candidates"].items())
    values["experiments"] = {
        one: Experiment(**row) if isinstance(row, Mapping) else row
        for one, row in values.get("experiments", {}).items()
    }
    return Simulator(**values)


def _candidate(simulator: str, name: str, rows: Mapping[str, Any]) -> Effect:
    location = str(rows.get("place", name))
    first, *others = (_parameter(simulator, one, row) for one, row in rows.items() if one != "place")
    first = replace(first, neutral=0.0) if first.neutral is None else first
    return candidate(name, location, first, *others)


def _parameter(simulator: str, name: str, row: Any) -> Parameter:
    try:
        if isinstance(row, Mapping):
            return Parameter(**{"name": name, "unit": "", **row})
        low, high, usual, *unit = row
        (of_unit,) = unit or [""]
        return Parameter(name, of_unit, low, high, usual)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"simulator {simulator}: {name} is {row!r}; (low, high, usual), with a unit as a fourth, was expected"
        ) from error


CALLS_PER_PARAMETER = (30, 350)
"""Calls of a diagnosis per parameter of base and candidates: where nothing is missing, and where structure is left."""


COMPILED_s = 10.0
"""A first round of calls that takes less is made once more."""


def foretell_duration(simulator: Simulator, runs: Sequence[SimulatorRun], processes: int = 1) -> str:
    """Call a simulator on every run, and return how long a diagnosis will take; empty where that is no minute."""
    parameters = {name: p.usual for name, p in simulator.every_parameter.items()} | simulator.neutral_values
    try:
        each_s = _measure_seconds(simulator, runs, parameters)
        # A simulator that is compiled when it is first called takes longer once.
        each_s = _measure_seconds(simulator, runs, parameters) if each_s < COMPILED_s else each_s
    except SimulatorFailed:
        return ""
    several = each_s * len(simulator.every_parameter) / processes
    min_minutes, max_minutes = (count * several / 60.0 for count in CALLS_PER_PARAMETER)
    if max_minutes < 1.0:
        return ""
    return (
        f"one call takes {each_s / len(runs):.2g} s: about {min_minutes:.2g} minutes where nothing is missing, up to "
        f"{max_minutes:.2g} where structure is left; --processes divides it"
    )


def _measure_seconds(simulator: Simulator, runs: Sequence[SimulatorRun], parameters: Mapping[str, float]) -> float:
    started = perf_counter()
    for run in runs:
        simulator.predict(run, parameters)
    return perf_counter() - started


_OF_PROCESS: list[Simulator] = []
"""The simulator of a worker process."""


def _load_in_process(reference: str) -> None:
    _OF_PROCESS[:] = [load_simulator(reference)]


def _answer(call: tuple[Columns, Mapping[str, float]]) -> Columns | Exception:
    try:
        with np.errstate(all="ignore"):
            return dict(_OF_PROCESS[0].run(*call))
    except (Exception, SystemExit) as error:
        return RuntimeError(f"{type(error).__name__}: {error}")


@contextmanager
def in_processes(reference: str, simulator: Simulator, count: int) -> Iterator[Simulator]:
    """Give a simulator whose calls are answered by several processes, each of which imports `module:name` anew."""
    if count < 1:
        raise InputError(f"--processes {count}: a number from 1 was expected")
    if count == 1:
        yield simulator
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(count, context, _load_in_process, (reference,)) as pool:

        def run_many(calls: Sequence[tuple[Columns, Mapping[str, float]]]) -> list[Columns | Exception]:
            try:
                return list(pool.map(_answer, calls, chunksize=max(1, len(calls) // (4 * count))))
            except BrokenProcessPool as error:
                raise InputError(
                    f"--simulator {reference}: a process that called it ended; leave --processes out"
                ) from error

        yield replace(simulator, run_many=run_many)


def read_runs(source: Path, simulator: Simulator, options: TableOptions = DETECT) -> tuple[list[SimulatorRun], str]:
    """Return the runs of a mechanism and its serial number.

    Args:
        source: folder with runs/<n>/recording.csv, one such run, or one table; columns are `t_s`, the inputs and the
            channels of the simulator. A recording.json beside it may say `profile` and `serial`.

    Raises:
        InputError: there is no run, or a column is missing.
    """
    if source.is_file():
        paths = [source]
    elif (source / RECORDING).is_file():
        paths = [source / RECORDING]
    else:
        tables = (source / "runs").glob(f"*/{RECORDING}")
        paths = sorted(tables, key=lambda path: (len(path.parent.name), path.parent.name))
    if not paths:
        raise InputError(f"{source}: neither a table nor runs/<n>/{RECORDING}; record the mechanism first")
    runs = []
    for path in paths:
        name = path.parent.name if source.is_dir() else path.stem
        columns = _columns(path, simulator, options)
        runs.append(recorded(simulator, name, columns, str(_read_metadata(path).get("profile", ""))))
    return runs, str(_read_metadata(paths[0]).get("serial", source.stem))


def _columns(path: Path, simulator: Simulator, options: TableOptions) -> dict[str, Array]:
    """Return `t_s`, inputs and channels of a run; a row that lacks one of them is left out, which leaves a gap."""
    table = read_table(path, options)
    columns = {name: table.numbers(name) for name in (*simulator.inputs, *simulator.channels) if name in table.names}
    if "t_s" in table.names and options.time_format is None:
        # As it stands: the diagnosis itself finds a wrong unit or rate.
        columns["t_s"] = table.numbers("t_s")
    elif (time := find_time_column([name for name in table.names if name not in columns])) is not None:
        columns["t_s"], *_ = read_times(table, ColumnNames("", time, table=options), None)
    is_complete = np.all([np.isfinite(values) for values in columns.values()], axis=0) if columns else slice(None)
    return {name: values[is_complete] for name, values in columns.items()}


def _read_metadata(path: Path) -> dict[str, object]:
    metadata_path = path.parent / METADATA
    return read_json(metadata_path) if metadata_path.is_file() else {}


def write_parameters(
    path: Path, content: Mapping[str, object], source: str, empirical: bool = False
) -> dict[str, float | None]:
    """Write the parameters that a report of a simulator holds; None is an effect that is off at infinity.

    Args:
        content: a report of schema `softcal.gap/1`.
        empirical: with the empirical terms that describe what no cause explains, and the parameters beside them.

    Raises:
        InputError: the recordings hold a mistake, or there are no parameters.
    """
    if content.get("verdict") == "data":
        raise InputError(f"{source}: the recordings hold a mistake, so there are no parameters; repair it first")
    parameters = content.get("parameters")
    residual = content.get("residual") if empirical else {}
    if not isinstance(residual, Mapping):
        raise InputError(f"{source}: {NO_TERMS}")
    parameters, terms = residual.get("parameters", parameters), residual.get("added", [])
    if not isinstance(parameters, Mapping) or not all(v is None or _is_number(v) for v in parameters.values()):
        raise InputError(f"{source}: holds no parameters; diagnose the simulator again with --json")
    record = {"schema": PARAMETERS_SCHEMA, "simulator": content.get("simulator"), "parameters": dict(parameters)}
    record |= {"terms": terms, "provenance": content.get("provenance")}
    write_text(path, json.dumps(record, indent=2, allow_nan=False) + "\n")
    return {name: None if value is None else float(value) for name, value in parameters.items()}


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def read_parameters(path: str | Path, simulator: Simulator) -> dict[str, float]:
    """Read the parameters that `softcal gap apply` wrote for a simulator, as its `run` takes them.

    Raises:
        InputError: the file cannot be read, is of another simulator, or a parameter is missing or no number.
    """
    content = read_json(Path(path))
    parameters = content.get("parameters")
    if not isinstance(parameters, dict) or content.get("schema") != PARAMETERS_SCHEMA:
        raise InputError(f"{path}: holds no parameters of a simulator; write it with softcal gap apply")
    simulator_name = content.get("simulator")
    if simulator_name != simulator.name:
        raise InputError(f"{path}: parameters of simulator {simulator_name}; those of {simulator.name} were expected")
    run_names = {p.name for p in simulator.run_parameters}
    expected = [*simulator.parameter_names, *(name for name in parameters if name.partition("@")[0] in run_names)]
    if set(parameters) != set(expected):
        other = ", ".join(sorted(set(parameters) ^ set(expected)))
        raise InputError(f"{path}: {other} stands on one side alone; diagnose simulator {simulator.name} again")
    off = {name: value for name, value in simulator.neutral_values.items() if not np.isfinite(value)}
    values: dict[str, Any] = {n: off.get(n) if parameters[n] is None else parameters[n] for n in expected}
    for name, value in values.items():
        if not _is_number(value):
            raise InputError(f"{path}: {name} is {json.dumps(parameters[name])}; a number was expected")
    return {name: float(value) for name, value in values.items()}


def with_written_terms(path: str | Path, simulator: Simulator) -> Simulator:  # noqa: V103
    """Return a simulator with the empirical terms that `gap apply --empirical` wrote.

    Raises:
        InputError: the file cannot be read, or a term is none.
    """
    terms = read_json(Path(path)).get("terms", [])
    return with_terms(simulator, [term_of(one, str(path)) for one in terms])
