"""The registry: how fast, and what becomes of it under many writers and under kill -9.

python benchmarks/registry.py commands [--quick] [--units 100]
python benchmarks/registry.py list [--quick] [--units 1000 10000] [--databases SQLite PostgreSQL]
python benchmarks/registry.py redecide [--quick] [--units 2000] [--databases SQLite PostgreSQL]
python benchmarks/registry.py writers [--quick] [--writers 8] [--seconds 60]
python benchmarks/registry.py plant [--quick] [--stations 40] [--seconds 120]
python benchmarks/registry.py kill [--quick] [--kills 100] [--seed N] [--what writer batch station]
"""

import argparse
import contextlib
import math
import multiprocessing
import os
import random
import resource
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from functools import partial
from multiprocessing.synchronize import Barrier
from pathlib import Path

import numpy as np
from common.command import Commands, median_s
from common.registries import DATABASES, RATE_HZ, SOFTCAL, begin_lot, database_of, fresh_url, make_lot, state
from common.tables import print_table
from sqlalchemy import make_url

from softcal.app.batch.batch import run_batch
from softcal.app.batch.lot_work import BatchConfig, Callbacks
from softcal.app.batch.train import provide_network
from softcal.app.calibration.changes import change_limit, compare_verdicts, read_verdicts
from softcal.app.files.lot_folder import LotFolder, open_lot_folder
from softcal.app.files.lot_toml import write_lot_toml
from softcal.app.files.recording_file import inspect_recording
from softcal.app.line.recover import recover
from softcal.app.line.rig import chosen_bench, profile_for, record_to_files
from softcal.core.lot import Lot
from softcal.core.network.config import NetworkConfig
from softcal.core.orders import Heartbeat, StationState
from softcal.core.recording import OutputRecording
from softcal.db.connection import open_registry
from softcal.db.entries import UnitResult
from softcal.db.maintenance.backup import back_up
from softcal.db.maintenance.sync import synchronise
from softcal.db.registry import Registry

LIMIT_N = 1.0
CHUNK = 100
NETWORK = NetworkConfig(hidden=(16, 8), max_epochs=30)
UNITS_PER_KILL = 8
PRESS_S = 6.0
HOSTS, PRESS_ROWS, UNIT_EVERY_S = 8, 7800, 42.0
KILLED = ("writer", "batch", "station")

Acknowledge = Callable[[str], None]
WriteLog = list[tuple[str, int, float]]
Row = tuple[object, ...]


def commands(options: argparse.Namespace) -> None:
    """CPU time of the commands that only read, beside that of `softcal --help`, which loads no library at all.

    The least of several runs: what else runs on the machine only ever adds. Compiled bytecode is kept, as it is where
    softcal is installed.
    """
    units, runs = (3, 2) if options.quick else (options.units, options.runs)
    with tempfile.TemporaryDirectory(prefix="softcal-bench-") as folder:
        print_table("command | CPU s | times --help", reading(Path(folder), units, runs))


def reading(root: Path, units: int, runs: int) -> Iterator[Row]:
    """Calibrate a lot, then time what reads it."""
    lot, url, files = make_lot(root / "lot", units), f"sqlite:///{root / 'registry.db'}", str(root / "files")
    # A limit that every unit keeps: without files there is nothing to check.
    write_lot_toml(lot, Lot(lot.name, "S0", RATE_HZ, limit_rmse=LIMIT_N))
    cpu_s("batch", str(lot), "--registry", url, "--release", "conditional", "--out", files, runs=1)
    serial = sorted(path.stem for path in (lot / "units").iterdir())[0]
    recording = root / "thousand.csv"
    recording.write_text("".join((lot / f"units/{serial}.csv").read_text().splitlines(keepends=True)[:1001]))
    commands = {
        "softcal --help": ["--help"],
        f"registry list, {units} units": ["registry", "list", "--registry", url],
        "registry history of one unit": ["registry", "history", "--serial", serial, "--registry", url],
        f"registry verify --quick, {units} units": ["registry", "verify", "--quick", "--registry", url],
        "estimate of 1,000 rows": [
            "estimate", "--serial", serial, str(recording), "--out", str(root / "out.csv"), "--registry", url
        ],
        f"export --check, {units} files": ["export", "--check", "--out", files],
    }  # fmt: skip
    of_help = 0.0
    for name, arguments in commands.items():
        seconds = cpu_s(*arguments, runs=runs)
        of_help = of_help or seconds
        yield name, seconds, seconds / of_help


