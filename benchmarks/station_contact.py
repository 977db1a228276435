"""How well the stage finds a unit's surface, against where it truly lies: units of the twin, and plain force laws.

python benchmarks/station_contact.py [--quick]
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from common.rig_trial import ForceLaw, RigCase, open_rig

from softcal.core.profiles import Profile, ramps
from softcal.core.simulated_lot import draw_twins
from softcal.station.devices.bench import open_simulated_bench
from softcal.station.devices.config import UNKNOWN_S
from softcal.station.tasks.acquisition import record

UNITS, TOUCHES = 12, 8
COEFFICIENTS, POWERS = (0.5, 1.2, 5.0), (1.0, 1.1, 1.25, 1.4, 1.5, 1.75, 2.0)
TOUCH, FAST = ramps([0.3], 0.5, rest_s=0.1), ramps([1.5, 2.0], 5.0, rest_s=0.3)
LATE = ((0.1, 0.1), (0.1, UNKNOWN_S), (0.3, UNKNOWN_S))
"""How late the cell is, and what the station file says of it."""


def main() -> None:
    """Touch every unit and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one lot, four laws")
    quick = parser.parse_args().quick
    print(f"Units of the twin, {UNITS} a lot.\n")
    _print_header("lot")
    for seed in range(1, 2 if quick else 4):
        errors_um, touches_s = _of_lot(seed)
        _print_row(str(seed), errors_um, touches_s)
    print(f"\nForce laws k·x^p under a cell of 80 Hz with 4 mN of noise, {TOUCHES} touches each.\n")
    _print_header("k, N/mm^p | p")
    for coefficient in (1.2,) if quick else COEFFICIENTS:
        for power in POWERS[::2] if quick else POWERS:
            _print_row(f"{coefficient:g} | {power:g}", *_of_law(ForceLaw(coefficient, power)))
    print(f"\nLaws 1.2·x^p under a cell that is late, {TOUCHES} touches each; a slow press comes before the profile.\n")
    _print_header("p | late, s | stated")
    for power in (1.4,) if quick else (1.0, 1.4, 2.0):
        for late_s, stated_s in LATE[::2] if quick else LATE:
            stated = "not" if stated_s == UNKNOWN_S else f"{stated_s:g}"
            row = _of_law(ForceLaw(1.2, power), late_s, stated_s, FAST)
            _print_row(f"{power:g} | {late_s:g} | {stated}", *row)


def _print_header(first: str) -> None:
    print(f"| {first} | mean, um | standard deviation, um | rms, um | largest, um | search, s |")
    print("|" + "---|" * (5 + first.count("|") + 1))


def _print_row(first: str, errors_um: Sequence[float], search_s: Sequence[float]) -> None:
    errors = np.array(errors_um)
    rms, largest = np.sqrt(np.mean(errors**2)), np.max(np.abs(errors))
    facts = f"{errors.mean():+.1f} | {errors.std():.1f} | {rms:.1f} | {largest:.1f} | {np.mean(search_s):.1f}"
    print(f"| {first} | {facts} |", flush=True)


def _of_lot(seed: int) -> tuple[list[float], list[float]]:
    twins, errors_um, search_s = draw_twins(np.random.default_rng(seed), UNITS), [], []
    with open_simulated_bench(twins[0], seed) as (bench, station):
        for twin in twins:
            station.mount(twin)
            watch = _Watch()
            found_mm = record(bench, "A1", ramps([1.0], 4.0, rest_s=0.2), True, watch).contact_mm
            errors_um.append(1e3 * (found_mm - station.rig.clearance_mm - twin.parameters.u0_mm))
            search_s.append(watch.search_s)
    return errors_um, search_s


def _of_law(
    law: ForceLaw, late_s: float = 0.0, stated_s: float = 0.0, profile: Profile = TOUCH
) -> tuple[list[float], list[float]]:
    errors_um, search_s = [], []
    for seed in range(TOUCHES):
        # The surface lies anywhere between two steps of the status.
        surface_mm = 2.2 + 0.01 * float(np.random.default_rng(seed).uniform())
        cell = {"cell_late_s": late_s, "latency_s": stated_s}
        case = RigCase(law=law, surface_mm=surface_mm, stiffest_N_mm=60.0, seed=seed, **cell)
        watch = _Watch()
        with open_rig(replace(case, limit_N=12.0)) as (bench, _):
            errors_um.append(1e3 * (record(bench, "A1", profile, True, watch).contact_mm - surface_mm))
        search_s.append(watch.search_s)
    return errors_um, search_s


class _Watch:
    """Takes the progress of a run, and keeps how long the search took."""

    def __init__(self) -> None:
        self._began_s = self._ended_s = float("nan")

    def __call__(self, progress: object) -> None:
        is_searching = getattr(progress, "phase", "") == "searching for contact"
        t_s = float(getattr(progress, "t_s", 0.0))
        if is_searching:
            self._began_s = t_s if np.isnan(self._began_s) else self._began_s
            self._ended_s = t_s

    @property
    def search_s(self) -> float:
        """From the beginning of the search to its end."""
        return self._ended_s - self._began_s


if __name__ == "__main__":
    main()
