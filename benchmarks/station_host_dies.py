"""What still runs out when the host dies in the worst place: just above, and just in, a hard stop nobody has felt yet.

python benchmarks/station_host_dies.py [--quick]
"""

import argparse
import itertools

from common.rig_trial import ForceLaw, RigCase, press_until_gone

from softcal.core.profiles import ramps
from softcal.station.devices.config import UNKNOWN_S
from softcal.station.tasks.seconds import FEELING

STOP_MM = 0.5
PLACES_MM = (-0.02, -0.005, -0.002, 0.0, 0.001, 0.002, 0.003)
"""Where the host dies, against the stop; deeper the force limit has stopped the stage."""

SEARCHING = "searching for contact"


def main() -> None:
    """Let the host die everywhere and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one drive, two stops")
    quick = parser.parse_args().quick
    print("| mm/s² | stop, N/mm | latency stated, s | host dies | largest force, N | goal, N |")
    print("|---|---|---|---|---|---|")
    grid = ((10.0,), (100.0, 1000.0)) if quick else ((10.0, 50.0, 500.0), (20.0, 100.0, 1000.0))
    for a, stop_N_mm, latency_s in itertools.product(*grid, (0.0, UNKNOWN_S)):
        stated = "not" if latency_s == UNKNOWN_S else f"{latency_s:g}"
        for where, phase, stop_mm in (("in the first press", FEELING, STOP_MM), ("in the search", SEARCHING, 0.0)):
            law = ForceLaw(stop_mm=stop_mm, stop_N_mm=stop_N_mm)
            case = RigCase(a, law, 1.2, latency_s=latency_s, approach_mm=1.1)
            deaths = (press_until_gone(case, ramps([1.4], 8.0), phase, stop_mm + mm) for mm in PLACES_MM)
            largest_N = max(force_N for force_N in deaths if force_N is not None)
            print(f"| {a:g} | {stop_N_mm:g} | {stated} | {where} | {largest_N:.2f} | 18 |", flush=True)


if __name__ == "__main__":
    main()
