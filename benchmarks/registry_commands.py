"""CPU time of the commands that only read, beside that of `softcal --help`, which loads no library at all.

python benchmarks/registry_commands.py [--quick] [--units 100]

The least of several runs: what else runs on the machine only ever adds. Compiled bytecode is kept, as it is where
softcal is installed.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from common.lots import RATE_HZ, make_lot
from common.tables import print_table

from softcal.app.files.lot_folder import write_lot_toml
from softcal.core.lot import Lot

SOFTCAL = str(Path(sys.executable).with_name("softcal"))
LIMIT_N = 1.0
HEADER = ("command", "CPU s", "times --help")


def cpu_s(*arguments: str, runs: int) -> float:
    """Return the least CPU seconds of a command."""
    seconds = []
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    for _ in range(runs):
        before = _of_children_s()
        code = subprocess.run([SOFTCAL, *arguments], capture_output=True, check=False, env=environment).returncode
        if code not in (0, 1):
            raise SystemExit(f"softcal {' '.join(arguments)} ended with {code}")
        seconds.append(_of_children_s() - before)
    return min(seconds)


def _of_children_s() -> float:
    # Not os.times: it counts hundredths of a second, a tenth of what `--help` takes.
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def rows(root: Path, units: int, runs: int) -> Iterator[tuple[object, ...]]:
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="3 units, 2 runs")
    parser.add_argument("--units", type=int, default=100)
    parser.add_argument("--runs", type=int, default=9)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="softcal-bench-") as folder:
        units, runs = (3, 2) if options.quick else (options.units, options.runs)
        print_table(HEADER, rows(Path(folder), units, runs))


if __name__ == "__main__":
    main()
