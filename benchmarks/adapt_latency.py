"""What following costs, sample by sample on the wall clock: estimates, maps, new uses learnt, writes to the registry.

python benchmarks/adapt_latency.py
"""

import resource
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from adapt_common import Unit, calibrate, print_markdown
from simulated_gait import RATE_HZ, Drift, Sensor, Walk, walk

from softcal.app.use.adapt import AdaptOptions, Follower, UnitInUse
from softcal.core.lot import Lot
from softcal.core.network.config import NetworkConfig
from softcal.core.recording import Array
from softcal.core.use.adapter import AdaptConfig
from softcal.core.use.method import UseMethod
from softcal.db.connection import open_registry

BATCH = UseMethod().intake.batch

SECONDS = 240.0
CHECKPOINT_S = 5.0
"""Twelve times as often as in use, so that the writes are seen."""


def stream(rng: np.random.Generator) -> tuple[Array, Array]:
    """Return a walk that becomes a run that was never seen, on a sensor that drifts."""
    sensor = Sensor(rng, Drift(lambda t_s: 1 - 0.15 * t_s / SECONDS, lambda t_s: 0.2 * t_s / SECONDS))
    run = Walk(stride_s=0.7, body_N=1.6, variation=0.06)
    return sensor.read(np.concatenate([walk(SECONDS / 2, rng), walk(SECONDS / 2, rng, run)]))


def steps_ms(unit: Unit, t_s: Array, output_V: Array) -> dict[str, list[float]]:
    """Return what single samples took, by what happened in them."""
    adapter = unit.adapter("improved")
    names = ("any", "ends a batch", "ends a batch with a new map", "learns a use")
    taken: dict[str, list[float]] = {name: [] for name in names}
    adapter.take_updates()
    for k, (time_s, value) in enumerate(zip(t_s.tolist(), output_V.tolist(), strict=True)):
        start_s = time.perf_counter()
        adapter.step(time_s, value)
        spent_ms = 1e3 * (time.perf_counter() - start_s)
        taken["any"].append(spent_ms)
        if (k + 1) % BATCH:
            continue
        taken["ends a batch"].append(spent_ms)
        for update in adapter.take_updates():
            taken["learns a use" if "learnt" in update.reason else "ends a batch with a new map"].append(spent_ms)
    return taken


def kept_ms(unit: Unit, t_s: Array, output_V: Array, registry_url: str) -> list[float]:
    """Return what single samples took while every map and state went to a registry."""
    options = AdaptOptions(AdaptConfig(), stream="latency", checkpoint_s=CHECKPOINT_S)
    spent_ms = []
    with open_registry(registry_url, create=True) as registry, ThreadPoolExecutor(1) as keeper:
        lot = Lot("latency", "unit", RATE_HZ)
        registry.add_lot(lot)
        registry.add_recording(lot.id, unit.source, "source")
        registry.add_network(lot.id, unit.network, {}, {}, "")
        record = unit.calibration.to_record(input_sha256="", recording_sha256=unit.source.sha256)
        revision = registry.add_calibration(lot.id, record, reason="benchmark")
        in_use = UnitInUse(lot, revision, unit.network, unit.calibration, unit.source.unlabelled)
        follower = Follower(registry, in_use, "latency", options, keeper)
        for place in range(len(t_s)):
            start_s = time.perf_counter()
            follower.advance(t_s[place : place + 1], output_V[place : place + 1])
            follower.keep()
            spent_ms.append(1e3 * (time.perf_counter() - start_s))
        follower.settle()
    return spent_ms


def main() -> None:
    rng = np.random.default_rng(4)
    force_N = walk(180.0, rng)
    unit = calibrate(*Sensor(rng).read(force_N), force_N, RATE_HZ, NetworkConfig(hidden=(40, 20), max_epochs=40))
    t_s, output_V = stream(rng)
    rows = {name: values for name, values in steps_ms(unit, t_s, output_V).items() if values}
    with tempfile.TemporaryDirectory() as folder:
        rows["any, maps and states to SQLite"] = kept_ms(unit, t_s, output_V, f"sqlite:///{Path(folder) / 'r.db'}")
    print_markdown(
        ["one sample that", "samples", "median [ms]", "99th percentile [ms]", "largest [ms]", "over 20 ms"],
        [
            [name, len(ms), *(float(v) for v in np.quantile(ms, (0.5, 0.99, 1.0))), int(np.sum(np.array(ms) > 20))]
            for name, ms in rows.items()
        ],
    )
    adapter = unit.adapter("improved")
    memory_kB = []
    start_s = time.perf_counter()
    for _ in range(20):
        adapter.advance(t_s, output_V)
        adapter.take_updates()
        t_s = t_s + SECONDS
        memory_kB.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    rate = 20 * len(t_s) / (time.perf_counter() - start_s)
    print(f"\nwhole arrays: {rate:,.0f} estimates per second on the wall clock")
    print(f"peak memory after each 60,000 samples [kB]: {', '.join(str(kB) for kB in memory_kB[4::5])}")


if __name__ == "__main__":
    main()
