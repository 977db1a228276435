"""Broken files by the thousand: softcal refuses each in one line, or reads what stands in it.

    python benchmarks/fuzz.py tables [--quick] [--files 100000] [--seed N] [--kinds csv ...]
    python benchmarks/fuzz.py files [--quick] [--files 20000] [--seed N] [--kinds csv ...] [--kept FILE]

Every table is a good one with one to three things broken in it, as CSV, Excel or Parquet. What was made is compared
with a reading of the same text by Python's own `csv` and `float`, which knows nothing of pandas; a file that reading
cannot make sense of must have been refused. `traceback` counts every exception but the one line for the user.
"""

import argparse
import csv
import io
import json
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from common.command import Commands, ResultCache
from common.registries import begin_lot, state
from common.tables import print_table

from softcal.app.files.import_plan import Columns, ImportPlan
from softcal.app.files.importing import import_lot
from softcal.app.files.lot_folder import open_lot_folder
from softcal.app.files.lot_toml import write_lot_toml
from softcal.core.errors import InputError, RegistryError
from softcal.core.lot import Lot
from softcal.db.connection import open_registry
from softcal.db.maintenance.backup import back_up, restore

TABLE_SHARES = {"csv": 0.6, "bytes": 0.3, "xlsx": 0.04, "parquet": 0.06}
FILE_SHARES = {"csv": 0.35, "bytes": 0.25, "xlsx": 0.1, "sheet": 0.08, "parquet": 0.12, "toml": 0.09, "archive": 0.01}
OUTCOMES = ("refused", "made", "traceback", "wrong", "left")
BY_LIMIT = ("memory", "time")
MAX_BYTES, MAX_S = 2_000_000_000, 60
CHUNK = {"archive": 20}

Row = tuple[object, ...]


def tables(options: argparse.Namespace) -> None:
    """Malformed tables: `softcal import` refuses each in words, or makes the lot that stands in it."""
    examples: list[str] = []
    files = 400 if options.quick else options.files

    def row(kind: str) -> Row:
        with tempfile.TemporaryDirectory(prefix="softcal-bench-") as folder:
            fuzz, start_s = Fuzz(kind, Path(folder), random.Random(f"{options.seed} {kind}")), time.perf_counter()
            count = round(TABLE_SHARES[kind] * files)
            for _ in range(count):
                fuzz.one()
            examples.extend(fuzz.examples)
            return kind, count, *(fuzz.counts[what] for what in OUTCOMES), time.perf_counter() - start_s

    head = "kind | files | refused in one line | made as it stands | traceback | wrong lot | left by half | s"
    print_table(head, map(row, options.kinds))
    print(*examples, sep="\n")


def files(options: argparse.Namespace) -> None:
    """Files of every kind that softcal reads, under hard limits: 2 GB of memory, 60 s each.

    A child process reads a chunk of files under RLIMIT_AS; an alarm ends it where one file takes too long, and the
    parent counts that file and goes on behind it. A file is right when it is refused in one line, or read as it stands
    (a backup: restored to what verify finds whole). `sheet` is a spreadsheet whose XML was broken before it was packed;
    the others are broken as bytes.
    """
    examples: list[str] = []
    cache = ResultCache(options.kept)

    def row(kind: str) -> Row:
        count = 20 if options.quick else round(FILE_SHARES[kind] * options.files)
        return measured(kind, count, f"{options.seed} {kind}", cache, examples)

    head = "kind | files | refused in one line | read as it stands | traceback | wrong | left by half | "
    print_table(head + "beyond 2 GB | beyond 60 s | slowest s | largest MB", map(row, options.kinds))
    print(*examples[:24], sep="\n")


