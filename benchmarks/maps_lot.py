"""Maps of a lot fitted together, through the load that its units share with each other: by the product itself.

Every lot is written as a lot folder and calibrated by a batch, which makes the lot fit. Units alone are the revisions
that it replaced. No audit lies in the folder: what is tested here, the product has not seen.

`insole` fits the units on another day than the source's, under another programme, and tests them on the held-out
quarter of the source's day (as maps_insole.py other). `--own` gives errors over those of own calibrations, too, of one
training each (the first of the seeds), and keeps these in a file for the next call.
Constants of the shared load were chosen behind other sources (`core/maps/config.py`) or looked at with every fourth
unit behind taxel_001, 030 and 061, one seed, and lot 0 of `simulated`; all else tests them. `--planted` presses a third
of the units by the source's programme instead, and leaves one with noise alone. `simulated` draws lots under one
programme that the source did not have; the depth differs from unit to unit, or from press to press.

python benchmarks/maps_lot.py insole [--sources NAME ...] [--units N ...] [--seeds K ...] [--planted]
    [--programme same|other] [--own FILE]
python benchmarks/maps_lot.py simulated [--lots FIRST LAST] [--units N]
"""

import argparse
import json
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from common.command import Commands
from common.map_methods import NETWORK, SOURCES, insole, own_error, split, summary, taxel, taxels
from common.tables import print_table

from softcal.app.batch.batch import run_batch
from softcal.app.batch.lot_work import BatchConfig
from softcal.app.files.lot_folder import open_lot_folder
from softcal.core.metrics import rmse
from softcal.core.profiles import Profile
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.simulated_lot import DEPTH_MM, PROGRAMMES, LotDesign, draw_twins
from softcal.core.twin.simulate import Twin, simulate
from softcal.core.unit.estimate import estimate
from softcal.core.unit.state import UnitState
from softcal.db.connection import open_registry

PRESSES = (("one press for all", 0.0, 0.0), ("5 % from unit to unit", 0.05, 0.0), ("12 % from unit to unit", 0.12, 0.0),
           ("5 % from press to press", 0.0, 0.05), ("12 % from press to press", 0.0, 0.12))  # fmt: skip
"""How the depth differs: from unit to unit, and from press to press of each, as standard deviations."""

ALONE, TOGETHER = "units alone", "lot fit"


@dataclass(frozen=True)
class Outcome:
    """What a batch made of a lot: by method and unit, the error, its forecast and the share inside the interval."""

    errors: Mapping[str, Mapping[str, float]]
    forecasts: Mapping[str, Mapping[str, float]]
    inside: Mapping[str, Mapping[str, float]]
    members: tuple[str, ...]
    alone: tuple[str, ...]
    cpu_s: float


def by_product(
    source: LabelledRecording, units: Sequence[OutputRecording], tests: Mapping[str, LabelledRecording], seed: int
) -> Outcome:
    """Write a lot folder, calibrate it by a batch, and score both maps of every unit on its test recording."""
    with tempfile.TemporaryDirectory() as name:
        folder, first = Path(name) / "lot", source.unlabelled
        for part in ("source", "units"):
            (folder / part).mkdir(parents=True)
        (folder / "lot.toml").write_text(
            f'sample_rate_Hz = {first.sample_rate_Hz}\nsource = "{source.serial}"\n[lot]\nid = "lot"\n[reference]\n'
            f'unit = "{source.reference_unit}"\n[output]\nunit = "{first.output_unit}"\n'
        )
        table = {"t_s": first.t_s, "output": first.output, "reference": source.reference}
        pd.DataFrame(table).to_parquet(folder / f"source/{source.serial}.parquet", index=False)
        for unit in units:
            pd.DataFrame({"t_s": unit.t_s, "output": unit.output}).to_parquet(
                folder / f"units/{unit.serial}.parquet", index=False
            )
        with open_registry(f"sqlite:///{Path(name) / 'r.db'}", create=True) as registry:
            start_s = time.process_time()
            config = BatchConfig(network=replace(NETWORK, seed=seed), score_own=False)
            report = run_batch(open_lot_folder(folder), registry, config)
            seconds = time.process_time() - start_s
            scored: dict[str, dict[str, tuple[float, float, float]]] = {ALONE: {}, TOGETHER: {}}
            network = registry.networks.get(report.network.network.id)
            for result in report.units:
                if result.state is None:
                    continue
                for method, revision in ((ALONE, 1), (TOGETHER, None)):
                    state = registry.calibrations.get(result.serial, revision).state
                    scored[method][result.serial] = _scored(network, state, tests[result.serial])
        fitted = [result.serial for result in report.units if result.state and result.state.fit.lot_fit]
        every = [result.serial for result in report.units]
        errors, forecasts, inside = (
            {m: {s: one[k] for s, one in of.items()} for m, of in scored.items()} for k in range(3)
        )
        alone = tuple(s for s in every if s not in fitted)
        return Outcome(errors, forecasts, inside, tuple(fitted), alone, seconds / len(units))


