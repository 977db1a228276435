"""A batch of many units of 1,250 samples: wall time, units/s, peak memory, and how the cost grows with the lot.

    python benchmarks/batch_scale.py [--quick] [--units 1000 10000] [--case SQLite:local:2 ...] [--kept DIR --part 900]

Each case is `softcal batch` as a user runs it, on a fresh registry that holds the trained network; wall time includes
the start of the program. Memory is the largest that the command's process and any worker of it ever held (VmHWM).
The last two columns are the cost of this lot over that of the smallest lot of the same case. On a machine that is busy
with other work the CPU time is the one to compare. `--kept` keeps lots, SQLite registries and times: with `--part` a
batch is ended (Ctrl-C) after so many seconds, and the same command goes on where it was; `parts` says how often.
"""

import json
import os
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

from common.command import parser_of
from common.registries import DATABASES, SOFTCAL, fresh_url, make_lot
from common.tables import print_table

ENGINES, WORKERS = ("local", "dask"), (1, 2)
CASES = tuple(f"{database}:{engine}:{jobs}" for database in DATABASES for engine in ENGINES for jobs in WORKERS)
HEADER = (
    "registry | engine | workers | units | parts | wall s | units/s | CPU s | MB command | MB worker | MB registry | "
    "wall ratio | CPU ratio"
)


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
    processes = [root]
    for pid in processes:
        # A child hangs on the thread that started it.
        for children in Path(f"/proc/{pid}/task").glob("*/children"):
            processes += [int(child) for line in _lines(children) for child in line.split()]
    return processes


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text().splitlines()
    except (FileNotFoundError, ProcessLookupError):
        return []


@dataclass(frozen=True)
class Cost:
    """What a command cost, in all its parts."""

    wall_s: float = 0.0
    cpu_s: float = 0.0
    command_MB: float = 0.0
    worker_MB: float = 0.0
    parts: int = 0
    is_whole: bool = False

    def and_then(self, more: "Cost") -> "Cost":
        """Return the cost of this part and the next one."""
        largest = max(self.command_MB, more.command_MB), max(self.worker_MB, more.worker_MB)
        times = self.wall_s + more.wall_s, self.cpu_s + more.cpu_s
        return Cost(*times, *largest, self.parts + more.parts, more.is_whole)


def softcal(*arguments: str, part_s: float | None = None) -> Cost:
    """Run a command, at most `part_s` seconds, and return what it and its children cost."""
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    before, start_s = os.times(), time.perf_counter()
    with subprocess.Popen(
        [SOFTCAL, *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment
    ) as process:
        memory = Memory(process.pid)
        try:
            code = process.wait(part_s)
            is_whole = True
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGINT)
            code, is_whole = process.wait(), False
        peaks = memory.stop()
    wall_s, after = time.perf_counter() - start_s, os.times()
    if is_whole and code not in (0, 1):
        raise SystemExit(f"softcal {' '.join(arguments)} ended with {code}")
    cpu_s = after.children_user + after.children_system - before.children_user - before.children_system
    return Cost(wall_s, cpu_s, *peaks, 1, is_whole)


def size_MB(url: str) -> float | str:
    """Return the size of an SQLite registry with its log."""
    path = Path(url.removeprefix("sqlite:///"))
    return sum(part.stat().st_size for part in path.parent.glob(f"{path.name}*")) / 1e6 if path.is_file() else "–"


def lot_name(case: str, units: int) -> str:
    """Return what the files of a case are called."""
    return f"{case.replace(':', '-')}-{units}"


@contextmanager
def registry_of(case: str, units: int, kept_folder: Path | None) -> Iterator[str]:
    """Give the URL of a case's registry: a fresh one, or the one that is kept."""
    database = case.partition(":")[0]
    if kept_folder is not None and database == "SQLite":
        yield f"sqlite:///{kept_folder / lot_name(case, units)}.db"
        return
    with fresh_url(database) as url:
        yield url.replace("+psycopg", "")


def cost_of(
    case: str, units: int, root: Path, kept_folder: Path | None, part_s: float | None
) -> tuple[Cost, float | str]:
    """Run the batch of a case, or the next part of it; return what all parts cost, and the size of the registry."""
    _, engine, jobs = case.split(":")
    folder, report = root / f"lot-{units}", root / "report.json"
    sums = root / f"{lot_name(case, units)}.json"
    so_far = Cost(**json.loads(sums.read_text())) if kept_folder and sums.is_file() else Cost()
    with registry_of(case, units, kept_folder) as url:
        if not so_far.is_whole:
            if not so_far.parts:
                softcal("train", str(folder), "--registry", url)
            options = ("--engine", engine, "--jobs", jobs, "--json", str(report))
            so_far = so_far.and_then(softcal("batch", str(folder), "--registry", url, *options, part_s=part_s))
            sums.write_text(json.dumps(asdict(so_far)))
            if not so_far.is_whole:
                raise SystemExit(f"{case}, {units} units: ended after part {so_far.parts}; the same command goes on")
            unit_count = sum(json.loads(report.read_text())["counts"].values())
            if unit_count != units:
                raise SystemExit(f"{case}: {unit_count} of {units} units are in the report")
        return so_far, size_MB(url)


def measure(
    case: str, sizes: list[int], root: Path, kept_folder: Path | None, part_s: float | None
) -> Iterator[tuple[object, ...]]:
    """Run one case on lots of growing size."""
    database, engine, jobs = case.split(":")
    first: Cost | None = None
    for units in sizes:
        cost, size = cost_of(case, units, root, kept_folder, part_s)
        first = first or cost
        peaks, ratios = (cost.command_MB, cost.worker_MB), (cost.wall_s / first.wall_s, cost.cpu_s / first.cpu_s)
        speed = cost.wall_s, units / cost.wall_s, cost.cpu_s
        yield database, engine, int(jobs), units, cost.parts, *speed, *peaks, size, *ratios


def main() -> None:
    parser = parser_of(__doc__, "40 and 120 units, SQLite, one and two processes")
    parser.add_argument("--units", type=int, nargs="+", default=[1_000, 10_000])
    parser.add_argument("--case", nargs="+", default=list(CASES), metavar="DATABASE:ENGINE:WORKERS")
    parser.add_argument("--kept", type=Path, metavar="DIR", help="folder that keeps everything, for a run in parts")
    parser.add_argument("--part", type=float, metavar="S", help="end a batch after so many seconds; needs --kept")
    options = parser.parse_args()
    if options.part is not None and options.kept is None:
        parser.error("--part needs --kept")
    sizes = [40, 120] if options.quick else sorted(options.units)
    cases = ["SQLite:local:1", "SQLite:local:2"] if options.quick else options.case
    with tempfile.TemporaryDirectory(prefix="softcal-bench-") as folder:
        root = options.kept or Path(folder)
        for units in sizes:
            if not (root / f"lot-{units}").exists():
                make_lot(root / f"lot-{units}", units)
        rows = (row for case in cases for row in measure(case, sizes, root, options.kept, options.part))
        print_table(HEADER, rows)


if __name__ == "__main__":
    main()