ROWS = 40
ODD_CELLS = (
    "", " ", "nan", "inf", "-inf", "1e400", "abc", "=1+1", "True", "0x1A", "1,5", "1_000", "\u0661", "\u22121",
    "1e", "--1", '"', "'", "\0", "\x1a", "\ufeff", "NULL", "#N/A", "12:00", "2026-01-01", "9" * 400, "1e-400", "+",
    ".", "\\N",
)  # fmt: skip


def good_rows(rng: random.Random) -> list[list[str]]:
    """Return a table of text cells: header, then `ROWS` samples at 50 Hz."""
    rows = [["t_s", "output", "reference"]]
    return rows + [[f"{k / 50:.2f}", f"{rng.uniform(0, 3):.6f}", f"{rng.uniform(0, 9):.4f}"] for k in range(ROWS)]


def broken(rng: random.Random, rows: list[list[str]]) -> str:
    """Return the table as text with one thing broken."""
    row, cell = rng.randrange(len(rows)), rng.randrange(3)
    what = rng.randrange(12)
    if what == 0:
        rows[row][cell % len(rows[row])] = rng.choice(ODD_CELLS)
    elif what == 1:
        rows[row].append(rng.choice(ODD_CELLS))
    elif what == 2:
        rows[row].pop()
    elif what == 3:
        rows.insert(row, [])
    elif what == 4:
        rows.insert(row, rows[rng.randrange(len(rows))][:])
    elif what == 5:
        del rows[row]
    elif what == 6:
        rows[0][cell % len(rows[0])] = rng.choice(["output", "t_s", "", "Output", "output ", "output.1"])
    elif what == 7:
        for line in rows[1:]:
            line.insert(cell % (len(line) + 1), rng.choice(["7", "x", ""]))
    elif what == 8:
        for line in rows[1:]:
            line[cell % len(line)] = rng.choice(["True", "1", "nan", "2026-01-01"])
    elif what == 9:
        rows[row] = [f'"{value}' for value in rows[row]]
    elif what == 10:
        rows[row], rows[-1] = rows[-1], rows[row]
    else:
        rows[:] = rows[: rng.randrange(len(rows)) + 1]
    for line in rows:
        if not line:
            line.append("")
    return rng.choice(["\n", "\n", "\n", "\r\n", "\r"]).join(",".join(line) for line in rows) + rng.choice(["", "\n"])


def damaged(rng: random.Random, content: bytes) -> bytes:
    """Return bytes with a few of them changed, cut out or repeated."""
    data = bytearray(content)
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(max(1, len(data)))
        what = rng.randrange(4)
        if what == 0 and data:
            data[at] = rng.randrange(256)
        elif what == 1:
            del data[at : at + rng.randint(1, 40)]
        elif what == 2:
            data[at:at] = data[at : at + rng.randint(1, 40)]
        else:
            data = data[: max(1, at)]
    return bytes(data)


def expected(text: str) -> np.ndarray | None:
    """Return (n, 3) time, output and reference as the text has them, or None where it leaves doubt what they are.

    NaN is a missing sample; of a last row that was cut off the last cell is missing, too.
    """
    try:
        rows = [row for row in csv.reader(io.StringIO(text, newline=""), strict=True) if row]
    except csv.Error:
        return None
    header = [cell.removeprefix("\ufeff").strip() for cell in rows[0]] if rows else []
    if any(header.count(name) != 1 for name in ("t_s", "output", "reference")):
        return None
    columns = [header.index(name) for name in ("t_s", "output", "reference")]
    try:
        if len(rows[-1]) < len(header) and not text.endswith(("\n", "\r")):
            rows[-1] = rows[-1][:-1] + [""] * (len(header) - len(rows[-1]) + 1)
        elif len(rows) > 2 and len(rows[-1]) == len(header) and not text.endswith(("\n", "\r")):
            shortest = min(len(row[-1]) for row in rows[1:-1] if row)
            rows[-1] = rows[-1][:-1] + [""] if 0 < len(rows[-1][-1]) < shortest else rows[-1]
        values = np.array([[_sample(row[k]) for k in columns] for row in rows[1:]])
    except (ValueError, IndexError):
        return None
    if not len(values) or any(any(map(str.strip, row[len(header) :])) for row in rows[1:]):
        return None
    while len(values) and np.isnan(values[-1]).all():
        values = values[:-1]
    return values[np.isfinite(values[:, 0])]