def cpu_s(*arguments: str, runs: int) -> float:
    """Return the least CPU seconds of a command."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    seconds = []
    for _ in range(runs):
        before = _of_children_s()
        code = subprocess.run([SOFTCAL, *arguments], capture_output=True, check=False, env=environment).returncode
        if code not in (0, 1):
            raise SystemExit(f"softcal {' '.join(arguments)} ended with {code}")
        seconds.append(_of_children_s() - before)
    return min(seconds)


def _of_children_s() -> float:
    # Not os.times: it counts hundredths of a second, a tenth of what `--help` takes.
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def list_(options: argparse.Namespace) -> None:
    """How long a person waits for a registry of 10,000 units: list, one unit, verify, backup, first synchronisation."""
    sizes = [500] if options.quick else sorted(options.units)
    head = (
        "database | units | registered/s | list ms | one unit ms | verify --quick s | verify s | backup s | backup MB"
    )
    rows = (waited(kind, units) for kind in options.databases for units in sizes)
    print_table(f"{head} | first sync to PostgreSQL s", rows)


def waited(kind: str, units: int) -> Row:
    """Fill a registry, a hundred units per transaction as `batch` does, and measure what a person waits for."""
    with fresh_url(kind) as url, open_registry(url) as registry, tempfile.TemporaryDirectory() as folder:
        fill_s = median_s(lambda: fill(registry, units))
        list_s = median_s(lambda: registry.lots.units("bench"), 5)
        unit_s = median_s(lambda: registry.calibrations.get(f"U{units // 2:06d}"), 21)
        quick_s = median_s(lambda: registry.verify(is_quick=True), 5)
        verify_s = median_s(registry.verify)
        backup = Path(folder) / "backup.db"
        backup_s = median_s(lambda: back_up(registry.database, backup))
        size_MB = backup.stat().st_size / 1e6
        with fresh_url("PostgreSQL") as other_url, open_registry(other_url) as other:
            sync_s = median_s(lambda: synchronise(registry, other))
    return kind, units, units / fill_s, 1e3 * list_s, 1e3 * unit_s, quick_s, verify_s, backup_s, size_MB, sync_s


def fill(registry: Registry, units: int) -> None:
    """Register calibrated units."""
    network_id = begin_lot(registry)
    for start in range(0, units, CHUNK):
        with registry.transaction():
            for number in range(start, min(start + CHUNK, units)):
                registry.calibrations.add("bench", state(f"U{number:06d}", number, network_id))


def redecide(options: argparse.Namespace) -> None:
    """CPU of a lot under another limit: every unit of it is decided again. Beside it, reading all those units once."""
    rows = (redecided(kind, 100 if options.quick else options.units) for kind in options.databases)
    print_table("database | units | CPU s | reading the units alone, CPU s | memory more, MB | verdicts changed", rows)


def redecided(kind: str, units: int) -> Row:
    with fresh_url(kind) as url, open_registry(url) as registry:
        fill(registry, units)
        begun_s = time.process_time()
        before = read_verdicts(registry, "bench")
        reading_s = time.process_time() - begun_s
        before_MB = peak_MB()
        begun_s = time.process_time()
        change_limit(registry, "bench", 0.05, reason="a benchmark")
        taken_s, more_MB = time.process_time() - begun_s, peak_MB() - before_MB
        changes = compare_verdicts(registry, "bench", before)
    return kind, len(before), taken_s, reading_s, more_MB, len(changes.changed)


def peak_MB() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def writers(options: argparse.Namespace) -> None:
    """Eight processes write to one registry for a minute, half of them the history of one and the same unit.

    An update is lost when an acknowledged revision is not in the history afterwards. Every write reads the newest
    revision first, stores arrays, a row and its audit row, and is on disk when it is acknowledged.
    """
    seconds = 3.0 if options.quick else options.seconds
    head = "database | writers | s | writes | writes/s | errors | lost | median ms | 99 % ms | worst ms | faults"
    print_table(head, (written_by(kind, options.writers, seconds) for kind in DATABASES))


_together: Barrier


def start_together(barrier: Barrier) -> None:
    """Keep the barrier that all writers pass at once."""
    global _together
    _together = barrier


def write(arguments: tuple[str, str, int, float]) -> tuple[WriteLog, list[str]]:
    """Write for some seconds; return what was acknowledged with its latency, and the errors."""
    url, network_id, writer, seconds = arguments
    writes: WriteLog = []
    errors: list[str] = []
    serial = "SHARED" if writer % 2 else f"OWN{writer}"
    with open_registry(url, create=False) as registry:
        _together.wait()
        until_s = time.perf_counter() + seconds
        for number in range(10_000_000):
            start_s = time.perf_counter()
            if start_s >= until_s:
                return writes, errors
            try:
                revision = registry.calibrations.add("bench", state(serial, writer * 1_000_000 + number, network_id))
                writes.append((serial, revision, time.perf_counter() - start_s))
            except Exception as error:
                errors.append(str(error))
    return writes, errors


def written_by(kind: str, writers: int, seconds: float) -> Row:
    """Run all writers on a fresh registry, then compare what was acknowledged with what is there."""
    with fresh_url(kind) as url:
        with open_registry(url) as registry:
            network_id = begin_lot(registry)
        context = multiprocessing.get_context("spawn")
        with context.Pool(writers, start_together, (context.Barrier(writers),)) as pool:
            answers = pool.map(write, [(url, network_id, k, seconds) for k in range(writers)], chunksize=1)
        acknowledged = [(serial, revision) for writes, _ in answers for serial, revision, _ in writes]
        latencies_ms = 1e3 * np.array([latency for writes, _ in answers for *_, latency in writes])
        errors = [error for _, failed in answers for error in failed]
        with open_registry(url, create=False) as registry:
            stored = {
                (s, c.revision)
                for s in {serial for serial, _ in acknowledged}
                for c in registry.calibrations.history(s)
            }
            faults = registry.verify()
    lost = len(acknowledged) - len(set(acknowledged) & stored)
    median, high, worst = np.percentile(latencies_ms, [50, 99, 100])
    count = len(acknowledged)
    speed = count / seconds
    numbers = (count, speed, len(errors), lost, float(median), float(high), float(worst), len(faults))
    return (database_of(kind), writers, seconds, *numbers)


def plant(options: argparse.Namespace) -> None:
    """Write what many stations write: each a heartbeat every second, and a pressed unit every 42 s.

    A unit is its recording of 7,800 rows and its calibration, each on disk when it is acknowledged. Eight processes
    share the stations, as hosts would. A station that is silent for 3 s counts as off on every screen.
    """
    seconds = 5.0 if options.quick else options.seconds
    head = "database | stations | s | units | units/h | median ms | 99 % ms | worst ms | beats/s | silence s | kB/unit"
    print_table(head, (served_by_many(kind, options.stations, seconds) for kind in DATABASES))


def serve_some(arguments: tuple[str, str, list[int], float]) -> tuple[list[float], dict[int, list[float]]]:
    """Write what some stations write; return how long each unit took, s, and when each station beat."""
    url, network_id, stations, seconds = arguments
    rng = np.random.default_rng(stations[0])
    t_s = np.arange(PRESS_ROWS) / RATE_HZ
    unit_s, heartbeat_times = list[float](), {station: list[float]() for station in stations}
    next_s = {station: float(rng.uniform(0.0, UNIT_EVERY_S)) for station in stations}
    with open_registry(url, create=False) as registry:
        _together.wait()
        start_s = time.perf_counter()
        while (now_s := time.perf_counter() - start_s) < seconds:
            for station in stations:
                heartbeat = Heartbeat(
                    f"line-{station}", StationState.READY, datetime.now(UTC), process=f"host:{station}"
                )
                registry.order_queue.write_heartbeat(heartbeat)
                heartbeat_times[station].append(time.perf_counter() - start_s)
                if now_s >= next_s[station]:
                    next_s[station] += UNIT_EVERY_S
                    began_s, serial = time.perf_counter(), f"{station}-{len(unit_s)}"
                    recording = OutputRecording(serial, t_s, rng.normal(size=PRESS_ROWS), RATE_HZ)
                    registry.recordings.add("bench", recording, "unit")
                    registry.calibrations.add("bench", state(serial, station * 1_000_000 + len(unit_s), network_id))
                    unit_s.append(time.perf_counter() - began_s)
            time.sleep(max(0.0, 1.0 - (time.perf_counter() - start_s - now_s)))
    return unit_s, heartbeat_times


def served_by_many(kind: str, stations: int, seconds: float) -> Row:
    """Run all stations on a fresh registry."""
    with fresh_url(kind) as url:
        with open_registry(url) as registry:
            network_id = begin_lot(registry)
        hosts = [list(range(k, stations, HOSTS)) for k in range(min(HOSTS, stations))]
        context = multiprocessing.get_context("spawn")
        with context.Pool(len(hosts), start_together, (context.Barrier(len(hosts)),)) as pool:
            answers = pool.map(serve_some, [(url, network_id, some, seconds) for some in hosts], chunksize=1)
        size_kB = Path(str(make_url(url).database)).stat().st_size / 1024 if kind == "SQLite" else math.nan
    unit_ms = 1e3 * np.array([one for units, _ in answers for one in units])
    heartbeat_times = [times for _, some in answers for times in some.values()]
    silence_s = max(float(np.max(np.diff([0.0, *times, seconds]))) for times in heartbeat_times)
    numbers = map(float, np.percentile(unit_ms, [50, 99, 100]))
    per_h, per_s = 3600.0 * len(unit_ms) / seconds, sum(map(len, heartbeat_times)) / seconds
    of_unit = f"{size_kB / len(unit_ms):.0f}" if math.isfinite(size_kB) else "–"
    return (database_of(kind), stations, seconds, len(unit_ms), per_h, *numbers, per_s, silence_s, of_unit)


def kill(options: argparse.Namespace) -> None:
    """kill -9 at random moments: what was acknowledged must be there, nothing by half, nothing twice.

    writer: calibrations with an event each, in one transaction. batch: a lot is calibrated, every time by a new process
    that goes on where the killed one stopped, and once to its end. station: a simulated unit is pressed into a file and
    a spool; what was cut off is recovered afterwards.
    """
    kills = 3 if options.quick else options.kills
    head = "what | registry | kills | acknowledged | lost | half-written | done twice | faults found by verify"
    print_table(head, killed_ones(options.what, kills, options.seed))


def killed_ones(what: list[str], kills: int, seed: int) -> Iterator[Row]:
    """Run what was asked for, one row each."""
    for kind in DATABASES:
        if "writer" in what:
            yield kill_writers(kind, kills, random.Random(seed))
        if "batch" in what:
            yield kill_batches(kind, kills, random.Random(seed))
    if "station" in what:
        yield kill_stations(kills, random.Random(seed))


def acknowledge(pipe: int, line: str) -> None:
    """Write one line down a pipe."""
    os.write(pipe, f"{line}\n".encode())


def killed(
    work: Callable[[Acknowledge], None], moments: random.Random, within_s: float, has_many: bool = True
) -> list[str]:
    """Do work in a process of its own, kill it at a random moment, and return what it acknowledged until then.

    One in four is killed some time after its start, the others some time after the first thing they acknowledged,
    where they acknowledge many.
    """
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        os.close(reading)
        with contextlib.redirect_stderr(None), contextlib.suppress(BaseException):
            work(partial(acknowledge, writing))
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        first = pipe.readline() if has_many and moments.random() < 0.75 else ""
        time.sleep(moments.uniform(0.0, within_s))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        return [line.strip() for line in (first + pipe.read()).splitlines(keepends=True) if line.endswith("\n")]


def write_forever(url: str, network_id: str, start: int, acknowledge: Acknowledge) -> None:
    """Write calibrations with an event each, and tell every one that was kept."""
    with open_registry(url, create=False) as registry:
        for number in range(start, start + 1_000_000):
            serial = f"K{number % 5}"
            with registry.transaction():
                revision = registry.calibrations.add("bench", state(serial, number, network_id))
                registry.trail.add("export", "exports", (serial, revision), {})
            acknowledge(f"{serial} {revision}")


def kill_writers(kind: str, kills: int, moments: random.Random) -> Row:
    """Kill writers again and again on one registry, then look what is there."""
    acknowledged: set[str] = set()
    with fresh_url(kind) as url:
        with open_registry(url) as registry:
            network_id = begin_lot(registry)
        for turn in range(kills):
            start = turn * 1_000_000
            acknowledged |= set(killed(partial(write_forever, url, network_id, start), moments, 0.4))
        with open_registry(url, create=False) as registry:
            trail, stored, faults = registry.trail.rows(), revisions(registry), registry.verify()
    halves = sum(row.action == "calibrate" for row in trail) - sum(row.action == "export" for row in trail)
    return "writer", kind, kills, len(acknowledged), len(acknowledged - set(stored)), halves, 0, len(faults)


def revisions(registry: Registry) -> list[str]:
    """Return every calibration as `serial revision`."""
    with registry.database.reading() as connection:
        rows = connection.exec_driver_sql("SELECT serial, revision FROM calibrations").all()
    return [f"{serial} {revision}" for serial, revision in rows]


def batch(url: str, folder: LotFolder, acknowledge: Acknowledge) -> None:
    """Run a batch and tell every unit that was kept."""

    def print_unit(unit: UnitResult) -> None:
        acknowledge(f"{unit.serial} {unit.calibration.revision}" if unit.calibration else f"{unit.serial} refused")

    with open_registry(url, create=False) as registry:
        run_batch(folder, registry, BatchConfig(network=NETWORK), Callbacks(on_unit=print_unit))


def kill_batches(kind: str, kills: int, moments: random.Random) -> Row:
    """Kill batches of one lot, finish it, then look whether every unit was done once and all is there."""
    acknowledged: list[str] = []
    with fresh_url(kind) as url, tempfile.TemporaryDirectory(prefix="softcal-bench-") as root:
        folder = open_lot_folder(make_lot(Path(root) / "lot", UNITS_PER_KILL * kills))
        with open_registry(url) as registry:
            provide_network(folder.lot, folder.read_source(), registry, NETWORK)
        for _ in range(kills):
            acknowledged += killed(lambda tell: batch(url, folder, tell), moments, 0.6)
        batch(url, folder, acknowledged.append)
        with open_registry(url, create=False) as registry:
            stored, faults = revisions(registry), registry.verify()
            entries = registry.lots.units(folder.lot.id)
    refused = [f"{unit.serial} refused" for unit in entries if unit.verdict and unit.revision is None]
    lost = set(acknowledged) - set(stored) - set(refused)
    unfinished = len(folder.unit_paths) - sum(unit.role == "target" and unit.verdict is not None for unit in entries)
    twice = sum(not line.endswith(" 1") for line in stored) + len(acknowledged) - len(set(acknowledged))
    return "batch", kind, kills, len(acknowledged), len(lost), unfinished, twice, len(faults)


def press(root: Path, turn: int, acknowledge: Acknowledge) -> None:
    """Press a simulated unit into a file."""
    with chosen_bench(None, turn) as bench:
        profile = profile_for("unit", turn, PRESS_S, 2.0)
        run = record_to_files(bench, [f"U{turn:04d}"], root / f"U{turn:04d}.csv", profile, False, root / "spool")
    acknowledge(f"{run.files[0].name} {len(run.recording.t_s)}")


def kill_stations(kills: int, moments: random.Random) -> Row:
    """Kill runs of the simulated station; a file is there whole or not at all, and every spool can be read."""
    acknowledged: list[str] = []
    with tempfile.TemporaryDirectory(prefix="softcal-bench-") as name:
        root = Path(name)
        (root / "spool").mkdir()
        start_s = time.monotonic()
        press(root, 0, acknowledged.append)
        run_s = time.monotonic() - start_s
        for turn in range(1, kills + 1):
            acknowledged += killed(partial(press, root, turn), moments, 1.1 * run_s, False)
        rows = {path.name: len(inspect_recording(path, path.stem, 50.0).recording) for path in root.glob("*.csv")}
        recovered = recover(root / "spool", root / "recovered")
        spools = len(list((root / "spool").glob("*.spool")))
    lost = sum(str(rows.get(line.split()[0])) != line.split()[1] for line in acknowledged)
    return "station", "files", kills, len(acknowledged), lost, spools - len(recovered), 0, "–"


def main() -> None:
    every = Commands(__doc__)
    parser = every.add(commands, "3 units, 2 runs")
    parser.add_argument("--units", type=int, default=100)
    parser.add_argument("--runs", type=int, default=9)
    parser = every.add(list_, "500 units instead of 1,000 and 10,000")
    parser.add_argument("--units", type=int, nargs="+", default=[1_000, 10_000])
    parser.add_argument("--databases", nargs="+", choices=DATABASES, default=DATABASES)
    parser = every.add(redecide, "100 units")
    parser.add_argument("--units", type=int, default=2_000)
    parser.add_argument("--databases", nargs="+", choices=DATABASES, default=DATABASES)
    parser = every.add(writers, "three seconds instead of a minute")
    parser.add_argument("--writers", type=int, default=8)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser = every.add(plant, "five seconds")
    parser.add_argument("--stations", type=int, default=40)
    parser.add_argument("--seconds", type=float, default=120.0)
    parser = every.add(kill, "3 kills")
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--what", nargs="+", choices=KILLED, default=KILLED)
    every.run()


if __name__ == "__main__":
    main()
