"""Maps of a lot fitted together, through the load that its units share with each other: `fit_lot` beside units alone.

`insole` fits the units on another day than the source's, under another programme, and tests them on the held-out
quarter of the source's day (as maps_insole.py other). Constants of the shared load were looked at with every fourth
unit behind taxel_001, 030 and 061, one seed, and lot 0 of `simulated`; all else tests them. `--planted` presses a third
of the units by the source's programme instead, and leaves one with noise alone. `simulated` draws lots under one
programme that the source did not have; the depth differs from unit to unit, or from press to press.

python benchmarks/maps_lot.py insole [--sources NAME ...] [--units N ...] [--seeds K ...] [--planted]
    [--programme same|other]
python benchmarks/maps_lot.py simulated [--lots N] [--units N]
"""

import argparse
import time
from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
from common.command import Commands
from common.map_methods import NETWORK, SOURCES, insole, own_error, split, summary, taxel, taxels
from common.tables import print_table

from softcal.core.maps.interface import UnitMap
from softcal.core.maps.shared_load import LotFit, fit_lot
from softcal.core.metrics import rmse
from softcal.core.network.training import fit_network
from softcal.core.profiles import Profile
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.simulated_lot import DEPTH_MM, PROGRAMMES, LotDesign, draw_twins
from softcal.core.twin.simulate import Twin, simulate

PRESSES = (("one press for all", 0.0, 0.0), ("5 % from unit to unit", 0.05, 0.0), ("12 % from unit to unit", 0.12, 0.0),
           ("5 % from press to press", 0.0, 0.05), ("12 % from press to press", 0.0, 0.12))  # fmt: skip
"""How the depth differs: from unit to unit, and from press to press of each, as standard deviations."""


def insole_(options: argparse.Namespace) -> None:
    """Units of the insole on another day: by themselves, and as a lot."""
    for source in options.sources:
        rows = []
        for count in options.units:
            errors = [_insole_errors(source, count, seed, options.programme, options.planted) for seed in options.seeds]
            for name in errors[0][0]:
                ratio = np.median([one[name] for one, _ in errors], axis=0)
                rows.append((count, name, *summary(ratio)[:2], errors[0][1] if name == "fit_lot" else ""))
        print(f"Source {source}, {options.programme} programme, after / own, medians of {len(options.seeds)} seeds:\n")
        print_table(("units", "method", "median", "95 %", "members, groups, alone; CPU s per unit"), rows)


def _insole_errors(
    source: str, count: int, seed: int, programme: str, is_planted: bool
) -> tuple[Mapping[str, np.ndarray], str]:
    day, other = insole("calibration"), insole("validation_1")
    train, test_rows = split(len(day))
    known = taxel(day, source, train)
    network = fit_network(known, replace(NETWORK, seed=seed)).network
    names = [name for name in taxels(day) if name != source]
    names = [names[k] for k in np.linspace(0, len(names) - 1, count).astype(int)]
    away = {name: taxel(other, name) if programme == "other" else taxel(day, name, train) for name in names}
    targets = {name: one.unlabelled for name, one in away.items()}
    if is_planted:
        targets |= {name: taxel(day, name, train).unlabelled for name in names[1::3]}
        dead = targets[names[2]]
        noise = np.random.default_rng(seed).normal(0, 0.5, len(dead))
        targets[names[2]] = replace(dead, output=np.round(dead.output[0] + noise))
    start_s = time.process_time()
    fit = fit_lot(known, network, list(targets.values()))
    seconds = (time.process_time() - start_s) / count
    said = f"{len(fit.members)}, {len(fit.groups)}, {len(fit.outliers) + len(fit.refused)}; {seconds:.2f}"
    ratios: dict[str, np.ndarray] = {}
    own = np.array([_own(name, programme, seed) for name in fit.units])
    tests = [taxel(day, name, test_rows) for name in fit.units]
    for name, maps in maps_of(fit).items():
        found = [rmse(network.evaluate(one.apply(test.windows)), test.window_reference)
                 for one, test in zip(maps, tests, strict=True)]  # fmt: skip
        ratios[name] = np.array(found) / own
    return ratios, said


