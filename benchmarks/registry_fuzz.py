"""Twenty thousand broken files of every kind that softcal reads, under hard limits: 2 GB of memory, 60 s each.

    python benchmarks/registry_fuzz.py [--quick] [--files 20000] [--seed N] [--kinds csv ...] [--kept FILE]

A child process reads a chunk of files under RLIMIT_AS; an alarm ends it where one file takes too long, and the parent
counts that file and goes on behind it. `--kept` keeps what each chunk found, so that the same command goes on where it
was cut off. A file is right when it is refused in one line, or read as it stands (a backup: restored to what verify
finds whole). `sheet` is a spreadsheet whose XML was broken before it was packed; the others are broken as bytes.
"""

import argparse
import json
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

from common.registries import begin_lot, record
from common.tables import print_table
from import_fuzz import Fuzz, damaged, good_rows

from softcal.app.files.lot_folder import open_lot_folder, write_lot_toml
from softcal.core.errors import InputError, RegistryError
from softcal.core.lot import Lot
from softcal.db.care.backup import back_up, restore
from softcal.db.connection import open_registry

SHARES = {"csv": 0.35, "bytes": 0.25, "xlsx": 0.1, "sheet": 0.08, "parquet": 0.12, "toml": 0.09, "archive": 0.01}
HEADER = ("kind", "files", "refused in one line", "read as it stands", "traceback", "wrong", "left by half",
          "beyond 2 GB", "beyond 60 s", "slowest s", "largest MB")  # fmt: skip
WHAT = ("refused", "made", "traceback", "wrong", "left", "memory", "time")
MOST_BYTES, MOST_S = 2_000_000_000, 60
CHUNK = {"archive": 20}


class SheetFuzz(Fuzz):
    """Spreadsheets that unpack without an error and hold broken XML."""

    def __init__(self, kind: str, folder: Path, rng: random.Random) -> None:
        super().__init__("xlsx", folder, rng)

    def _written(self) -> tuple[Path, str | None]:
        rows, path = good_rows(self._rng), self._folder / "S0.xlsx"
        with zipfile.ZipFile(BytesIO(self._binary(rows))) as archive:
            parts = {name: archive.read(name) for name in archive.namelist()}
        name = self._rng.choice(["xl/worksheets/sheet1.xml", *parts])
        parts[name] = damaged(self._rng, parts[name])
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in parts.items():
                archive.writestr(name, content)
        return path, None

    def _is_right(self, out: Path, text: str | None) -> bool:
        # Nothing guards the cells of a sheet against another digit: that it is read in order is all there is to see.
        return len(open_lot_folder(out).read_source().reference) > 0


class TomlFuzz(Fuzz):
    """The lot.toml of a lot folder."""

    def one(self) -> None:
        """Break one, open the folder, and count what became of it."""
        write_lot_toml(self._folder, Lot("fuzz", "S0", 50.0, "eGaIn", limit_rmse=0.5))
        for name in ("source", "units"):
            (self._folder / name).mkdir(exist_ok=True)
        for path in (self._folder / "source/S0.csv", self._folder / "units/A1.csv"):
            path.write_text("t_s,output,reference\n0,1,2\n0.02,2,3\n")
        path = self._folder / "lot.toml"
        path.write_bytes(damaged(self._rng, path.read_bytes()))
        try:
            lot = open_lot_folder(self._folder).lot
        except InputError as error:
            self._count("refused" if len(str(error).splitlines()) == 1 else "traceback", str(error))
        else:
            self._count("made" if lot.sample_rate_Hz > 0 and lot.id and lot.source else "wrong", str(lot))


class ArchiveFuzz(Fuzz):
    """Backups of a registry."""

    def __init__(self, kind: str, folder: Path, rng: random.Random) -> None:
        super().__init__(kind, folder, rng)
        with open_registry(f"sqlite:///{folder / 'registry.db'}") as registry:
            network_id = begin_lot(registry)
            for number in range(6):
                registry.calibrations.add("bench", record(f"U{number}", number, network_id))
            back_up(registry.database, folder / "backup.db")
        self._content = (folder / "backup.db").read_bytes()

    def one(self) -> None:
        """Break one, restore it, and count what became of it."""
        path, into = self._folder / "broken.db", self._folder / "restored.db"
        path.write_bytes(damaged(self._rng, self._content))
        try:
            restore(path, f"sqlite:///{into}")
        except (InputError, RegistryError) as error:
            self._count("refused" if len(str(error).splitlines()) == 1 else "traceback", str(error))
            if into.exists():
                with open_registry(f"sqlite:///{into}") as registry:
                    self._count("left", str(error)) if registry.lots.all() else None
        else:
            with open_registry(f"sqlite:///{into}", create=False) as registry:
                self._count("wrong" if registry.verify() or len(registry.lots.units("bench")) != 7 else "made", "")
        for left in self._folder.glob("*d.db*"):
            left.unlink() if left.name.startswith(("broken", "restored")) else None


