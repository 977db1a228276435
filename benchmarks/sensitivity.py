"""Which numbers of the method matter: each halved and doubled, and what that changes for units in order and mistakes.

python benchmarks/sensitivity.py [--use] [--each 4] [--seed 0] [--only PREFIX] [--processes 1]

The units are those of benchmarks/mistakes.py, with simulated lots that know the stage's position beside them: `--each`
in good order of every set, and every mistake once on a unit of every set. A number between a half and 1 is a share: its
distance from 1 is halved and doubled. Nothing is chosen here: the table says which numbers are worth a measurement, and
which the code could do without. Exit code 1: a number changes nothing although it was read.

With `--use` the numbers are those of long use and the units are streams: one of most kinds of
common/simulated_streams.py, one with faults, one of random presses, one that is mapped by queues and a measured nylon
run (SOFTCAL_DATA). Only the first rows of each are followed.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from common import followed
from common.command import parser_of
from common.map_methods import DATA
from common.simulated_streams import ACTIVITIES, CALIBRATION, KINDS, bench, draw, read, station
from common.tables import print_table
from mistakes import MISTAKES, SETS, Rng, Unit, trained

from softcal.core.errors import InputError, SoftcalError
from softcal.core.network.config import NetworkConfig
from softcal.core.operation.adapter import QUEUES, AdaptConfig, Adapter
from softcal.core.operation.method import DriftTracking
from softcal.core.operation.observation import JUMPED, ON_TRIAL
from softcal.core.operation.queued_transport import QueuedTransport
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.simulated_lot import LotDesign, simulate_lot
from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.estimate import Flags
from softcal.core.unit.method import Method
from softcal.core.unit.source_model import SourceModel, make_source_model
from softcal.core.unit.unit_problem import UnitProblem

FIXED_NUMBERS = ("version", "taps", "levels", "confidence", "release.")
"""Parts of file formats, and the release of a lot: benchmarks/trust.py asks about that."""

FAILURES = (SoftcalError, ValueError, IndexError, ZeroDivisionError, TypeError, np.linalg.LinAlgError)

LEFT_OUT = {
    "no drift",
    "no drift, loads x 1.3",
    "no drift, loads x 0.6",
    "no drift, load and pace change",
    "no drift, irregular use",
    "no drift, another programme",
    "level creeps",
    "age, irregular use",
    "seasons",
}
"""Kinds of streams that others stand for."""

STREAM_ROWS, QUEUED_ROWS, PRESSED_ROWS = 8000, 2400, 24_000

Case = tuple[Unit, OutputRecording]


@dataclass(frozen=True)
class Outcome:
    """What one unit ends as: word and findings, family of its map, forecast of its error, and its estimates."""

    word: str
    family: str
    forecast: float
    estimate: Array


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--each", type=int, default=4, help="units in good order of every set")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", metavar="PREFIX", help="numbers whose name begins so")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--use", action="store_true", help="the numbers of long use")
    options = parser.parse_args()
    if options.use:
        return print_operation(options.seed, options.only)
    chosen = list(cases(np.random.default_rng(options.seed), options.each))
    by_case = [names_read(Method(), partial(outcomes, [case], Method())) for case in chosen]
    read = set[str]().union(*by_case)
    names = [
        name
        for name, _, _ in Method().numbers()
        if name.startswith(options.only) and not name.startswith(FIXED_NUMBERS)
    ]
    requested = [(name, factor) for name in names if name in read for factor in (0.5, 2.0)]
    base = outcomes(chosen, Method())
    with ProcessPoolExecutor(options.processes, initializer=remember, initargs=(chosen, base, by_case)) as pool:
        rows = dict(zip(requested, pool.map(changed, requested), strict=True))
    printed = [(name, *rows[name, 0.5], *rows[name, 2.0]) for name in names if name in read]
    printed.sort(key=lambda row: -max(int(row[1]), int(row[5])))
    heads = ("words", "families", "forecast, worst ratio", "estimates")
    print_table(("number", *(f"x 0.5: {h}" for h in heads), *(f"x 2: {h}" for h in heads)), printed)
    idle = [name for name, *changes in printed if changes == ["0", "0", "1", "0"] * 2]
    print(f"\n{len(chosen)} units, {len(names)} numbers; {len(idle)} were read and change nothing: {', '.join(idle)}")
    print(f"not read by any of them: {', '.join(name for name in names if name not in read)}")
    return int(bool(idle))


def cases(rng: Rng, each: int) -> Iterator[Case]:
    """Units in good order, then every mistake on one of each set."""
    by_set = {name: list(make(rng)) for name, make in SETS.items()}
    by_set["stage known"] = list(draw_stage_matched(rng))
    everyone = [unit for units in by_set.values() for unit in units]
    for units in by_set.values():
        picked = rng.choice(len(units), min(each, len(units)), replace=False)
        for unit in (units[k] for k in picked):
            yield unit, unit.recording.unlabelled
        for mistake in MISTAKES.values():
            unit = units[int(rng.integers(len(units)))]
            try:
                recording = mistake(unit, everyone, rng)
            except InputError:  # a station that knows its stage cannot make this mistake
                continue
            if recording is not None:
                yield unit, recording


def draw_stage_matched(rng: Rng) -> Iterator[Unit]:
    for shift in ("none", "other dwell", "own programme"):
        lot = simulate_lot(int(rng.integers(1_000_000)), LotDesign(good=6, shift=shift, has_stage=True))
        source = trained(lot.source)
        for unit in lot.units:
            yield Unit("stage known", source, LabelledRecording(unit.recording, np.zeros(len(unit.recording))))


def outcomes(chosen: list[Case], method: Method) -> list[Outcome]:
    """Calibrate every unit with one method; what is made of a source is made once."""
    models: dict[int, SourceModel] = {}
    outcomes_found = []
    for unit, recording in chosen:
        if id(unit.model) not in models:
            old = unit.model
            models[id(old)] = make_source_model(old.source, old.network, method=method)
        outcomes_found.append(outcome(models[id(unit.model)], recording))
    return outcomes_found


def outcome(model: SourceModel, recording: OutputRecording) -> Outcome:
    try:
        calibration = calibrate(UnitProblem(model, recording))
    except FAILURES as error:
        word = error.reason.code if hasattr(error, "reason") else type(error).__name__
        return Outcome(word, "", np.nan, np.zeros(0))
    estimate = model.network.evaluate(calibration.unit_map.apply(recording.windows))
    return Outcome(
        f"{calibration.decision.verdict}: {', '.join(finding.kind for finding in calibration.fit.findings)}",
        calibration.fit.family,
        calibration.predicted_rmse,
        estimate,
    )


def names_read(method: Any, run: Callable[[], object]) -> set[str]:
    """Return the names of the numbers of a method that a run asks for."""
    names_asked = set[str]()
    paths = dict(configs(method, ""))

    def record_name(self: object, name: str) -> object:
        names_asked.add(f"{paths[type(self)]}{name}")
        return object.__getattribute__(self, name)

    for kind in paths:
        kind.__getattribute__ = record_name  # type: ignore[method-assign,assignment]
    run()
    for kind in paths:
        del kind.__getattribute__
    return names_asked


def configs(config: object, prefix: str) -> Iterator[tuple[type, str]]:
    yield type(config), prefix
    for one in fields(config):  # type: ignore[arg-type]
        value = getattr(config, one.name)
        if is_dataclass(value):
            yield from configs(value, f"{prefix}{one.name}.")


def with_number(config: Any, path: list[str], factor: float) -> Any:
    """Return the configuration with one number halved or doubled."""
    value = getattr(config, path[0])
    new = with_number(value, path[1:], factor) if len(path) > 1 else scaled(value, factor)
    return replace(config, **{path[0]: new})


def scaled(value: Any, factor: float) -> Any:
    if isinstance(value, tuple):
        new = tuple(scaled(one, factor) for one in value)
        if sorted(value) == list(value) and sorted(new) != list(new):
            raise ValueError("a lower bound above the upper one")
        return new
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value
    if isinstance(value, int):
        return max(1, round(value * factor)) if value > 0 else value
    return 1 - (1 - value) * factor if 0.5 < value < 1 else value * factor


REFERENCE_OUTCOMES: list[tuple[list[Case], list[Outcome], list[set[str]]]] = []


def remember(chosen: list[Case], base: list[Outcome], read: list[set[str]]) -> None:
    REFERENCE_OUTCOMES[:] = [(chosen, base, read)]


def changed(change: tuple[str, float]) -> tuple[str, str, str, str]:
    """Return what a number changes in the units that read it, as one row of the table."""
    name, factor = change
    every_case, every_outcome, read = REFERENCE_OUTCOMES[0]
    reading = [k for k, names in enumerate(read) if name in names]
    chosen, base = [every_case[k] for k in reading], [every_outcome[k] for k in reading]
    try:
        now = outcomes(chosen, with_number(Method(), name.split("."), factor))
    except FAILURES as error:
        return (str(len(chosen)), "-", type(error).__name__, str(len(chosen)))
    pairs = list(zip(base, now, strict=True))
    changed_verdicts = sum(a.word != b.word for a, b in pairs)
    families = sum(a.family != b.family for a, b in pairs)
    ratios = [abs(np.log(b.forecast / a.forecast)) for a, b in pairs if a.word == b.word and np.isfinite(a.forecast)]
    moved = sum(not np.array_equal(a.estimate, b.estimate) for a, b in pairs)
    return str(changed_verdicts), str(families), f"{np.exp(max(ratios, default=0.0)):.3g}", str(moved)


@dataclass(frozen=True, eq=False)
class OperatedStream:
    """One stream of use: its unit, what it was calibrated with, its rows, and the true load under them."""

    name: str
    unit: followed.Unit
    calibrated: OutputRecording
    t_s: Array
    output: Array
    load: Array
    mode: str = "improved"


@dataclass(frozen=True)
class Course:
    """What a stream ends as: flags of its rows, rows of sudden changes, words of alarms, estimates and their error."""

    flags: Flags
    jumps: list[int]
    alarms: list[str]
    estimate: Array
    error: float


def streams(seed: int) -> Iterator[OperatedStream]:
    for number, kind in enumerate(KINDS):
        if kind in LEFT_OUT:
            continue
        stream = draw(number, seed)
        unit = followed.Unit(stream.bench.source, stream.bench.network, stream.bench.calibration)
        rows = stream.used.t_s[:STREAM_ROWS], stream.used.output[:STREAM_ROWS], stream.load[:STREAM_ROWS]
        if kind == "level drifts":
            yield OperatedStream("faults", unit, stream.calibrated, *with_faults(*rows))
            continue
        yield OperatedStream(kind, unit, stream.calibrated, *rows)
        if kind == "gain drifts":
            t_s, output, load = (one[:QUEUED_ROWS] for one in rows)
            yield OperatedStream("queues", unit, stream.calibrated, t_s, output, load, "ot-improved")
    rng = np.random.default_rng(seed)
    rate_Hz = ACTIVITIES["press"].rate_Hz
    recording = bench("saturating", rate_Hz)
    load, then = (station(n, rate_Hz, rng)[:n] for n in (PRESSED_ROWS, CALIBRATION))
    shift = 0.2 * np.linspace(0, 1, PRESSED_ROWS)
    output, at_calibration = read("saturating", load, rate_Hz, rng, 1.0, shift), read("saturating", then, rate_Hz, rng)
    calibrated = OutputRecording("unit", np.arange(CALIBRATION) / rate_Hz, at_calibration, rate_Hz)
    unit = followed.Unit(recording.source, recording.network, recording.calibration)
    yield OperatedStream("random presses", unit, calibrated, np.arange(PRESSED_ROWS) / rate_Hz, output, load)
    for path in sorted((DATA / "nylon_drift").glob("sin*.parquet")):
        t_s, output, reference = pd.read_parquet(path).to_numpy().T
        first, later = slice(0, len(t_s) // 4), slice(len(t_s) // 4, len(t_s) // 4 + STREAM_ROWS)
        unit = followed.calibrate(t_s[first], output[first], reference[first], 10.0, NetworkConfig())
        yield OperatedStream(path.stem, unit, unit.source.unlabelled, t_s[later], output[later], reference[later])


def with_faults(t_s: Array, output: Array, load: Array) -> tuple[Array, Array, Array]:
    """Return rows with short and long gaps, missing values, a silent sensor, another rate and a clock that restarts."""
    step_s, output = float(t_s[1] - t_s[0]), output.copy()
    output[2500:2560] = np.nan
    output[3000:3400] = output[3000]
    steps_s = np.diff(t_s, prepend=t_s[0])
    steps_s[4500:4800] *= 1.15
    steps_s[6000] = -3000 * step_s
    rows = np.setdiff1d(np.arange(len(t_s)), np.r_[1000:1010, 1500:1600, 1800:1806])
    # The sensor moves at once where it was silent.
    output[3400:] += 0.15 * np.ptp(output[:2500])
    return np.cumsum(steps_s)[rows], output[rows], load[rows]


def course(stream: OperatedStream, method: DriftTracking) -> Course:
    """Follow a stream with one method."""
    unit, config = stream.unit, AdaptConfig(stream.mode, method)
    calibration_inputs = (unit.network, unit.calibration, stream.calibrated)
    adapter = (
        QueuedTransport(*calibration_inputs, unit.source, config)
        if stream.mode in QUEUES
        else Adapter(*calibration_inputs, config)
    )
    rows, updates = adapter.advance(stream.t_s, stream.output), adapter.take_updates()
    wrong = rows.estimate - stream.load
    return Course(
        rows.flag,
        [update.row for update in updates if update.verdict in (ON_TRIAL, JUMPED)],
        sorted({update.alarm for update in updates}),
        rows.estimate,
        float(np.sqrt(np.nanmean(wrong**2))),
    )


def print_operation(seed: int, only: str) -> int:
    """Print what every number of long use changes, alone; return the exit code."""
    chosen, method, rows = list(streams(seed)), DriftTracking(), []
    base = [course(stream, method) for stream in chosen]
    read = [names_read(method, partial(course, stream, method)) for stream in chosen]
    names = [name for name, _, _ in method.numbers() if name.startswith(only) and not name.startswith(FIXED_NUMBERS)]
    names_asked = [name for name in names if any(name in one for one in read)]
    for name in names_asked:
        reading = [k for k, one in enumerate(read) if name in one]
        cases = [(chosen[k], base[k]) for k in reading]
        rows.append((name, *(c for factor in (0.5, 2.0) for c in changes(cases, name, factor))))
    rows.sort(key=lambda row: -max(float(row[1]), float(row[6])))
    heads = ("rows in another state [%]", "jumps", "alarms", "estimates", "mean error")
    print_table(("number", *(f"x 0.5: {h}" for h in heads), *(f"x 2: {h}" for h in heads)), rows)
    idle = [name for name, *differences in rows if differences == ["0", "0", "0", "0", "1"] * 2]
    print(f"\n{len(chosen)} streams, {len(names)} numbers; {len(idle)} were read and change nothing: {', '.join(idle)}")
    print(f"not read by any of them: {', '.join(name for name in names if name not in names_asked)}")
    return int(bool(idle))


def changes(cases: list[tuple[OperatedStream, Course]], name: str, factor: float) -> tuple[str, str, str, str, str]:
    """Return what a number changes: rows of another flag, streams of other jumps, alarms and estimates, mean error."""
    try:
        method = with_number(DriftTracking(), name.split("."), factor)
        pairs = [(before, course(stream, method)) for stream, before in cases]
    except FAILURES as error:
        return ("100", "-", type(error).__name__, "-", "-")
    flags = np.mean([np.mean(a.flags != b.flags) for a, b in pairs])
    ratio = np.mean([b.error / a.error for a, b in pairs])
    return (
        f"{100 * flags:.3g}",
        str(sum(a.jumps != b.jumps for a, b in pairs)),
        str(sum(a.alarms != b.alarms for a, b in pairs)),
        str(sum(not np.array_equal(a.estimate, b.estimate, equal_nan=True) for a, b in pairs)),
        f"{ratio:.4g}",
    )


if __name__ == "__main__":
    raise SystemExit(main())
