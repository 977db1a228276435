"""How well sensor, load cell and stage meet on one time axis, for lines that are late by 0.04 ms to more than 100 ms.

python benchmarks/station_time.py [--quick]

Recorded force and output are compared in time with those of the twin at the recorded stage position: what is left is
the error of the alignment. Device clocks are off by a tenth of a per cent, some lines are lost or come twice, and the
readout's millis() wraps in the middle of the run.
"""

import argparse

import numpy as np

from softcal.core.profiles import unit_profile
from softcal.core.twin.simulate import Twin, simulate
from softcal.station.clock import residual_offset_s
from softcal.station.devices.bench import open_simulated_bench
from softcal.station.tasks.acquisition import record

LINES = {
    "0.04 ms": (0.00004, 0.0, 0.0),
    "1 ms and 2 ms at random, stalls up to 100 ms": (0.001, 0.002, 0.1),
    "1 ms and 10 ms at random, stalls up to 100 ms": (0.001, 0.010, 0.1),
    "1 ms and 20 ms at random, stalls up to 100 ms": (0.001, 0.020, 0.1),
}
"""Least delay, mean of the random one and longest stall in s; a delay on top reaches several times its mean."""


def main() -> None:
    """Press on every kind of line and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one run for each kind of line")
    seeds = range(1 if parser.parse_args().quick else 5)
    print("| lines come late by | median, ms | force off by, ms | output off by, ms | stage off by, mm |")
    print("|---|---|---|---|---|")
    for name, delays in LINES.items():
        runs = np.array([_run(delays, seed) for seed in seeds])
        late, force, output, stage = np.max(np.abs(runs), axis=0)
        print(f"| {name} | {1e3 * late:.1f} | {1e3 * force:.1f} | {1e3 * output:.1f} | {stage:.3f} |", flush=True)


def _run(delays: tuple[float, float, float], seed: int) -> tuple[float, float, float, float]:
    with open_simulated_bench(Twin(), seed) as (bench, station):
        for wire in (station.stage_wire, station.force_wire, station.readout_wire):
            wire.delay_s, wire.jitter_s, wire.stall_s = delays
        station.readout_wire.loss = station.readout_wire.repeat = 0.002
        station.readout.device_ms = 2.0**32 - 25_000
        profile = unit_profile(np.random.default_rng(seed), 30.0)
        recording = record(bench, "A1", profile, with_reference=True)
        surface_mm = recording.contact_mm - bench.config.fixture.clearance_mm - station.rig.clearance_mm
        late_s = max(recording.alignment.sensor_late_s, recording.alignment.force_late_s)
    force_N, output_V = simulate(Twin(), recording.t_s, recording.stage_mm + surface_mm)
    grid_s = np.arange(0.0, recording.t_s[-1], 1 / recording.sample_rate_Hz)
    pairs = ((force_N, recording.force_N), (output_V, recording.output[:, 0]))
    force_s, output_s = (
        residual_offset_s(np.interp(grid_s, recording.t_s, true), np.interp(grid_s, recording.t_s, seen), 50.0)
        for true, seen in pairs
    )
    return late_s, force_s, output_s, recording.alignment.stage_residual_mm


if __name__ == "__main__":
    main()