MISSING = ("#N/A", "NULL", "NA")
"""Words among those that break a file which stand for a missing sample."""


def _sample(cell: str) -> float:
    # A typographic minus sign is a minus; every other letter beyond ASCII makes no number.
    cell = cell.strip().replace("\N{MINUS SIGN}", "-")
    if cell in MISSING:
        return np.nan
    value = float(cell.replace("_", "x").encode("ascii")) if cell else np.nan
    return value if np.isfinite(value) else np.nan


class Fuzz:
    """One kind of file, broken again and again."""

    def __init__(self, kind: str, folder: Path, rng: random.Random) -> None:
        self._kind, self._folder, self._rng = kind, folder, rng
        self.counts: Counter[str] = Counter()
        self.examples: list[str] = []

    def one(self) -> None:
        """Break one file, import it, and count what became of it."""
        path, text = self._files_written()
        out = self._folder / "lot"
        plan = ImportPlan([path], Columns("output", "reference", "t_s"), Lot("fuzz", "S0", 50.0), serials=["S0"])
        try:
            import_lot(plan, out)
        except InputError as error:
            self._count("refused" if len(str(error).splitlines()) == 1 else "traceback", f"{error}")
        except Exception as error:
            self._count("traceback", f"{type(error).__name__}: {error} in {text!r}")
        else:
            self._count("made" if self._is_right(out, text) else "wrong", repr(text)[:400])
            shutil.rmtree(out)
        leftovers = [entry for entry in self._folder.iterdir() if entry != path]
        if leftovers:
            self._count("left", str(leftovers))

    def _files_written(self) -> tuple[Path, str | None]:
        rows = good_rows(self._rng)
        path = self._folder / f"S0.{'csv' if self._kind == 'bytes' else self._kind}"
        whole = "\n".join(",".join(row) for row in rows)
        if self._kind == "csv":
            text: str | None = broken(self._rng, rows)
            path.write_bytes(str(text).encode())
        elif self._kind == "bytes":
            path.write_bytes(damaged(self._rng, whole.encode()))
            try:
                text = path.read_bytes().decode()
            except UnicodeDecodeError:
                text = None
        else:
            text = whole
            path.write_bytes(damaged(self._rng, self._binary(rows)))
        return path, text

    def _binary(self, rows: list[list[str]]) -> bytes:
        table, content = pd.DataFrame(rows[1:], columns=rows[0]).astype(float), io.BytesIO()
        if self._kind == "parquet":
            table.to_parquet(content, index=False, write_page_checksum=True)
        else:
            table.to_excel(content, index=False)
        return content.getvalue()

    def _is_right(self, out: Path, text: str | None) -> bool:
        imported = pd.read_csv(out / "source" / "S0.csv").to_numpy(float)
        # Checksums of Excel and Parquet cover the cells; what still opens must hold them all.
        right = None if text is None else expected(text)
        return (
            right is not None
            and imported.shape == right.shape
            and np.allclose(imported, right, rtol=1e-14, atol=0, equal_nan=True)
        )

    def _count(self, what: str, example: str) -> None:
        # A refusal because memory ran out is no refusal.
        what = "memory" if "MemoryError" in example else what
        self.counts[what] += 1
        if what in ("traceback", "wrong", "left") and len(self.examples) < 40:
            self.examples.append(f"{self._kind} {what}: {example}")