def _scored(network: object, state: UnitState, test: LabelledRecording) -> tuple[float, float, float]:
    estimates = estimate(network, state, test.unlabelled)  # type: ignore[arg-type]
    is_inside = (estimates.lower <= test.reference) & (test.reference <= estimates.upper)
    rows = np.isfinite(estimates.estimate)
    return rmse(estimates.estimate, test.reference), state.forecast.rmse, float(np.mean(is_inside[rows]))


def insole_(options: argparse.Namespace) -> None:
    """Units of the insole on another day: by themselves, and as a lot."""
    for source in options.sources:
        rows, runs = [], dict[int, list[Outcome]]()
        for count in options.units:
            runs[count] = [_insole(source, count, seed, options.programme, options.planted) for seed in options.seeds]
            for method in (ALONE, TOGETHER):
                errors = _medians(runs[count], method)
                inside = np.mean([np.mean(list(one.inside[method].values())) for one in runs[count]])
                ratio = np.median(
                    [one.forecasts[method][s] / one.errors[method][s] for one in runs[count] for s in errors]
                )
                numbers = (*summary(errors.values()), float(inside), float(ratio))
                rows.append((count, method, *numbers, *(_summary(runs[count]) if method == TOGETHER else ("", ""))))
        planted = ", a third by the source's programme, one dead" if options.planted else ""
        seeds = f"seeds {', '.join(map(str, options.seeds))}"
        print(f"Source {source}, {options.programme} programme{planted}, RMSE in bar, {seeds}:\n")
        print_table(("units", "method", "median", "95 %", "largest", "inside the interval", "forecast / true, median",
                     "in the lot fit", "CPU s per unit"), rows)  # fmt: skip
        if options.own is not None:
            _print_ratios(options, runs)


def _medians(runs: Sequence[Outcome], method: str) -> dict[str, float]:
    return {s: float(np.median([one.errors[method][s] for one in runs])) for s in runs[0].errors[method]}


def _print_ratios(options: argparse.Namespace, runs: Mapping[int, Sequence[Outcome]]) -> None:
    stored: dict[str, float] = json.loads(options.own.read_text()) if options.own.exists() else {}
    for name in sorted({s for of in runs.values() for s in of[0].errors[ALONE]}):
        key = f"{name}, {options.programme}, {options.seeds[0]}"
        if key not in stored:
            stored[key] = _own_error_of(name, options.programme, options.seeds[0])
            options.own.write_text(json.dumps(stored))
    rows = []
    for count, of in runs.items():
        for method in (ALONE, TOGETHER):
            errors = _medians(of, method)
            ratios = [error / stored[f"{s}, {options.programme}, {options.seeds[0]}"] for s, error in errors.items()]
            rows.append((count, method, *summary(ratios)))
    print("After / own:\n")
    print_table(("units", "method", "median", "95 %", "largest"), rows)


def _summary(runs: Sequence[Outcome]) -> tuple[str, str]:
    members = sorted({len(one.members) for one in runs})
    alone = sorted({serial for one in runs for serial in one.alone})
    names = f" (alone: {', '.join(alone)})" if 0 < len(alone) <= 6 else ""
    return f"{' to '.join(map(str, dict.fromkeys((members[0], members[-1]))))}{names}", f"{runs[0].cpu_s:.2f}"


def _insole(source: str, count: int, seed: int, programme: str, is_planted: bool) -> Outcome:
    day, other = insole("calibration"), insole("validation_1")
    train, test_rows = split(len(day))
    names = [name for name in taxels(day) if name != source]
    names = [names[k] for k in np.linspace(0, len(names) - 1, count).astype(int)]
    away = {name: taxel(other, name) if programme == "other" else taxel(day, name, train) for name in names}
    targets = {name: one.unlabelled for name, one in away.items()}
    if is_planted:
        targets |= {name: taxel(day, name, train).unlabelled for name in names[1::3]}
        dead = targets[names[2]]
        noise = np.random.default_rng(seed).normal(0, 0.5, len(dead))
        targets[names[2]] = replace(dead, output=np.round(dead.output[0] + noise))
    tests = {name: taxel(day, name, test_rows) for name in names}
    return by_product(taxel(day, source, train), list(targets.values()), tests, seed)


