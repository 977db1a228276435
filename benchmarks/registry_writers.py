"""Eight processes write to one registry for a minute, half of them the history of one and the same unit.

    python benchmarks/registry_writers.py [--quick] [--writers 8] [--seconds 60]

An update is lost when an acknowledged revision is not in the history afterwards. Every write reads the newest revision
first, stores arrays, a row and its audit row, and is on disk when it is acknowledged.
"""

import argparse
import multiprocessing
import time
from multiprocessing.synchronize import Barrier

import numpy as np
from common.registries import DATABASES, begin_lot, database_of, fresh_url, record
from common.tables import print_table

from softcal.db.connection import open_registry

Written = list[tuple[str, int, float]]
HEADER = (
    "database",
    "writers",
    "s",
    "writes",
    "writes/s",
    "errors",
    "lost",
    "median ms",
    "99 % ms",
    "worst ms",
    "faults",
)


_together: Barrier


def start_together(barrier: Barrier) -> None:
    """Keep the barrier that all writers pass at once."""
    global _together
    _together = barrier


def write(arguments: tuple[str, str, int, float]) -> tuple[Written, list[str]]:
    """Write for some seconds; return what was acknowledged with its latency, and the errors."""
    url, network_id, writer, seconds = arguments
    written: Written = []
    errors: list[str] = []
    serial = "SHARED" if writer % 2 else f"OWN{writer}"
    with open_registry(url, create=False) as registry:
        _together.wait()
        until_s = time.perf_counter() + seconds
        for number in range(10_000_000):
            start_s = time.perf_counter()
            if start_s >= until_s:
                return written, errors
            try:
                revision = registry.calibrations.add("bench", record(serial, writer * 1_000_000 + number, network_id))
                written.append((serial, revision, time.perf_counter() - start_s))
            except Exception as error:
                errors.append(str(error))
    return written, errors


def measure(kind: str, writers: int, seconds: float) -> tuple[object, ...]:
    """Run all writers on a fresh registry, then compare what was acknowledged with what is there."""
    with fresh_url(kind) as url:
        with open_registry(url) as registry:
            network_id = begin_lot(registry)
        context = multiprocessing.get_context("spawn")
        with context.Pool(writers, start_together, (context.Barrier(writers),)) as pool:
            answers = pool.map(write, [(url, network_id, k, seconds) for k in range(writers)], chunksize=1)
        acknowledged = [(serial, revision) for written, _ in answers for serial, revision, _ in written]
        latencies_ms = 1e3 * np.array([latency for written, _ in answers for *_, latency in written])
        errors = [error for _, failed in answers for error in failed]
        with open_registry(url, create=False) as registry:
            kept = {
                (s, c.revision)
                for s in {serial for serial, _ in acknowledged}
                for c in registry.calibrations.history(s)
            }
            faults = registry.verify()
    lost = len(acknowledged) - len(set(acknowledged) & kept)
    median, high, worst = np.percentile(latencies_ms, [50, 99, 100])
    count = len(acknowledged)
    speed = count / seconds
    numbers = (count, speed, len(errors), lost, float(median), float(high), float(worst), len(faults))
    return (database_of(kind), writers, seconds, *numbers)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="three seconds instead of a minute")
    parser.add_argument("--writers", type=int, default=8)
    parser.add_argument("--seconds", type=float, default=60.0)
    options = parser.parse_args()
    seconds = 3.0 if options.quick else options.seconds
    print_table(HEADER, (measure(kind, options.writers, seconds) for kind in DATABASES))


if __name__ == "__main__":
    main()