class SheetFuzz(Fuzz):
    """Spreadsheets that unpack without an error and hold broken XML."""

    def __init__(self, kind: str, folder: Path, rng: random.Random) -> None:
        super().__init__("xlsx", folder, rng)

    def _files_written(self) -> tuple[Path, str | None]:
        rows, path = good_rows(self._rng), self._folder / "S0.xlsx"
        with zipfile.ZipFile(io.BytesIO(self._binary(rows))) as archive:
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
                registry.calibrations.add("bench", state(f"U{number}", number, network_id))
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
        for leftover in self._folder.glob("*d.db*"):
            leftover.unlink() if leftover.name.startswith(("broken", "restored")) else None


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
        resource.setrlimit(resource.RLIMIT_AS, (MAX_BYTES, MAX_BYTES))
        slowest_s = 0.0
        for k in range(first, stop):
            signal.alarm(MAX_S)
            start_s = time.perf_counter()
            try:
                fuzz.one()
            except MemoryError:
                fuzz.counts["memory"] += 1
            except Exception as error:
                fuzz._count("traceback", f"{type(error).__name__}: {error}")
            signal.alarm(0)
            slowest_s = max(slowest_s, time.perf_counter() - start_s)
            peak_MB = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            progress = {"next": k + 1, "found": dict(fuzz.counts), "slowest_s": slowest_s, "peak_MB": peak_MB}
            print(json.dumps({**progress, "examples": fuzz.examples}), flush=True)


def chunk_of(kind: str, seed: str, first: int, stop: int) -> Iterator[dict[str, Any]]:
    """Run the files of a chunk in children and give what each found; a file that ended its child is counted itself."""
    while first < stop:
        command = [sys.executable, __file__, "--child", kind, seed, str(first), str(stop)]
        process = subprocess.run(command, capture_output=True, text=True, check=False)
        lines = process.stdout.splitlines()
        progress: dict[str, Any] = {"next": first, "found": {}, "slowest_s": 0.0, "peak_MB": 0.0}
        if lines:
            progress = json.loads(lines[-1])
        first = int(progress["next"])
        if first < stop:
            what = "time" if process.returncode == -signal.SIGALRM else "memory"
            progress["found"][what] = progress["found"].get(what, 0) + 1
            progress.setdefault("examples", []).append(
                f"{kind} {first}: child ended with {process.returncode} {process.stderr[-300:]}"
            )
            first += 1
        yield progress


def measured(kind: str, files: int, seed: str, cache: ResultCache, examples: list[str]) -> Row:
    """Read all files of a kind, chunk by chunk, and return a row of the table."""
    outcomes: Counter[str] = Counter()
    slowest_s = peak_MB = 0.0
    size = CHUNK.get(kind, 100)
    for first in range(0, files, size):
        stop = min(first + size, files)
        for part in cache.get(f"{seed} {first} {stop}", lambda f=first, s=stop: list(chunk_of(kind, seed, f, s))):  # type: ignore[misc]
            outcomes.update(part["found"])
            examples.extend(part.get("examples", []))
            slowest_s, peak_MB = max(slowest_s, part["slowest_s"]), max(peak_MB, part["peak_MB"])
    return kind, files, *(outcomes[what] for what in (*OUTCOMES, *BY_LIMIT)), slowest_s, peak_MB


def main() -> None:
    if sys.argv[1:2] == ["--child"]:
        child(sys.argv[2], sys.argv[3], int(sys.argv[4]), int(sys.argv[5]))
        return
    every = Commands(__doc__)
    for work, quick, max_count, shares in ((tables, 400, 100_000, TABLE_SHARES), (files, 140, 20_000, FILE_SHARES)):
        parser = every.add(work, f"{quick} files")
        parser.add_argument("--files", type=int, default=max_count)
        parser.add_argument("--seed", type=int, default=0)
        parser.add_argument("--kinds", nargs="+", choices=tuple(shares), default=tuple(shares), help="default: all")
    parser.add_argument("--kept", type=Path, help="file that keeps what was found, to go on after a break")
    every.run()


if __name__ == "__main__":
    main()
