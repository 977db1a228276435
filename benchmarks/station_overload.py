"""Run into the force limit at several speeds and print by how much the force overshoots it.

python benchmarks/station_overload.py [--quick]
"""

import argparse
from dataclasses import replace

from softcal.core.errors import SafetyStop
from softcal.core.profiles import ramps
from softcal.core.twin.parameters import BaseParameters
from softcal.core.twin.simulate import Twin
from softcal.station.devices.bench import open_simulated_bench
from softcal.station.tasks.acquisition import record

LIMIT_N = 5.0
SEEDS = 3
UNITS = {
    "nominal unit": Twin(),
    "stiff unit": Twin(BaseParameters(k1_N_mm=6.0, k3_N_mm3=0.5)),
    "unit with a hard stop": Twin(BaseParameters(k1_N_mm=1.0, k3_N_mm3=2.0)),
}


def main() -> None:
    """Press every unit too deep at every speed and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="two speeds, one unit")
    quick = parser.parse_args().quick
    print(
        f"Force limit {LIMIT_N:g} N; load cell at 80 samples a second with delays of up to 0.1 s; worst of {SEEDS}.\n"
    )
    print(
        "| under the stage | speed, mm/s | force rate at the limit, N/s | largest force, N | overshoot, N | stopped |"
    )
    print("|---|---|---|---|---|---|")
    for name, unit in list(UNITS.items())[: 1 if quick else None]:
        for speed_mm_s in (2.0, 10.0) if quick else (1.0, 2.0, 5.0, 10.0):
            print(_row(name, unit, speed_mm_s))


def _row(name: str, unit: Twin, speed_mm_s: float) -> str:
    force_N, stopped = max(_press(unit, speed_mm_s, seed) for seed in range(SEEDS))
    rate_N_s = _stiffness_N_mm(unit) * speed_mm_s
    return f"| {name} | {speed_mm_s:g} | {rate_N_s:.0f} | {force_N:.2f} | {force_N - LIMIT_N:+.2f} | {stopped} |"


def _press(unit: Twin, speed_mm_s: float, seed: int) -> tuple[float, str]:
    with open_simulated_bench(unit, seed=seed) as (bench, station):
        config = replace(bench.config, safety=replace(bench.config.safety, force_N=LIMIT_N))
        try:
            record(replace(bench, config=config), "A1", ramps([4.0], speed_mm_s, rest_s=0.3), with_reference=False)
            stopped = "no"
        except SafetyStop:
            stopped = "yes"
        return station.rig.largest_force_N, stopped


def _stiffness_N_mm(unit: Twin) -> float:
    """Slope of F = k1·δ + k3·δ³ where F is the limit."""
    k1, k3 = unit.parameters.k1_N_mm, unit.parameters.k3_N_mm3
    low, high = 0.0, 10.0
    while high - low > 1e-9:
        middle = (low + high) / 2
        low, high = (middle, high) if k1 * middle + k3 * middle**3 < LIMIT_N else (low, middle)
    return k1 + 3 * k3 * low**2


if __name__ == "__main__":
    main()
