"""Which numbers of the method matter: each halved and doubled, and what that changes for units in order and mistakes.

python benchmarks/sensitivity.py [--each 4] [--seed 0] [--only PREFIX] [--processes 1]

The units are those of benchmarks/mistakes.py, with simulated lots that know the stage's position beside them: `--each`
in good order of every set, and every mistake once on a unit of every set. A number between a half and 1 is a share: its
distance from 1 is halved and doubled. Nothing is chosen here: the table says which numbers are worth a measurement, and
which the code could do without. Exit code 1: a number changes nothing although it was read.
"""

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np
from common.command import parser_of
from common.tables import print_table
from mistakes import MISTAKES, SETS, Rng, Unit, trained

from softcal.core.errors import InputError, SoftcalError
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.simulated_lot import LotDesign, simulate_lot
from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.method import Method
from softcal.core.unit.source_model import SourceModel, make_source_model
from softcal.core.unit.unit_problem import UnitProblem

HELD = ("version", "taps", "levels", "confidence", "release.")
"""Parts of file formats, and the release of a lot: benchmarks/trust.py asks about that."""

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
    options = parser.parse_args()
    chosen = list(cases(np.random.default_rng(options.seed), options.each))
    read = names_read(chosen)
    names = [name for name, _, _ in Method().numbers() if name.startswith(options.only) and not name.startswith(HELD)]
    asked = [(name, factor) for name in names if name in read for factor in (0.5, 2.0)]
    base = outcomes(chosen, Method())
    with ProcessPoolExecutor(options.processes, initializer=remember, initargs=(chosen, base)) as pool:
        rows = dict(zip(asked, pool.map(changed, asked), strict=True))
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
    by_set["stage known"] = list(placed(rng))
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


def placed(rng: Rng) -> Iterator[Unit]:
    for shift in ("none", "other dwell", "own programme"):
        lot = simulate_lot(int(rng.integers(1_000_000)), LotDesign(good=6, shift=shift, has_stage=True))
        source = trained(lot.source)
        for unit in lot.units:
            yield Unit("stage known", source, LabelledRecording(unit.recording, np.zeros(len(unit.recording))))


def outcomes(chosen: list[Case], method: Method) -> list[Outcome]:
    """Calibrate every unit with one method; what is made of a source is made once."""
    models: dict[int, SourceModel] = {}
    found = []
    for unit, recording in chosen:
        if id(unit.model) not in models:
            old = unit.model
            models[id(old)] = make_source_model(old.source, old.network, method=method)
        found.append(outcome(models[id(unit.model)], recording))
    return found


def outcome(model: SourceModel, recording: OutputRecording) -> Outcome:
    try:
        made = calibrate(UnitProblem(model, recording))
    except (SoftcalError, ValueError, IndexError, ZeroDivisionError, np.linalg.LinAlgError) as error:
        word = error.reason.code if hasattr(error, "reason") else type(error).__name__
        return Outcome(word, "", np.nan, np.zeros(0))
    estimate = model.network.evaluate(made.unit_map.apply(recording.windows))
    return Outcome(
        f"{made.decision.verdict}: {made.evidence['findings']}",
        made.unit_map.family,
        float(made.predicted_rmse or np.nan),
        estimate,
    )


def names_read(chosen: list[Case]) -> set[str]:
    """Return the names of the numbers that the calibration of these units asks for."""
    method, asked = Method(), set[str]()
    paths = dict(configs(method, ""))
    plain = {kind: kind.__getattribute__ for kind in paths}

    def watch(self: object, name: str) -> object:
        asked.add(f"{paths[type(self)]}{name}")
        return object.__getattribute__(self, name)

    for kind in paths:
        kind.__getattribute__ = watch  # type: ignore[method-assign,assignment]
    outcomes(chosen, method)
    for kind in plain:
        del kind.__getattribute__
    return asked


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


def scaled(value: object, factor: float) -> object:
    if isinstance(value, tuple):
        return tuple(scaled(one, factor) for one in value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value
    if isinstance(value, int):
        return max(1, round(value * factor)) if value > 0 else value
    return 1 - (1 - value) * factor if 0.5 < value < 1 else value * factor


KEPT: list[tuple[list[Case], list[Outcome]]] = []


def remember(chosen: list[Case], base: list[Outcome]) -> None:
    KEPT[:] = [(chosen, base)]


def changed(asked: tuple[str, float]) -> tuple[str, str, str, str]:
    """Return what one changed number changes: words, families, the worst ratio of forecasts, and estimates."""
    name, factor = asked
    chosen, base = KEPT[0]
    try:
        now = outcomes(chosen, with_number(Method(), name.split("."), factor))
    except (SoftcalError, ValueError, IndexError, ZeroDivisionError, TypeError) as error:
        return (str(len(chosen)), "-", type(error).__name__, str(len(chosen)))
    pairs = list(zip(base, now, strict=True))
    words = sum(a.word != b.word for a, b in pairs)
    families = sum(a.family != b.family for a, b in pairs)
    ratios = [abs(np.log(b.forecast / a.forecast)) for a, b in pairs if a.word == b.word and np.isfinite(a.forecast)]
    moved = sum(not np.array_equal(a.estimate, b.estimate) for a, b in pairs)
    return str(words), str(families), f"{np.exp(max(ratios, default=0.0)):.3g}", str(moved)


if __name__ == "__main__":
    raise SystemExit(main())
