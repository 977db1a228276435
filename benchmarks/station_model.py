"""Explore all runs of the safety core: every fault at every step, on the code that moves the real stage.

python benchmarks/station_model.py [--faults N]
"""

import argparse
import time

from common.station_runs import MOST_FAULTS, broken_property, explore

from softcal.station.motion.interlock import TABLE


def main() -> None:
    """Explore with one fault a run, with two, and so on, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--faults", type=int, default=MOST_FAULTS, help=f"in one run (default {MOST_FAULTS})")
    most, transitions = parser.parse_args().faults, sum(len(row.exits) for row in TABLE.values())
    print("| faults in one run | runs | states | transitions | runs that break a property | s |")
    print("|---|---|---|---|---|---|")
    for faults in range(most + 1):
        began_s = time.perf_counter()
        found = explore(broken_property, faults)
        ways = f"{len(found.ways)} of {transitions}"
        took_s = time.perf_counter() - began_s
        print(f"| {faults} | {found.runs} | {found.states} | {ways} | {len(found.broken)} | {took_s:.1f} |", flush=True)
        for broken in found.broken[:5]:
            print(broken)


if __name__ == "__main__":
    main()
