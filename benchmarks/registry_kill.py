"""kill -9 at random moments: what was acknowledged must be there, nothing by half, nothing twice.

    python benchmarks/registry_kill.py [--quick] [--kills 100] [--seed N] [--what writer batch station]

writer: calibrations with an event each, in one transaction. batch: a lot is calibrated, every time by a new process
that goes on where the killed one stopped, and once to its end. station: a simulated unit is pressed into a file and a
spool; what was cut off is recovered afterwards.
"""

import argparse
import contextlib
import os
import random
import signal
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from common.lots import make_lot
from common.registries import DATABASES, begin_lot, fresh_url, record
from common.tables import print_table

from softcal.app.batch.batch import run_batch
from softcal.app.batch.lot_work import BatchConfig, Watch
from softcal.app.batch.report import UnitResult
from softcal.app.batch.train import train_or_find
from softcal.app.files.lot_folder import LotFolder, open_lot_folder
from softcal.app.files.recording_file import read_recording
from softcal.app.line.recover import recover
from softcal.app.line.rig import chosen_bench, profile_for, record_to_files
from softcal.core.network.config import NetworkConfig
from softcal.db.connection import open_registry
from softcal.db.registry import Registry

Acknowledge = Callable[[str], None]
HEADER = ("what", "registry", "kills", "acknowledged", "lost", "half-written", "done twice", "faults found by verify")
NETWORK = NetworkConfig(hidden=(16, 8), max_epochs=30)
UNITS_PER_KILL = 8
PRESS_S = 6.0


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
                revision = registry.calibrations.add("bench", record(serial, number, network_id))
                registry.trail.add("export", "exports", (serial, revision), {})
            acknowledge(f"{serial} {revision}")


def kill_writers(kind: str, kills: int, moments: random.Random) -> tuple[object, ...]:
    """Kill writers again and again on one registry, then look what is there."""
    acknowledged: set[str] = set()
    with fresh_url(kind) as url:
        with open_registry(url) as registry:
            network_id = begin_lot(registry)
        for turn in range(kills):
            start = turn * 1_000_000
            acknowledged |= set(killed(partial(write_forever, url, network_id, start), moments, 0.4))
        with open_registry(url, create=False) as registry:
            trail, kept, faults = registry.trail.rows(), revisions(registry), registry.verify()
    halves = sum(row.action == "calibrate" for row in trail) - sum(row.action == "export" for row in trail)
    return "writer", kind, kills, len(acknowledged), len(acknowledged - set(kept)), halves, 0, len(faults)


def revisions(registry: Registry) -> list[str]:
    """Return every calibration as `serial revision`."""
    with registry.database.reading() as connection:
        rows = connection.exec_driver_sql("SELECT serial, revision FROM calibrations").all()
    return [f"{serial} {revision}" for serial, revision in rows]


def batch(url: str, folder: LotFolder, acknowledge: Acknowledge) -> None:
    """Run a batch and tell every unit that was kept."""

    def tell(unit: UnitResult) -> None:
        acknowledge(f"{unit.serial} {unit.made.revision}" if unit.made else f"{unit.serial} refused")

    with open_registry(url, create=False) as registry:
        run_batch(folder, registry, BatchConfig(network=NETWORK), Watch(on_unit=tell))


def kill_batches(kind: str, kills: int, moments: random.Random) -> tuple[object, ...]:
    """Kill batches of one lot, finish it, then look whether every unit was done once and all is there."""
    acknowledged: list[str] = []
    with fresh_url(kind) as url, tempfile.TemporaryDirectory(prefix="softcal-bench-") as root:
        folder = open_lot_folder(make_lot(Path(root) / "lot", UNITS_PER_KILL * kills))
        with open_registry(url) as registry:
            train_or_find(folder.lot, folder.read_source(), registry, NETWORK)
        for _ in range(kills):
            acknowledged += killed(lambda tell: batch(url, folder, tell), moments, 0.6)
        batch(url, folder, acknowledged.append)
        with open_registry(url, create=False) as registry:
            kept, faults = revisions(registry), registry.verify()
            entries = registry.lots.units(folder.lot.id)
    refused = [f"{unit.serial} refused" for unit in entries if unit.verdict and unit.revision is None]
    lost = set(acknowledged) - set(kept) - set(refused)
    unfinished = len(folder.unit_paths) - sum(unit.role == "target" and unit.verdict is not None for unit in entries)
    twice = sum(not line.endswith(" 1") for line in kept) + len(acknowledged) - len(set(acknowledged))
    return "batch", kind, kills, len(acknowledged), len(lost), unfinished, twice, len(faults)


def press(root: Path, turn: int, acknowledge: Acknowledge) -> None:
    """Press a simulated unit into a file."""
    with chosen_bench(None, turn) as bench:
        profile = profile_for("unit", turn, PRESS_S, 2.0)
        run = record_to_files(bench, [f"U{turn:04d}"], root / f"U{turn:04d}.csv", profile, False, root / "spool")
    acknowledge(f"{run.files[0].name} {len(run.recording.t_s)}")


def kill_stations(kills: int, moments: random.Random) -> tuple[object, ...]:
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
        rows = {path.name: len(read_recording(path, path.stem, 50.0)) for path in root.glob("*.csv")}
        recovered = recover(root / "spool", root / "recovered")
        spools = len(list((root / "spool").glob("*.spool")))
    lost = sum(str(rows.get(line.split()[0])) != line.split()[1] for line in acknowledged)
    return "station", "files", kills, len(acknowledged), lost, spools - len(recovered), 0, "–"


def measured(what: list[str], kills: int, seed: int) -> Iterator[tuple[object, ...]]:
    """Run what was asked for, one row each."""
    for kind in DATABASES:
        if "writer" in what:
            yield kill_writers(kind, kills, random.Random(seed))
        if "batch" in what:
            yield kill_batches(kind, kills, random.Random(seed))
    if "station" in what:
        yield kill_stations(kills, random.Random(seed))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="3 kills")
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--what", nargs="+", choices=("writer", "batch", "station"),
                        default=["writer", "batch", "station"])  # fmt: skip
    options = parser.parse_args()
    kills = 3 if options.quick else options.kills
    print_table(HEADER, measured(options.what, kills, options.seed))


if __name__ == "__main__":
    main()
