"""Synchronise a station's whole registry with the line's PostgreSQL, cut off by kill -9 in the middle, and go on.

    python benchmarks/registry_sync.py [--quick] [--units 1000 10000] [--kills 2]

The command is `softcal registry sync`, as a user runs it. `rows before the kill` were kept by the commands that were
killed; `rows after it` came with the one that was let end; `lost` and `doubled` are rows of the audit trail that the
line lacks or has more than once; `again` is one more run, which has nothing to do.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from registry_common import fresh_url, print_markdown
from registry_list import fill
from sqlalchemy import Connection, func, select
from sqlalchemy.exc import DBAPIError

from softcal.core.errors import RegistryError
from softcal.db.connection import open_registry
from softcal.db.schema.tables import audit

HEADER = (
    "units",
    "rows",
    "kills",
    "rows before the kill",
    "rows after it",
    "lost",
    "doubled",
    "faults of verify --quick",
    "s until the kills",
    "s after them",
    "s again",
    "rows/s",
)
LOOK_EVERY_S = 0.2


def rows_of(url: str) -> set[tuple[str, int, str]]:
    """Return chain, number and hash of every row of the audit trail; none where there are no tables yet."""
    try:
        with open_registry(url, create=False) as registry, registry.database.reading() as connection:
            return {tuple(row) for row in connection.execute(select(audit.c.origin, audit.c.seq, audit.c.hash))}
    except RegistryError:
        return set()


def _count(connection: Connection) -> int:
    return int(connection.execute(select(func.count()).select_from(audit)).scalar_one())


def command(here: str, there: str) -> list[str]:
    """Return the command line of a synchronisation."""
    return [str(Path(sys.executable).with_name("softcal")), "registry", "sync", "--registry", here, "--with", there]


def killed_at(here: str, there: str, rows: int) -> None:
    """Run the command and kill it once the other side has so many rows of the trail."""
    with subprocess.Popen(command(here, there), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        with open_registry(there) as registry:
            while process.poll() is None:
                try:
                    with registry.database.reading() as connection:
                        count = _count(connection)
                except DBAPIError:
                    count = 0
                if count >= rows:
                    process.kill()
                time.sleep(LOOK_EVERY_S)
        if process.returncode >= 0:
            raise SystemExit(f"the synchronisation ended with {process.returncode} before it was killed")


def measure(units: int, kills: int) -> tuple[object, ...]:
    """Fill a registry, synchronise it with kills on the way, and compare."""
    with tempfile.TemporaryDirectory(prefix="softcal-bench-") as folder, fresh_url("PostgreSQL") as full:
        here, there = f"sqlite:///{Path(folder) / 'station.db'}", full.replace("+psycopg", "")
        with open_registry(here) as registry:
            fill(registry, units)
        wanted = rows_of(here)
        start_s = time.perf_counter()
        for k in range(kills):
            killed_at(here, there, len(wanted) * (k + 1) // (kills + 1))
        until_s = time.perf_counter() - start_s
        before = len(rows_of(there))
        after_s, report = _ran(here, there)
        again_s, nothing = _ran(here, there)
        if nothing["sent"] or nothing["received"]:
            raise SystemExit(f"the second run had something to do: {nothing}")
        found = rows_of(there)
        with open_registry(there, create=False) as registry:
            faults = registry.verify(is_quick=True)
            with registry.database.reading() as connection:
                doubled = _count(connection) - len(found)
        speed = (len(wanted) - before) / after_s
        counts = before, report["sent"], len(wanted - found), doubled, len(faults)
        return units, len(wanted), kills, *counts, until_s, after_s, again_s, speed


def _ran(here: str, there: str) -> tuple[float, dict[str, int]]:
    start_s = time.perf_counter()
    done = subprocess.run([*command(here, there), "--json", "-"], capture_output=True, text=True, env=os.environ)
    if done.returncode:
        raise SystemExit(done.stderr)
    return time.perf_counter() - start_s, json.loads(done.stdout)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="100 units")
    parser.add_argument("--units", type=int, nargs="+", default=[1_000, 10_000])
    parser.add_argument("--kills", type=int, default=2)
    options = parser.parse_args()
    sizes = [100] if options.quick else sorted(options.units)
    print_markdown(HEADER, (measure(units, options.kills) for units in sizes))


if __name__ == "__main__":
    main()
