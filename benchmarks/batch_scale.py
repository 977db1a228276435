"""A batch of many units of 1,250 samples: wall time, units/s, peak memory, and how the cost grows with the lot.

    python benchmarks/batch_scale.py [--quick] [--units 1000 10000] [--case SQLite:local:2 ...]

Each case is `softcal batch` as a user runs it, on a fresh registry that holds the trained network; wall time includes
the start of the program. Memory is the largest that the command's process and any worker of it ever held (VmHWM).
The last two columns are the cost of this lot over that of the smallest lot of the same case. On a machine that is busy
with other work the CPU time is the one to compare.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from batch_lot import make_lot
from registry_common import fresh_url, print_markdown

DATABASES, ENGINES, WORKERS = ("SQLite", "PostgreSQL"), ("local", "dask"), (1, 2)
CASES = tuple(f"{database}:{engine}:{jobs}" for database in DATABASES for engine in ENGINES for jobs in WORKERS)
HEADER = (
    "registry",
    "engine",
    "workers",
    "units",
    "wall s",
    "units/s",
    "CPU s",
    "MB command",
    "MB worker",
    "MB registry",
    "wall ratio",
    "CPU ratio",
)
SOFTCAL = str(Path(sys.executable).with_name("softcal"))


class Memory:
    """Looks at a process and its descendants ten times a second and keeps the largest VmHWM of each."""

    def __init__(self, pid: int) -> None:
        self._root, self.peaks_MB = pid, dict[int, float]()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)
        self._thread.start()

    def stop(self) -> tuple[float, float]:
        """Return the peak of the process itself and the largest peak among its descendants, in MB."""
        self._ended.set()
        self._thread.join()
        others = [peak for pid, peak in self.peaks_MB.items() if pid != self._root]
        return self.peaks_MB.get(self._root, 0.0), max(others, default=0.0)

    def _look(self) -> None:
        while not self._ended.wait(0.1):
            for pid in _descendants(self._root):
                for line in _lines(Path(f"/proc/{pid}/status")):
                    if line.startswith("VmHWM"):
                        self.peaks_MB[pid] = int(line.split()[1]) / 1024


def _descendants(root: int) -> list[int]:
    found = [root]
    for pid in found:
        # A child hangs on the thread that started it.
        for children in Path(f"/proc/{pid}/task").glob("*/children"):
            found += [int(child) for line in _lines(children) for child in line.split()]
    return found


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text().splitlines()
    except (FileNotFoundError, ProcessLookupError):
        return []


def softcal(*arguments: str) -> tuple[float, float, tuple[float, float]]:
    """Run a command; return wall seconds, CPU seconds of it and its children, and their peak memory."""
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    before, start_s = os.times(), time.perf_counter()
    with subprocess.Popen(
        [SOFTCAL, *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment
    ) as process:
        memory = Memory(process.pid)
        code = process.wait()
        peaks = memory.stop()
    wall_s, after = time.perf_counter() - start_s, os.times()
    if code not in (0, 1):
        raise SystemExit(f"softcal {' '.join(arguments)} ended with {code}")
    cpu_s = after.children_user + after.children_system - before.children_user - before.children_system
    return wall_s, cpu_s, peaks


def size_MB(url: str) -> float | str:
    """Return the size of an SQLite registry with its log."""
    path = Path(url.removeprefix("sqlite:///"))
    return sum(part.stat().st_size for part in path.parent.glob(f"{path.name}*")) / 1e6 if path.is_file() else "–"


def measure(case: str, sizes: list[int], root: Path) -> Iterator[tuple[object, ...]]:
    """Run one case on lots of growing size."""
    database, engine, jobs = case.split(":")
    first: tuple[float, float] | None = None
    for units in sizes:
        folder, report = root / f"lot-{units}", root / "report.json"
        with fresh_url(database) as url:
            url = url.replace("+psycopg", "")
            softcal("train", str(folder), "--registry", url)
            wall_s, cpu_s, peaks = softcal(
                "batch", str(folder), "--registry", url, "--engine", engine, "--jobs", jobs, "--json", str(report)
            )
            size = size_MB(url)
        done = sum(json.loads(report.read_text())["counts"].values())
        if done != units:
            raise SystemExit(f"{case}: {done} of {units} units are in the report")
        first = first or (wall_s, cpu_s)
        ratios = wall_s / first[0], cpu_s / first[1]
        yield database, engine, int(jobs), units, wall_s, units / wall_s, cpu_s, *peaks, size, *ratios


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="40 and 120 units, SQLite, one and two processes")
    parser.add_argument("--units", type=int, nargs="+", default=[1_000, 10_000])
    parser.add_argument("--case", nargs="+", default=list(CASES), metavar="DATABASE:ENGINE:WORKERS")
    options = parser.parse_args()
    sizes = [40, 120] if options.quick else sorted(options.units)
    cases = ["SQLite:local:1", "SQLite:local:2"] if options.quick else options.case
    with tempfile.TemporaryDirectory(prefix="softcal-bench-") as folder:
        for units in sizes:
            make_lot(Path(folder) / f"lot-{units}", units)
        print_markdown(HEADER, (row for case in cases for row in measure(case, sizes, Path(folder))))


if __name__ == "__main__":
    main()
