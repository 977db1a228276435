"""How long `registry verify --quick` takes, as softcal does it, on an SQLite registry of 10,000 and more units.

python benchmarks/registry_quick.py [--quick] [--units 1000 10000 50000]

The rows are put in by SQL, a calibration, statement, recording and four rows of the trail a unit: by the API ten
thousand units take minutes. CPU time is the one to read where the machine is busy. The faults it counts are the trail's
rows that were put in without their hashes; no other check is cut short by them.
"""

import argparse
import contextlib
import sqlite3
import time
from collections.abc import Iterator

import numpy as np
from registry_common import begin_lot, fresh_url, print_markdown, record

from softcal.core.recording import OutputRecording
from softcal.db.connection import open_registry

HEADER = ("units", "rows of the trail", "wall s", "CPU s")
TABLES = ("units", "recordings", "calibrations", "in_use")


def fill(path: str, units: int) -> None:
    """Copy the rows of one unit as many times as units are wanted, each under a serial of its own."""
    with contextlib.closing(sqlite3.connect(path)) as raw:
        for table in TABLES:
            columns = [name for _, name, *_ in raw.execute(f"PRAGMA table_info({table})")]
            shown = ["'U' || k" if name == "serial" else f't."{name}"' for name in columns]
            if table == "recordings":
                shown[columns.index("sha256")] = "printf('%064d', k)"
            names = ", ".join(f'"{name}"' for name in columns)
            raw.execute(
                f"WITH RECURSIVE n(k) AS (SELECT 1 UNION ALL SELECT k + 1 FROM n WHERE k < {units - 1}) "
                f"INSERT INTO {table} ({names}) SELECT {', '.join(shown)} FROM n, {table} t WHERE t.serial = 'A1'"
            )
        (last,) = raw.execute("SELECT max(seq) FROM audit").fetchone()
        for number, table in enumerate(TABLES):
            raw.execute(
                f"WITH RECURSIVE n(k) AS (SELECT 1 UNION ALL SELECT k + 1 FROM n WHERE k < {units - 1}) "
                f"INSERT INTO audit SELECT origin, {last} + 4 * k - {number}, at, actor, action, '{table}', "
                f"'[\"bench\",\"U' || k || '\"]', before, after, reason, prev_hash, hash "
                f"FROM n, audit t WHERE t.seq = {last}"
            )
        raw.commit()


def rows(sizes: list[int]) -> Iterator[tuple[object, ...]]:
    """Fill a registry of each size and verify it quickly; the median of five."""
    for units in sizes:
        with fresh_url("SQLite") as url:
            with open_registry(url) as registry:
                network_id = begin_lot(registry)
                output = np.random.default_rng(0).normal(size=1250)
                registry.add_recording("bench", OutputRecording("A1", np.arange(1250) / 50.0, output, 50.0), "unit")
                registry.add_calibration("bench", record("A1", 1, network_id))
            fill(url.removeprefix("sqlite:///"), units)
            walls, cpus = [], []
            for _ in range(5):
                with open_registry(url, create=False) as registry:
                    wall_s, cpu_s = time.perf_counter(), time.process_time()
                    registry.verify(is_quick=True)
                    walls.append(time.perf_counter() - wall_s)
                    cpus.append(time.process_time() - cpu_s)
                    trail = sum(seq for seq, _ in registry.heads().values())
            yield units, trail, sorted(walls)[2], sorted(cpus)[2]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="500 units")
    parser.add_argument("--units", type=int, nargs="+", default=[1_000, 10_000, 50_000])
    options = parser.parse_args()
    print_markdown(HEADER, rows([500] if options.quick else sorted(options.units)))


if __name__ == "__main__":
    main()