KINDS: dict[str, Callable[[str, Path, random.Random], Fuzz]] = {
    "csv": Fuzz, "bytes": Fuzz, "xlsx": Fuzz, "sheet": SheetFuzz, "parquet": Fuzz, "toml": TomlFuzz,
    "archive": ArchiveFuzz,
}  # fmt: skip


def child(kind: str, seed: str, first: int, stop: int) -> None:
    """Read the files `first` to `stop` of a chunk and tell after each what was found so far."""
    # The libraries are loaded before the limit counts; the largest file has to fit beside them.
    with tempfile.TemporaryDirectory(prefix="softcal-bench-") as folder:
        rng = random.Random(f"{seed} {first}")
        fuzz = KINDS[kind](kind, Path(folder), rng)
        resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))
        slowest_s = 0.0
        for k in range(first, stop):
            signal.alarm(MOST_S)
            start_s = time.perf_counter()
            try:
                fuzz.one()
            except MemoryError:
                fuzz.found["memory"] += 1
            except Exception as error:
                fuzz._count("traceback", f"{type(error).__name__}: {error}")
            signal.alarm(0)
            slowest_s = max(slowest_s, time.perf_counter() - start_s)
            peak_MB = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            told = {"next": k + 1, "found": dict(fuzz.found), "slowest_s": slowest_s, "peak_MB": peak_MB}
            print(json.dumps({**told, "examples": fuzz.examples}), flush=True)


def chunk_of(kind: str, seed: str, first: int, stop: int) -> Iterator[dict[str, Any]]:
    """Run the files of a chunk in children and give what each found; a file that ended its child is counted itself."""
    while first < stop:
        command = [sys.executable, __file__, "--child", kind, seed, str(first), str(stop)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        lines = done.stdout.splitlines()
        told: dict[str, Any] = {"next": first, "found": {}, "slowest_s": 0.0, "peak_MB": 0.0}
        if lines:
            told = json.loads(lines[-1])
        first = int(told["next"])
        if first < stop:
            what = "time" if done.returncode == -signal.SIGALRM else "memory"
            told["found"][what] = told["found"].get(what, 0) + 1
            told.setdefault("examples", []).append(
                f"{kind} {first}: child ended with {done.returncode} {done.stderr[-300:]}"
            )
            first += 1
        yield told


def measure(kind: str, files: int, seed: int, kept: Path | None, examples: list[str]) -> tuple[object, ...]:
    """Read all files of a kind, chunk by chunk, and return a row of the table."""
    known = {} if kept is None or not kept.exists() else dict(json.loads(line) for line in kept.open())
    found: Counter[str] = Counter()
    slowest_s = peak_MB = 0.0
    size = CHUNK.get(kind, 100)
    for first in range(0, files, size):
        stop = min(first + size, files)
        name = f"{seed} {kind} {first} {stop}"
        if name not in known:
            known[name] = list(chunk_of(kind, f"{seed} {kind}", first, stop))
            if kept is not None:
                with kept.open("a") as file:
                    file.write(json.dumps([name, known[name]]) + "\n")
        for told in known[name]:
            found.update(told["found"])
            examples.extend(told.get("examples", []))
            slowest_s, peak_MB = max(slowest_s, told["slowest_s"]), max(peak_MB, told["peak_MB"])
    return kind, files, *(found[what] for what in WHAT), slowest_s, peak_MB


def main() -> None:
    if sys.argv[1:2] == ["--child"]:
        child(sys.argv[2], sys.argv[3], int(sys.argv[4]), int(sys.argv[5]))
        return
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="140 files")
    parser.add_argument("--files", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", nargs="+", choices=tuple(KINDS), default=list(KINDS), help="default: all")
    parser.add_argument("--kept", type=Path, help="file that keeps what was found, to go on after a break")
    options = parser.parse_args()
    counts = {kind: 20 if options.quick else round(share * options.files) for kind, share in SHARES.items()}
    examples: list[str] = []
    rows = (measure(kind, counts[kind], options.seed, options.kept, examples) for kind in options.kinds)
    print_table(HEADER, rows)
    for example in examples[:24]:
        print(example)


if __name__ == "__main__":
    main()
