"""kill -9 at random moments of writing: what was acknowledged must be there, and nothing by half.

python benchmarks/registry_kill.py [--quick] [--kills 100] [--seed N]
"""

import argparse
import random
import subprocess
import sys
import time
from pathlib import Path

from registry_common import DATABASES, begin_lot, fresh_url, print_markdown, record

from softcal.db.connection import open_registry


def write_forever(url: str, network_id: str, start: int) -> None:
    """Write calibrations with an event each, in one transaction, and print every one that was acknowledged."""
    with open_registry(url, create=False) as registry:
        for number in range(start, start + 1_000_000):
            serial = f"K{number % 5}"
            with registry.transaction():
                revision = registry.add_calibration("bench", record(serial, number, network_id))
                registry.add_event("export", "exports", (serial, revision), {})
            print(serial, revision, flush=True)


def kill_once(url: str, network_id: str, turn: int, after_s: float) -> list[tuple[str, int]]:
    """Start a writer, kill it some time after its first acknowledgement, and return what it acknowledged."""
    command = [sys.executable, str(Path(__file__)), "--write", url, network_id, str(turn * 1_000_000)]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    first = child.stdout.readline() if child.stdout else ""
    time.sleep(after_s)
    child.kill()
    rest, _ = child.communicate()
    whole = [line.split() for line in (first + rest).splitlines(keepends=True) if line.endswith("\n")]
    return [(serial, int(revision)) for serial, revision in whole]


def measure(kind: str, kills: int, seed: int) -> tuple[object, ...]:
    """Kill writers again and again on one registry, then look what is there."""
    moments = random.Random(seed)
    acknowledged: set[tuple[str, int]] = set()
    with fresh_url(kind) as url:
        with open_registry(url) as registry:
            network_id = begin_lot(registry)
        for turn in range(kills):
            acknowledged |= set(kill_once(url, network_id, turn, moments.uniform(0.0, 0.2)))
        with open_registry(url, create=False) as registry:
            trail = registry.audit_rows()
            kept = {(s, c.revision) for s in {serial for serial, _ in acknowledged} for c in registry.history(s)}
            faults = registry.verify()
    halves = sum(row.action == "calibrate" for row in trail) - sum(row.action == "export" for row in trail)
    return kind, kills, len(acknowledged), len(acknowledged - kept), halves, len(faults)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="3 kills")
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--write", nargs=3, metavar=("URL", "NETWORK", "START"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.write:
        write_forever(options.write[0], options.write[1], int(options.write[2]))
        return
    header = ("database", "kills", "acknowledged", "lost", "half-written", "faults found by verify")
    kills = 3 if options.quick else options.kills
    print_markdown(header, (measure(kind, kills, options.seed) for kind in DATABASES))


if __name__ == "__main__":
    main()
