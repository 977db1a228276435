"""How long a person waits for a registry of 10,000 units: list, one unit, verify, backup, first synchronisation.

python benchmarks/registry_list.py [--quick] [--units 1000 10000] [--databases SQLite PostgreSQL]
"""

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from common.registries import DATABASES, begin_lot, fresh_url, record
from common.tables import print_table

from softcal.db.care.backup import back_up
from softcal.db.care.sync import synchronise
from softcal.db.connection import open_registry
from softcal.db.registry import Registry

CHUNK = 100


def timed(action: Callable[[], object], times: int = 1) -> float:
    """Return the median of a few runs in seconds."""
    seconds = []
    for _ in range(times):
        start_s = time.perf_counter()
        action()
        seconds.append(time.perf_counter() - start_s)
    return statistics.median(seconds)


def fill(registry: Registry, units: int) -> None:
    """Register calibrated units, a hundred per transaction as `batch` does."""
    network_id = begin_lot(registry)
    for start in range(0, units, CHUNK):
        with registry.transaction():
            for number in range(start, min(start + CHUNK, units)):
                registry.calibrations.add("bench", record(f"U{number:06d}", number, network_id))


def measure(kind: str, units: int) -> tuple[object, ...]:
    """Fill a registry and measure what a person waits for."""
    with fresh_url(kind) as url, open_registry(url) as registry, tempfile.TemporaryDirectory() as folder:
        fill_s = timed(lambda: fill(registry, units))
        list_s = timed(lambda: registry.lots.units("bench"), 5)
        unit_s = timed(lambda: registry.calibrations.get(f"U{units // 2:06d}"), 21)
        quick_s = timed(lambda: registry.verify(is_quick=True), 5)
        verify_s = timed(registry.verify)
        backup = Path(folder) / "backup.db"
        backup_s = timed(lambda: back_up(registry.database, backup))
        size_MB = backup.stat().st_size / 1e6
        sync_s = synchronise_s(registry)
    return kind, units, units / fill_s, 1e3 * list_s, 1e3 * unit_s, quick_s, verify_s, backup_s, size_MB, sync_s


def synchronise_s(registry: Registry) -> float:
    """Return the seconds of a first synchronisation into an empty PostgreSQL registry."""
    with fresh_url("PostgreSQL") as other_url, open_registry(other_url) as other:
        return timed(lambda: synchronise(registry, other))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="500 units instead of 1,000 and 10,000")
    parser.add_argument("--units", type=int, nargs="+", default=[1_000, 10_000])
    parser.add_argument("--databases", nargs="+", choices=DATABASES, default=list(DATABASES))
    options = parser.parse_args()
    header = ("database", "units", "registered/s", "list ms", "one unit ms", "verify --quick s",
              "verify s", "backup s", "backup MB", "first sync to PostgreSQL s")  # fmt: skip
    sizes = [500] if options.quick else sorted(options.units)
    print_table(header, (measure(kind, units) for kind in options.databases for units in sizes))


if __name__ == "__main__":
    main()
