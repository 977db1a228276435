"""What a chunk of units costs beside the fits: CPU seconds and transactions per unit, for chunks of several sizes.

    python benchmarks/batch_chunks.py [--quick] [--units 200] [--jobs 2]

Fits are the same in every row; what differs is how often work is claimed, sent, kept and committed. `measured` lets the
time of the chunks before decide, as `softcal batch` does.
"""

import argparse
import os
import tempfile
import time
from pathlib import Path

from batch_lot import make_lot
from registry_common import DATABASES, fresh_url, print_markdown
from sqlalchemy import event

from softcal.app.batch.batch import run_batch
from softcal.app.batch.engine import EngineChoice
from softcal.app.batch.lot_work import BatchConfig
from softcal.app.batch.train import train_or_find
from softcal.app.files.lot_folder import LotFolder, open_lot_folder
from softcal.core.network.config import NetworkConfig
from softcal.db.connection import open_registry

NETWORK = NetworkConfig(hidden=(16, 8), max_epochs=30)
SIZES = (1, 4, 16, 64, None)


def measure(kind: str, folder: LotFolder, chunk: int | None, jobs: int) -> tuple[object, ...]:
    """Run one batch in this process; workers are its children."""
    with fresh_url(kind) as url, open_registry(url) as registry:
        train_or_find(folder.lot, folder.read_source(), registry, NETWORK)
        commits: list[object] = []
        event.listen(registry.database.engine, "commit", commits.append)
        before, start_s = os.times(), time.perf_counter()
        run_batch(folder, registry, BatchConfig(NETWORK, engine=EngineChoice(jobs=jobs), chunk=chunk))
        wall_s, after = time.perf_counter() - start_s, os.times()
    units = len(folder.unit_paths)
    own_ms = 1e3 * (after.user + after.system - before.user - before.system) / units
    workers_ms = 1e3 * (after.children_user + after.children_system - before.children_user - before.children_system)
    return kind, chunk or "measured", wall_s, units / wall_s, own_ms, workers_ms / units, len(commits) / units


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="32 units, SQLite")
    parser.add_argument("--units", type=int, default=200)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    units, kinds = (32, DATABASES[:1]) if options.quick else (options.units, DATABASES)
    header = ("registry", "chunk", "wall s", "units/s", "CPU ms/unit, command", "CPU ms/unit, workers", "commits/unit")
    with tempfile.TemporaryDirectory(prefix="softcal-bench-") as root:
        folder = open_lot_folder(make_lot(Path(root) / "lot", units))
        print_markdown(header, (measure(kind, folder, chunk, options.jobs) for kind in kinds for chunk in SIZES))


if __name__ == "__main__":
    main()
