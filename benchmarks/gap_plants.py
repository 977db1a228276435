"""Drawn simulators with a badly kept rig: is a cause named that each run may have of its own, and is the true one?

    python benchmarks/gap_plants.py                    10 plants that chose nothing
    python benchmarks/gap_plants.py --first 6000       others

Each plant is a lag, with or without a ringing part, an own zero and a bent sensor. Every run is late by up to 0.1 s and
has a zero, a gain and a drift of its own; all four are stated as allowed. On the last line the true cause, a cubic
drive, has no candidate, and a dead band resembles it: right is `unknown`. Plants 0 to 13, 200 to 209 and 900 to 904
chose constants or are used by tests. Plants from 5000 on chose nothing.
"""

import argparse
import importlib
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from softcal.core.gap.simulator_diagnosis import SimulatorDiagnosis, diagnose_simulator

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "core"))
drawn = importlib.import_module("test_gap_own_of_runs")

LINES = {"a curve, noise 0.4 %": (0.004, False), "straight lines, noise 0.05 %": (0.0005, True)}
"""How a late clock shifts a channel between its samples, and how much noise there is."""

HIDDEN = ("none", "cubic", "slow_part", "late")


def outcome(found: SimulatorDiagnosis, true: set[str], is_blind: bool = False) -> str:
    """Return right, set, honest, missed or wrong; right for a cause without a candidate is that nothing explains it."""
    if is_blind:
        return "wrong" if drawn.named(found) else "right" if found.verdict == "unknown" else "missed"
    if found.verdict == "ambiguous" and true and true <= drawn.named(found):
        return "set"
    if drawn.named(found) == true and found.verdict == ("explained" if true else "no_gap"):
        return "right"
    if drawn.named(found) - true:
        return "wrong"
    return "honest" if found.verdict == "unknown" else "missed"


def judged(first: int, count: int) -> Iterator[tuple[str, str, int, str]]:
    """Yield line, hidden cause, plant and outcome."""
    for seed in range(first, first + count):
        for line, (noise, is_straight) in LINES.items():
            for hidden in HIDDEN:
                plant = drawn.Plant(seed)
                found = diagnose_simulator(plant.simulator, plant.recorded(noise, is_straight, drawn.CAUSES[hidden]))
                yield line, hidden, seed, outcome(found, {hidden} - {"none", *drawn.ALIASES})
        yield "no candidate for it", "cubic", seed, outcome(drawn.blind(seed), set(), is_blind=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=5000, help="first plant drawn")
    parser.add_argument("--count", type=int, default=10, help="how many plants")
    options = parser.parse_args()
    counts: dict[tuple[str, str], Counter[str]] = {}
    wrong = []
    for line, hidden, seed, told in judged(options.first, options.count):
        counts.setdefault((line, hidden), Counter())[told] += 1
        wrong += [f"plant {seed}, {line}, {hidden}"] if told == "wrong" else []
    words = ("right", "set", "honest", "missed", "wrong")
    print(f"| delay between samples | hidden | {' | '.join(words)} |\n|{'---|' * (len(words) + 2)}")
    for (line, hidden), count in counts.items():
        print(f"| {line} | {hidden} | {' | '.join(str(count[word]) for word in words)} |")
    print("\nwrong: " + ("; ".join(wrong) or "none"))


if __name__ == "__main__":
    main()
