"""Malformed tables by the thousand: `softcal import` refuses each in words, or makes the lot that stands in it.

    python benchmarks/import_fuzz.py [--quick] [--files 100000] [--seed N] [--kinds csv ...]

Every file is a good table with one to three things broken in it, as CSV, Excel or Parquet. What was made is compared
with a reading of the same text by Python's own `csv` and `float`, which knows nothing of pandas; a file that reading
cannot make sense of must have been refused. `traceback` counts every exception but the one line for the user.
"""

import argparse
import csv
import io
import random
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from common.tables import print_table

from softcal.app.files.importing import Columns, ImportPlan, import_lot
from softcal.app.files.lot_folder import open_lot_folder
from softcal.core.errors import InputError
from softcal.core.lot import Lot

ROWS = 40
HEADER = ("kind", "files", "refused in one line", "made as it stands", "traceback", "wrong lot", "left by half", "s")
ODD = (
    *("", " ", "nan", "inf", "-inf", "1e400", "abc", "=1+1", "True", "0x1A", "1,5", "1_000", "\u0661", "\u22121", "1e"),
    *(
        "--1",
        '"',
        "'",
        "\0",
        "\x1a",
        "\ufeff",
        "NULL",
        "#N/A",
        "12:00",
        "2026-01-01",
        "9" * 400,
        "1e-400",
        "+",
        ".",
        "\\N",
    ),
)
KINDS = ("csv", "bytes", "xlsx", "parquet")


def good_rows(rng: random.Random) -> list[list[str]]:
    """Return a table of text cells: header, then `ROWS` samples at 50 Hz."""
    rows = [["t_s", "output", "reference"]]
    return rows + [[f"{k / 50:.2f}", f"{rng.uniform(0, 3):.6f}", f"{rng.uniform(0, 9):.4f}"] for k in range(ROWS)]


def broken(rng: random.Random, rows: list[list[str]]) -> str:
    """Return the table as text with one thing broken."""
    row, cell = rng.randrange(len(rows)), rng.randrange(3)
    what = rng.randrange(12)
    if what == 0:
        rows[row][cell % len(rows[row])] = rng.choice(ODD)
    elif what == 1:
        rows[row].append(rng.choice(ODD))
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
    """Return (n, 3) time, output and reference as the text has them, or None where it leaves doubt what they are."""
    try:
        rows = [row for row in csv.reader(io.StringIO(text, newline=""), strict=True) if row]
    except csv.Error:
        return None
    header = [cell.removeprefix("\ufeff") for cell in rows[0]] if rows else []
    if any(header.count(name) != 1 for name in ("t_s", "output", "reference")):
        return None
    places = [header.index(name) for name in ("t_s", "output", "reference")]
    try:
        values = np.array([[float(row[k].replace("_", "x")) for k in places] for row in rows[1:]])
    except (ValueError, IndexError):
        return None
    whole = all(len(row) <= len(header) for row in rows[1:]) and len(values) and np.isfinite(values).all()
    return values if whole else None


class Fuzz:
    """One kind of file, broken again and again."""

    def __init__(self, kind: str, folder: Path, rng: random.Random) -> None:
        self._kind, self._folder, self._rng = kind, folder, rng
        self.found: Counter[str] = Counter()
        self.examples: list[str] = []

    def one(self) -> None:
        """Break one file, import it, and count what became of it."""
        path, text = self._written()
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
        left = [entry for entry in self._folder.iterdir() if entry != path]
        if left:
            self._count("left", str(left))

    def _written(self) -> tuple[Path, str | None]:
        rows = good_rows(self._rng)
        path = self._folder / f"S0.{'csv' if self._kind == 'bytes' else self._kind}"
        if self._kind == "csv":
            text = broken(self._rng, rows)
            path.write_bytes(text.encode())
            return path, text
        if self._kind == "bytes":
            content = damaged(self._rng, "\n".join(",".join(row) for row in rows).encode())
            path.write_bytes(content)
            try:
                return path, content.decode()
            except UnicodeDecodeError:
                return path, None
        path.write_bytes(damaged(self._rng, self._binary(rows)))
        return path, "\n".join(",".join(row) for row in rows)

    def _binary(self, rows: list[list[str]]) -> bytes:
        import pandas as pd

        table = pd.DataFrame(rows[1:], columns=rows[0]).astype(float)
        content = io.BytesIO()
        table.to_excel(content, index=False) if self._kind == "xlsx" else table.to_parquet(
            content, index=False, write_page_checksum=True
        )
        return content.getvalue()

    def _is_right(self, out: Path, text: str | None) -> bool:
        source = open_lot_folder(out).read_source()
        got = np.column_stack([source.unlabelled.t_s, source.unlabelled.output, source.reference])
        if self._kind in ("csv", "bytes"):
            right = None if text is None else expected(text)
            return right is not None and got.shape == right.shape and np.allclose(got, right, rtol=1e-14, atol=0)
        # Checksums of both formats cover the cells; what still opens must hold them all.
        right = expected(str(text))
        return right is not None and got.shape == right.shape and np.allclose(got, right, rtol=1e-14, atol=0)

    def _count(self, what: str, example: str) -> None:
        # A refusal because memory ran out is no refusal.
        what = "memory" if "MemoryError" in example else what
        self.found[what] += 1
        if what in ("traceback", "wrong", "left") and len(self.examples) < 12:
            self.examples.append(f"{self._kind} {what}: {example}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="400 files")
    parser.add_argument("--files", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS), help="default: all")
    options = parser.parse_args()
    files = 400 if options.quick else options.files
    shares = {"csv": 0.6, "bytes": 0.3, "xlsx": 0.04, "parquet": 0.06}
    examples: list[str] = []

    def rows() -> Iterator[tuple[object, ...]]:
        for kind in options.kinds:
            with tempfile.TemporaryDirectory(prefix="softcal-bench-") as folder:
                fuzz, start_s = Fuzz(kind, Path(folder), random.Random(f"{options.seed} {kind}")), time.perf_counter()
                count = round(shares[kind] * files)
                for _ in range(count):
                    fuzz.one()
                found = [fuzz.found[what] for what in ("refused", "made", "traceback", "wrong", "left")]
                examples.extend(fuzz.examples)
                yield kind, count, *found, time.perf_counter() - start_s

    print_table(HEADER, rows())
    for example in examples:
        print(example)


if __name__ == "__main__":
    main()
