"""Mistakes drawn on measured and simulated units: how many end as fail or retest, and how many good units are refused.

python benchmarks/mistakes.py [--seed 0] [--draws 260] [--sets egain insole skin simulated]

A mistake is drawn for a unit in good order: the channel the wrong way round, output and reference exchanged, a rate
that is declared wrongly (x 0.2 to 5) or that went by unseen, another physical unit, a clipped readout, another sensor.
The constants that decide were set on eGaIn and insole; skin and simulated lots test them. Exit code 1: fewer than 98 %
of the mistakes end as fail or retest, more than 0.5 % of the good units are refused by what the data contradict, or a
forecast is five times too small behind another word than these.
"""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pandas as pd
from common.command import parser_of
from common.map_methods import DATA
from common.tables import print_table

from softcal.core.errors import UnitRefused
from softcal.core.metrics import rmse
from softcal.core.network.config import NetworkConfig
from softcal.core.network.training import fit_network
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.simulated_lot import LotDesign, simulate_lot
from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.method import Method
from softcal.core.unit.source_model import SourceModel, make_source_model
from softcal.core.unit.unit_problem import UnitProblem

CAUGHT, REFUSED_GOOD, TOO_SMALL = 0.98, 0.005, 5.0
CONTRADICTED = {"reversed", "elsewhere", "other speed", "other rate"}
NETWORK = NetworkConfig(hidden=(40, 20), max_epochs=40)
RATES = (0.2, 0.25, 0.4, 0.5, 2.0, 2.5, 4.0, 5.0)
FACTORS = (1e3, 1e-3, 100.0, 9.80665, 1 / 9.80665, 6.894757, 4.448222, 1 / 4.448222)
SHIFTS = ("none", "short profile", "lighter", "harder", "own programme")

Rng = np.random.Generator


@dataclass(frozen=True, eq=False)
class Unit:
    """A unit in good order beside its source."""

    kind: str
    model: SourceModel
    recording: LabelledRecording


def labelled(serial: str, output: object, reference: object, rate_Hz: float) -> LabelledRecording:
    values = np.asarray(output, dtype=np.float64)
    return LabelledRecording(
        OutputRecording(serial, np.arange(len(values)) / rate_Hz, values, rate_Hz), np.asarray(reference, np.float64)
    )


@cache
def table(name: str) -> pd.DataFrame:
    return pd.read_csv(DATA / name) if name.endswith(".csv") else pd.read_parquet(DATA / name)


def trained(source: LabelledRecording) -> SourceModel:
    training = fit_network(source, NETWORK)
    return make_source_model(source, training.network, training.validation_rows, method=Method())


def egain(rng: Rng) -> Iterator[Unit]:
    for one, other in (("S1", "S2"), ("S2", "S1")):
        model, unit = (table(f"egain_pair/{name}.csv") for name in (one, other))
        source = trained(labelled(one, model["output_V"][:800], model["force_N"][:800], 50.0))
        for _ in range(30):
            length = int(rng.integers(400, 1001))
            start = int(rng.integers(0, 1200 - length + 1))
            part = unit.iloc[start : start + length]
            yield Unit("egain", source, labelled(other, part["output_V"], part["force_N"], 50.0))


def insole(rng: Rng) -> Iterator[Unit]:
    day, other_day = (table(f"insole_lot/{name}.parquet") for name in ("calibration", "validation_1"))
    taxels = [str(name) for name in day if str(name).startswith("taxel")]
    for one in rng.choice(taxels, 2, replace=False):
        source = trained(labelled(one, day[one], day["pressure_bar"], 48.9))
        for name in taxels:
            if name != one:
                yield Unit("insole", source, labelled(name, day[name], day["pressure_bar"], 48.9))
        for name in rng.choice(np.array(taxels), 10, replace=False):
            yield Unit("insole", source, labelled(name, other_day[name], other_day["pressure_bar"], 48.9))


def skin(rng: Rng) -> Iterator[Unit]:
    positions = {name: table(f"skin_places/{name}.parquet") for name in ("left", "middle", "right")}
    for one in positions:
        source = trained(labelled(one, positions[one]["output_V"], positions[one]["force_N"], 50.0))
        for other in positions:
            for _ in range(5 if other != one else 0):
                start = int(rng.integers(0, 3000))
                part = positions[other].iloc[start : start + 3500]
                yield Unit("skin", source, labelled(other, part["output_V"], part["force_N"], 50.0))


def simulated(rng: Rng) -> Iterator[Unit]:
    for shift in SHIFTS:
        for _ in range(3):
            lot = simulate_lot(int(rng.integers(1_000_000)), LotDesign(good=8, shift=shift))
            source = trained(lot.source)
            for unit in lot.units:
                # The recording has no reference; the audit is another one. Only the map is judged on it.
                yield Unit("simulated", source, replace(unit.audit, unlabelled=unit.audit.unlabelled))
                yield Unit("simulated", source, _unlabelled(unit.recording))


def _unlabelled(recording: OutputRecording) -> LabelledRecording:
    return LabelledRecording(recording, np.full(len(recording), np.nan_to_num(0.0)))


SETS: dict[str, Callable[[Rng], Iterator[Unit]]] = {one.__name__: one for one in (egain, insole, skin, simulated)}


def reversed_channel(unit: Unit, others: list[Unit], rng: Rng) -> OutputRecording | None:
    raw = unit.recording.unlabelled
    top = float(raw.output.max())
    # A divider read from its other end, an amplifier that inverts, exchanged leads of a bridge.
    rails = [0.0, 255.0] if top > 100 else [0.0, 2.0, 3.3, 5.0]
    return replace(raw, output=float(rng.choice([rail for rail in rails if rail == 0 or rail > top])) - raw.output)


