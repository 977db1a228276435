"""Press unit after unit for a simulated shift and print throughput, lost samples and memory.

python benchmarks/station_soak.py [--hours H] [--quick]
"""

import argparse
import resource
import time

import numpy as np

from softcal.core.profiles import unit_profile
from softcal.core.twin.spread import draw_lot
from softcal.station.acquisition import record
from softcal.station.bench import open_simulated_bench


def main() -> None:
    """Press until the shift is over."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=1.0, help="simulated hours (default 1)")
    parser.add_argument("--quick", action="store_true", help="a tenth of an hour")
    options = parser.parse_args()
    rng, began_s = np.random.default_rng(1), time.perf_counter()
    samples, lost, units, memory_MB = 0, 0, 0, []
    with open_simulated_bench(draw_lot(rng, 1)[0], seed=1) as (bench, station):
        while bench.clock.now_s() < 3600 * (0.1 if options.quick else options.hours):
            station.mount(draw_lot(rng, 1)[0])
            recording = record(bench, f"U{units}", unit_profile(rng), with_reference=False)
            samples, lost, units = samples + len(recording.t_s), lost + recording.lost, units + 1
            memory_MB.append(_resident_MB())
        hours = bench.clock.now_s() / 3600
    late_MB = memory_MB[-1] - memory_MB[len(memory_MB) // 5]
    print(
        "| simulated h | units | s per unit | units per h | samples | lost | memory now, MB | grown since a fifth, MB |"
    )
    print("|---|---|---|---|---|---|---|---|")
    print(
        f"| {hours:.2f} | {units} | {3600 * hours / units:.1f} | {units / hours:.0f} | {samples} | {lost} | "
        f"{memory_MB[-1]:.1f} | {late_MB:+.1f} |"
    )
    print(
        f"\nTook {time.perf_counter() - began_s:.0f} s of real time; peak memory "
        f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB."
    )


def _resident_MB() -> float:
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize() / 2**20


if __name__ == "__main__":
    main()