@cache
def _own(name: str, programme: str, seed: int) -> float:
    day = insole("calibration")
    train, test = split(len(day))
    own = taxel(day, name, train) if programme == "same" else taxel(insole("validation_1"), name)
    return own_error(own, taxel(day, name, test), replace(NETWORK, seed=seed))


def maps_of(fit: LotFit) -> dict[str, list[UnitMap]]:
    """Maps of the units alone and as a lot."""
    return {
        "units alone": [unit.alone.unit_map for unit in fit.units.values()],
        "fit_lot": [unit.unit_map for unit in fit.units.values()],
    }


def simulated(options: argparse.Namespace) -> None:
    """Simulated lots under one programme that the source did not have."""
    rows = []
    for label, by_unit, by_press in PRESSES:
        found = [_simulated_errors(seed, options.units, by_unit, by_press) for seed in range(options.lots)]
        alone, together = (np.concatenate([one[k] for one in found]) for k in (0, 1))
        growth = [one[2] for one in found]
        rows.append((label, *summary(alone)[:2], *summary(together)[:2], sum(one[3] for one in found),
                     f"{min(growth):.3f} to {max(growth):.3f}"))  # fmt: skip
    print(f"{options.lots} lots of {options.units} units, RMSE [N] on the source's programme:\n")
    print_table(
        ("depth differs", "alone, median", "alone, 95 %", "lot, median", "lot, 95 %", "members", "growth"), rows
    )


def _simulated_errors(
    seed: int, count: int, by_unit: float, by_press: float
) -> tuple[np.ndarray, np.ndarray, float, int]:
    rng = np.random.default_rng([seed, 62])
    design = LotDesign()
    twins = draw_twins(rng, count + 1, design.spread)
    source = _recorded(rng, twins[0], PROGRAMMES["none"](rng, 170.0), "S0")
    network = fit_network(source, replace(NETWORK, seed=seed)).network
    common = PROGRAMMES["own programme"](rng, 60.0)
    targets, tests = [], []
    for k, twin in enumerate(twins[1:]):
        pressed = scaled(common, 1.0 + by_unit * rng.normal(), by_press, rng)
        targets.append(_recorded(rng, twin, pressed, f"U{k:02d}").unlabelled)
        tests.append(_recorded(rng, twin, PROGRAMMES["none"](rng, 60.0), f"U{k:02d}"))
    fit = fit_lot(source, network, targets)
    errors = [
        np.array(
            [rmse(network.evaluate(one.apply(t.windows)), t.window_reference) for one, t in zip(m, tests, strict=True)]
        )
        for m in maps_of(fit).values()
    ]
    growth = max((group.growth for group in fit.groups), default=0.0)
    return errors[0], errors[1], growth, len(fit.members)


def scaled(profile: Profile, factor: float, by_press: float, rng: np.random.Generator) -> Profile:
    """The profile with other depths, in the same time: all by a factor, and each press by one of its own."""
    own, segments = factor, []
    for segment in profile.segments:
        if segment.target_mm <= 0:
            own = factor * (1.0 + by_press * rng.normal())
        segments.append(replace(segment, target_mm=min(segment.target_mm * own, 1.15 * DEPTH_MM)))
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
    of_insole.add_argument("--seeds", nargs="+", type=int, default=(0,), metavar="K")
    of_insole.add_argument("--programme", choices=("same", "other"), default="other")
    of_insole.add_argument("--planted", action="store_true")
    of_lots = commands.add(simulated)
    of_lots.add_argument("--lots", type=int, default=2)
    of_lots.add_argument("--units", type=int, default=8)
    commands.run()


if __name__ == "__main__":
    main()
