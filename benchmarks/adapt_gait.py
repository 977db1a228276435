"""A million samples of simulated gait with drift of gain and offset, creep and re-seating; cost of following it.

python benchmarks/adapt_gait.py [--quick]
"""

import argparse
import json
import resource
import time

import numpy as np
from adapt_common import Unit, calibrate, print_markdown
from simulated_gait import RATE_HZ, Drift, Sensor, pieces, walk

from softcal.core.network.config import NetworkConfig
from softcal.core.recording import Array
from softcal.core.use.method import UseMethod

BATCH = UseMethod().intake.batch

SEGMENTS = 10
RECOVERY_S = 20.0
"""Left out after each re-seating in the column that says so."""


def drift_over(seconds: float, seats_s: Array, rng: np.random.Generator) -> Drift:
    """Gain falls by a fifth with a swing on it, offset creeps up, and every re-seating moves both at once."""
    gains, offsets_V = 1 + rng.normal(0, 0.04, len(seats_s)), rng.normal(0, 0.06, len(seats_s))

    def gain(t_s: Array) -> Array:
        slow = 1 - 0.2 * t_s / seconds + 0.02 * np.sin(14 * np.pi * t_s / seconds)
        return np.asarray(slow * np.prod(np.where(t_s[:, None] > seats_s, gains, 1.0), axis=1))

    def offset_V(t_s: Array) -> Array:
        creep = 0.02 * np.log1p(t_s / (seconds / 50))
        return np.asarray(0.15 * t_s / seconds + creep + np.sum(np.where(t_s[:, None] > seats_s, offsets_V, 0), axis=1))

    return Drift(gain, offset_V)


def main(samples: int) -> None:
    seconds = samples / RATE_HZ
    rng = np.random.default_rng(9)
    seats_s = np.sort(rng.uniform(0.1, 0.95, 6)) * seconds
    force_N = walk(180.0, rng)
    t_s, output_V = Sensor(rng).read(force_N)
    unit = calibrate(t_s, output_V, force_N, RATE_HZ, NetworkConfig(hidden=(40, 20), max_epochs=60))
    squared, clear, count, clear_count = (np.zeros((2, SEGMENTS)) for _ in range(4))
    adapters = [unit.adapter("none"), unit.adapter("improved")]
    sensor = Sensor(rng, drift_over(seconds, seats_s, rng))
    memory_kB, spent_s, done = [], 0.0, 0
    for size in pieces(samples, 10_000):
        force_N = walk(size / RATE_HZ, rng)
        t_s, output_V = sensor.read(force_N)
        segment = min(SEGMENTS - 1, int(SEGMENTS * (done + size / 2) / samples))
        since_s = t_s[:, None] - seats_s
        is_clear = ~np.any((since_s > 0) & (since_s < RECOVERY_S), axis=1)
        for k, adapter in enumerate(adapters):
            start_s = time.thread_time()
            estimate = adapter.advance(t_s, output_V).estimate
            spent_s += (time.thread_time() - start_s) * k
            error = np.nan_to_num(estimate - force_N) ** 2
            squared[k, segment] += error.sum()
            count[k, segment] += size
            clear[k, segment] += error[is_clear].sum()
            clear_count[k, segment] += is_clear.sum()
        adapters[1].take_updates()
        done += size
        memory_kB.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    whole, apart = np.sqrt(squared / count), np.sqrt(clear / np.maximum(clear_count, 1))
    print_markdown(
        ["tenth", "no adaptation [N]", "improved [N]", f"improved, {RECOVERY_S:g} s after a re-seating left out [N]"],
        [[k + 1, float(whole[0, k]), float(whole[1, k]), float(apart[1, k])] for k in range(SEGMENTS)],
    )
    state_bytes = len(json.dumps(adapters[1].state()))
    print(f"\n{samples} samples, 6 re-seatings; {samples / spent_s:,.0f} estimates per second of processor time")
    ratios = [float(table[1].max() / table[1, 0]) for table in (apart, whole)]
    print(f"worst tenth / first: {ratios[0]:.3f} with re-seatings left out, {ratios[1]:.3f} with them")
    print(
        f"peak memory after the first piece {memory_kB[0]} kB, at the end {memory_kB[-1]} kB; state {state_bytes} bytes"
    )
    print_latency(unit, sensor, rng)


def print_latency(unit: Unit, sensor: Sensor, rng: np.random.Generator) -> None:
    """Print how long one sample takes, with and without the end of a batch, where maps are fitted."""
    adapter = unit.adapter("improved")
    wall_ms, cpu_ms = [], []
    for t_s, output_V in zip(*sensor.read(walk(120.0, rng)), strict=True):
        wall_s, cpu_s = time.perf_counter(), time.thread_time()
        adapter.step(float(t_s), float(output_V))
        wall_ms.append(1e3 * (time.perf_counter() - wall_s))
        cpu_ms.append(1e3 * (time.thread_time() - cpu_s))
    print_markdown(
        ["one sample", "clock", "median [ms]", "99th percentile [ms]", "largest [ms]"],
        [
            [name, clock, *(float(v) for v in np.quantile(times[first::step], (0.5, 0.99, 1.0)))]
            for name, first, step in (("any", 0, 1), ("that ends a batch: new map", BATCH - 1, BATCH))
            for clock, times in (("wall", wall_ms), ("processor", cpu_ms))
        ],
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="100,000 samples instead of 1,000,000")
    main(100_000 if parser.parse_args().quick else 1_000_000)