def _own_error_of(name: str, programme: str, seed: int) -> float:
    day = insole("calibration")
    train, test = split(len(day))
    own_recording = taxel(day, name, train) if programme == "same" else taxel(insole("validation_1"), name)
    return own_error(own_recording, taxel(day, name, test), replace(NETWORK, seed=seed))


def simulated(options: argparse.Namespace) -> None:
    """Simulated lots under one programme that the source did not have."""
    rows, lots = [], range(options.lots[0], options.lots[1] + 1)
    for label, by_unit, by_press in PRESSES:
        runs = [_simulated(seed, options.units, by_unit, by_press) for seed in lots]
        for method in (ALONE, TOGETHER):
            errors = [error for one in runs for error in one.errors[method].values()]
            inside = [share for one in runs for share in one.inside[method].values()]
            ratios = np.log([f / one.errors[method][s] for one in runs for s, f in one.forecasts[method].items()])
            low, high = (float(np.exp(-np.quantile(ratios, q))) for q in (0.975, 0.025))
            members = sum(len(one.members) for one in runs) if method == TOGETHER else ""
            ends = f"{low:.2f} to {high:.2f}"
            rows.append((label, method, *summary(errors)[:2], float(np.mean(inside)), ends, members))
    print(f"Lots {lots[0]} to {lots[-1]} of {options.units} units, RMSE [N] on the source's programme:\n")
    print_table(("depth differs", "method", "median", "95 %", "inside the interval", "true / forecast, 95 % of units",
                 "in the lot fit"), rows)  # fmt: skip


def _simulated(seed: int, count: int, by_unit: float, by_press: float) -> Outcome:
    rng = np.random.default_rng([seed, 62])
    design = LotDesign()
    twins = draw_twins(rng, count + 1, design.spread)
    source = _recorded(rng, twins[0], PROGRAMMES["none"](rng, 170.0), "S0")
    common = PROGRAMMES["own programme"](rng, 60.0)
    targets, tests = [], {}
    for k, twin in enumerate(twins[1:]):
        load_N = scaled(common, 1.0 + by_unit * rng.normal(), by_press, rng)
        targets.append(_recorded(rng, twin, load_N, f"U{k:02d}").unlabelled)
        tests[f"U{k:02d}"] = _recorded(rng, twin, PROGRAMMES["none"](rng, 60.0), f"U{k:02d}")
    return by_product(source, targets, tests, seed)


def scaled(profile: Profile, factor: float, by_press: float, rng: np.random.Generator) -> Profile:
    """The profile with other depths, in the same time: all by a factor, and each press by one of its own."""
    scaled_factor, segments = factor, []
    for segment in profile.segments:
        if segment.target_mm <= 0:
            scaled_factor = factor * (1.0 + by_press * rng.normal())
        segments.append(replace(segment, target_mm=min(segment.target_mm * scaled_factor, 1.15 * DEPTH_MM)))
    return Profile(profile.name, tuple(segments))


def _recorded(rng: np.random.Generator, twin: Twin, profile: Profile, serial: str) -> LabelledRecording:
    t_s, stage_mm = profile.sample(50.0)
    force_N, output_V = simulate(twin, t_s, stage_mm, rng)
    return LabelledRecording(OutputRecording(serial, t_s, output_V, 50.0), force_N)


def main() -> None:
    commands = Commands(__doc__)
    insole_.__name__ = "insole"
    of_insole = commands.add(insole_)
    of_insole.add_argument("--sources", nargs="+", default=SOURCES)
    of_insole.add_argument("--units", nargs="+", type=int, default=(40,), metavar="N")
    of_insole.add_argument("--seeds", nargs="+", type=int, default=(1, 2, 3, 4, 5), metavar="K")
    of_insole.add_argument("--programme", choices=("same", "other"), default="other")
    of_insole.add_argument("--own", type=Path, metavar="FILE")
    of_insole.add_argument("--planted", action="store_true")
    of_lots = commands.add(simulated)
    of_lots.add_argument("--lots", nargs=2, type=int, default=(0, 1), metavar=("FIRST", "LAST"))
    of_lots.add_argument("--units", type=int, default=8)
    commands.run()


if __name__ == "__main__":
    main()
