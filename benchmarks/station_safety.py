"""Press rigs of every drive, cell and hard stop with the real code, and print the largest force each truly saw.

python benchmarks/station_safety.py [--quick] [--model]
"""

import argparse
import itertools

from softcal.core.profiles import ramps
from softcal.station.bounds import FULL, REACTION_S, ForceBounds, Reaction
from softcal.station.config import LATEST_S
from softcal.station.simulated.explore import broken_property, explore
from softcal.station.simulated.law_unit import ForceLaw
from softcal.station.simulated.rig_trial import RigCase, RigOutcome, press

ACCELERATIONS, STOPS = (10.0, 50.0, 500.0), (1.0, 20.0, 100.0, 1000.0)
CELLS = ((80.0, 0.0), (80.0, 0.1), (10.0, 0.5))
SPEEDS = (1.0, 5.0, 20.0)
QUICK = ((10.0,), (20.0, 1000.0), ((80.0, 0.0), (10.0, 0.5)), (5.0, 20.0))


def main() -> None:
    """Press all cases and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="the drive of a fresh GRBL, 8 rigs")
    parser.add_argument("--model", action="store_true", help="explore all runs of the safety core instead")
    options = parser.parse_args()
    if options.model:
        found = explore(broken_property)
        print(f"{found.runs} runs, {found.states} states, {len(found.broken)} break a property")
        return
    print("| mm/s² | stop, N/mm | cell, Hz | late, s | mm/s | bound, N | largest, N | ends | what the operator reads |")
    print("|" + "---|" * 9)
    outcomes = []
    grid = QUICK if options.quick else (ACCELERATIONS, STOPS, CELLS, SPEEDS)
    for a, stop_N_mm, (rate_Hz, late_s), speed in itertools.product(*grid):
        law = ForceLaw(stop_mm=0.5, stop_N_mm=stop_N_mm)
        case = RigCase(a, law, 1.2, rate_Hz, late_s, approach_mm=1.1)
        outcome = press(case, ramps([1.4], speed, rest_s=0.5))
        outcomes.append((outcome, bound_N(case)))
        print(_row(case, speed, outcome), flush=True)
    worst = max(outcome.largest_N for outcome, _ in outcomes)
    above = sum(outcome.largest_N > bound for outcome, bound in outcomes)
    left = sum(not outcome.is_up for outcome, _ in outcomes)
    print(f"\n{len(outcomes)} rigs: largest force {worst:.1f} N, {above} above their bound, {left} not lifted.")


def bound_N(case: RigCase) -> float:
    """Return the force a stop ends at, at most, where a stop as stiff as the station reckons with is met."""
    reaction = Reaction(1.0 / case.cell_Hz + LATEST_S + REACTION_S, case.acceleration_mm_s2)
    ceiling_N = FULL * case.capacity_N
    bounds = ForceBounds(reaction, case.limit_N, 0.3, ceiling_N, case.stiffest_N_mm)
    return bounds.worst_N(bounds.unknown_mm_s, case.limit_N, case.law.stop_N_mm + 2.0)


def _row(case: RigCase, speed: float, outcome: RigOutcome) -> str:
    ends = "done" if not outcome.message else "lifted" if outcome.is_up else "on the unit"
    said = outcome.message.split(";")[0].replace("|", "/") or "–"
    rig = f"{case.acceleration_mm_s2:g} | {case.law.stop_N_mm:g} | {case.cell_Hz:g} | {case.cell_late_s:g}"
    return f"| {rig} | {speed:g} | {bound_N(case):.1f} | {outcome.largest_N:.2f} | {ends} | {said} |"


if __name__ == "__main__":
    main()