def exchanged_columns(unit: Unit, others: list[Unit], rng: Rng) -> OutputRecording | None:
    has_load = np.ptp(unit.recording.reference) > 0
    return replace(unit.recording.unlabelled, output=unit.recording.reference) if has_load else None


def declared_rate(unit: Unit, others: list[Unit], rng: Rng) -> OutputRecording | None:
    raw, times = unit.recording.unlabelled, float(rng.choice(RATES))
    return replace(raw, sample_rate_Hz=raw.sample_rate_Hz * times, t_s=raw.t_s / times)


def unseen_rate(unit: Unit, others: list[Unit], rng: Rng) -> OutputRecording | None:
    raw, times = unit.recording.unlabelled, float(rng.choice(RATES))
    at_s = np.arange(0.0, raw.t_s[-1], times / raw.sample_rate_Hz)
    output = np.interp(at_s, raw.t_s, raw.output)
    return replace(raw, t_s=np.arange(len(output)) / raw.sample_rate_Hz, output=output)


def physical_unit(unit: Unit, others: list[Unit], rng: Rng) -> OutputRecording | None:
    raw = unit.recording.unlabelled
    return replace(raw, output=raw.output * float(rng.choice(FACTORS)))


def clipped(unit: Unit, others: list[Unit], rng: Rng) -> OutputRecording | None:
    raw = unit.recording.unlabelled
    low, high = np.quantile(raw.output, (0.02, 0.98))
    at, is_rising = float(rng.uniform(0.3, 0.7)), unit.model.interval.slope_limit > 0
    # The load of a falling sensor lies at its lower end.
    rises = np.corrcoef(unit.model.source.unlabelled.output, unit.model.source.reference)[0, 1] > 0 and is_rising
    level = low + at * (high - low) if rises else high - at * (high - low)
    return replace(raw, output=(np.minimum if rises else np.maximum)(raw.output, level))


def another_sensor(unit: Unit, others: list[Unit], rng: Rng) -> OutputRecording | None:
    other_kinds = [one for one in others if one.kind != unit.kind]
    if not other_kinds:
        return None
    other = other_kinds[int(rng.integers(len(other_kinds)))].recording.unlabelled
    rate_Hz = unit.recording.unlabelled.sample_rate_Hz
    return replace(other, sample_rate_Hz=rate_Hz, t_s=np.arange(len(other)) / rate_Hz)


MISTAKES = {
    one.__name__: one
    for one in (reversed_channel, exchanged_columns, declared_rate, unseen_rate, physical_unit, clipped, another_sensor)
}


def calibrate_unit(unit: Unit, recording: OutputRecording) -> tuple[str, set[str], float]:
    """Return the word, what was found, and the true error over the forecast; NaN where there is no truth."""
    try:
        calibration = calibrate(UnitProblem(unit.model, recording))
    except UnitRefused as error:
        return "refused", {error.reason.code.replace("_", " ")}, np.nan
    kinds = {finding.kind for finding in calibration.fit.findings}
    if np.ptp(unit.recording.reference) == 0 or len(recording) != len(unit.recording):
        return str(calibration.decision.verdict), kinds, np.nan
    estimate = unit.model.network.evaluate(calibration.unit_map.apply(recording.windows))
    return (
        str(calibration.decision.verdict),
        kinds,
        rmse(estimate, unit.recording.window_reference) / calibration.predicted_rmse,
    )


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--draws", type=int, default=260, help="mistakes drawn")
    parser.add_argument("--sets", nargs="+", default=list(SETS), choices=list(SETS))
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    units = [unit for name in options.sets for unit in SETS[name](rng)]
    by_kind = defaultdict(list)
    for unit in units:
        by_kind[unit.kind].append(unit)
    refused, small, good = Counter[str](), 0, Counter[str]()
    for unit in units:
        word, kinds, ratio = calibrate_unit(unit, unit.recording.unlabelled)
        good[unit.kind] += 1
        refused[unit.kind] += bool(kinds & CONTRADICTED)
        small += word in ("pass", "conditional") and ratio > TOO_SMALL
    trials, caught = Counter[tuple[str, str]](), Counter[tuple[str, str]]()
    names = list(MISTAKES)
    for number in range(10 * options.draws):
        if trials.total() == options.draws:
            break
        name, kind = names[number % len(names)], str(rng.choice(list(by_kind)))
        unit = by_kind[kind][int(rng.integers(len(by_kind[kind])))]
        recording = MISTAKES[name](unit, units, rng)
        if recording is None:
            continue
        word, kinds, ratio = calibrate_unit(unit, recording)
        trials[name, kind] += 1
        caught[name, kind] += word not in ("pass", "conditional")
        small += word in ("pass", "conditional") and ratio > TOO_SMALL
        if word in ("pass", "conditional"):
            print(
                f"  missed: {name} on {kind} {recording.serial}: {word}, {sorted(kinds)}, error / forecast {ratio:.2g}"
            )
    rows = [(name, *(f"{caught[name, kind]}/{trials[name, kind]}" for kind in by_kind)) for name in names]
    print_table(
        ("mistake", *by_kind), [*rows, ("good units refused", *(f"{refused[kind]}/{good[kind]}" for kind in by_kind))]
    )
    share, lost = caught.total() / trials.total(), refused.total() / good.total()
    print(
        f"caught {share:.1%} of {trials.total()}, good units refused {lost:.2%} of {good.total()}, five times: {small}"
    )
    return int(share < CAUGHT or lost > REFUSED_GOOD or small > 0)


if __name__ == "__main__":
    raise SystemExit(main())
