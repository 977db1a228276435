"""What becomes of a registry that was damaged or edited behind softcal's back: flipped bits of the file, rows by SQL.

    python benchmarks/registry_damage.py [--quick] [--flips 1000] [--edits 1000] [--seed N] [--blind]

flips: one bit each, spread evenly over the kinds of pages SQLite has. `told at use` is refused by whoever asks for what
is in use; `found by verify` gave the same answers, and verify names it; `without effect` gave the same answers, bit by
bit, and verify finds nothing; `silent` gave another answer without a word.
edits: one cell, one row less or one row more each, over all tables. `documented` is what docs/registry.md says verify
cannot see. `--blind` turns the checks off, to see that the benchmark would tell.
"""

import contextlib
import random
import sqlite3
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from datetime import UTC, date, datetime
from pathlib import Path
from unittest import mock

import numpy as np
from common.command import parser_of
from common.registries import begin_lot, state
from common.tables import print_table

from softcal.core.errors import InputError, SoftcalError
from softcal.core.lot import UnitKey
from softcal.core.messages.reason import plain
from softcal.core.orders import Order, OrderKind
from softcal.core.quality.line_rules import LineRules
from softcal.core.recording import OutputRecording
from softcal.core.unit.state_json import adjustments_to_json, fit_to_json
from softcal.db.connection import open_registry
from softcal.db.entries import CellCertificate, GoldenRun
from softcal.db.maintenance import checks
from softcal.db.queues.work_queue import WorkSet
from softcal.db.registry import Registry
from softcal.db.repositories.registry_base import RegistryBase
from softcal.db.schema.arrays import READ_BLOB
from softcal.db.schema.database import Database
from softcal.db.schema.tables import metadata

UNITS = 24
KINDS = {2: "index, inner", 5: "table, inner", 10: "index, leaf", 13: "table, leaf"}
HEADER_BYTES = 100
PASSING = {
    "users": {"failures", "locked_until", "changed_at"},
    "work_items": set(), "orders": set(), "run_signals": set(), "heartbeats": set(), "jobs": set(),
    "line_places": set(),
}  # fmt: skip
"""Tables, or columns of them, that docs/registry.md says verify does not see; an empty set means every column."""

FLIPS = ("page", "flips", "told at use", "found by verify", "without effect", "silent", "defect")
EDITS = ("table", "edits", "found by verify", "refused by the database", "changed nothing", "documented", "unseen")


def make(path: Path, units: int = UNITS) -> None:
    """Fill a registry with something in every table that decides, enough for pages of every kind."""
    with open_registry(f"sqlite:///{path}") as registry:
        network_id = begin_lot(registry)
        for k in range(units):
            serial, output = f"U{k:03d}", np.random.default_rng(k).normal(size=400)
            registry.recordings.add("bench", OutputRecording(serial, np.arange(400) / 50.0, output, 50.0), "unit")
            for number in (1, 2):
                registry.calibrations.add("bench", state(serial, 10 * k + number, network_id))
        registry.calibrations.rollback("U003", 1, reason="remounted")
        registry.calibrations.refuse("bench", "U004", "retest", (plain("cable"),))
        registry.lots.set_limit("bench", 0.2, reason="agreed")
        registry.lots.set_line_rules("bench", LineRules(), reason="first lot")
        registry.adaptations.add(
            UnitKey("bench", "U001"), 1, [{"stream": "s", "sample": k, "gain": 1.0 + k} for k in range(3)]
        )
        registry.stations.add_golden_run(GoldenRun("s1", "L1", "G1", datetime(2026, 5, 4, tzinfo=UTC), 0.01, "N", True))
        registry.stations.add_certificate(
            CellCertificate("C1", "7", "lab", date(2026, 1, 1), date(2027, 1, 1), 50.0, 0.01, b"document")
        )
        registry.networks.withdraw(network_id, reason="to be trained again")
        for name, role in (("kim", "operator"), ("lee", "quality")):
            registry.people.set(name, role, "2580", actor="lee")
        registry.work_queue.enqueue(WorkSet("bench", "a" * 64), {f"U{k:03d}": "b" * 64 for k in range(units)})
        registry.order_queue.place(Order("o1", "s1", OrderKind.UNIT, "U001", "bench", "kim", "", datetime.now(UTC)))
        registry.job_board.place("gap", {"case": 1}, "kim")
        registry.line_sessions.write("s1", 0, {"serial": "U001"})
    # Free pages are a kind of their own.
    with contextlib.closing(sqlite3.connect(path)) as raw:
        raw.executescript("CREATE TABLE gone (x); INSERT INTO gone VALUES (zeroblob(20000)); DROP TABLE gone;")
        raw.execute("PRAGMA wal_checkpoint(TRUNCATE)")


def answers(registry: Registry) -> object:
    """Return all that people are told: of each unit its map in use and history, limits, rules, networks, people."""
    answers_given: list[object] = [
        registry.lots.units(),
        registry.lots.all(),
        registry.lots.limit_versions("bench"),
        registry.people.all(),
    ]
    for unit in registry.lots.units("bench"):
        for ask in (registry.calibrations.get, lambda serial: registry.calibrations.history(serial)[-1]):
            try:
                stored = ask(unit.serial)
            except (InputError, IndexError) as error:
                answers_given.append(str(error))
                continue
            fit = fit_to_json(stored.state.fit)
            arrays = {name: array.tobytes() for name, array in fit.arrays.items()}
            content = (fit.content, adjustments_to_json(stored.state), arrays)
            answers_given.append((stored.revision, stored.origin, stored.is_current, content))
    for network in registry.networks.all():
        answers_given.append({name: a.tobytes() for name, a in registry.networks.get(network.id).arrays().items()})
    answers_given += [
        registry.networks.states("bench"),
        registry.lots.line_rules_versions("bench"),
        registry.stations.golden_runs(),
    ]
    return [*answers_given, registry.stations.certificates("C1"), registry.adaptations.all(UnitKey("bench", "U001"))]


def whole(registry: Registry) -> bool:
    """Whether verify finds nothing; what costs most is asked last."""
    with mock.patch.object(checks, "schema_faults", lambda _: iter(())):
        if registry.verify():
            return False
    return not registry.verify()


def pages_by_kind(path: Path) -> dict[str, list[tuple[int, int]]]:
    """Return where each page begins and ends, by its kind, as its first byte and the b-tree's own statistics say."""
    content = path.read_bytes()
    size = int.from_bytes(content[16:18], "big")
    with contextlib.closing(sqlite3.connect(path)) as raw:
        in_use = {number: kind for number, kind in raw.execute("SELECT pageno, pagetype FROM dbstat")}
    ranges: dict[str, list[tuple[int, int]]] = {"header": [(0, HEADER_BYTES)]}
    for number in range(1, len(content) // size + 1):
        start = (number - 1) * size
        first = content[start + (HEADER_BYTES if number == 1 else 0)]
        kind = in_use.get(number, "free")
        name = KINDS.get(first, "?") if kind in ("leaf", "internal") else kind
        ranges.setdefault(name, []).append((start + (HEADER_BYTES if number == 1 else 0), start + size))
    return ranges


def verdict_of_flip(copy: Path, true: object) -> str:
    """Return what softcal says of a damaged file."""
    url = f"sqlite:///{copy}"
    try:
        with open_registry(url, create=False) as registry:
            answers_given = answers(registry)
    except SoftcalError:
        return "told at use"
    except Exception as error:
        print(f"defect: {type(error).__name__}: {error}")
        return "defect"
    try:
        with open_registry(url, create=False) as registry:
            is_whole = whole(registry)
    except SoftcalError:
        is_whole = False
    if answers_given != true:
        # Whoever verifies hears of it; whoever only asks does not, and that is what must not be.
        return "silent"
    return "without effect" if is_whole else "found by verify"


def flips(path: Path, folder: Path, count: int, seed: int) -> Iterator[tuple[object, ...]]:
    """Flip one bit at a time, as many on each kind of page, and give a row per kind."""
    rng, content, copy = random.Random(seed), path.read_bytes(), folder / "flipped.db"
    with open_registry(f"sqlite:///{path}", create=False) as registry:
        true = answers(registry)
        if not whole(registry):
            raise SystemExit("the registry was not whole before")
    kinds = pages_by_kind(path)
    for kind, pages in sorted(kinds.items()):
        outcomes: Counter[str] = Counter()
        for _ in range(max(1, count // len(kinds))):
            start, stop = rng.choice(pages)
            flipped = bytearray(content)
            flipped[rng.randrange(start, stop)] ^= 1 << rng.randrange(8)
            copy.write_bytes(flipped)
            outcomes[verdict_of_flip(copy, true)] += 1
            for suffix in ("-wal", "-shm"):
                copy.with_name(copy.name + suffix).unlink(missing_ok=True)
        yield kind, sum(outcomes.values()), *(outcomes[name] for name in FLIPS[2:])


def an_edit(rng: random.Random, raw: sqlite3.Connection, table: str) -> tuple[str, int]:
    """Change one thing of a table; return the column ("" for a whole row) and how many rows changed."""
    columns = [column.name for column in metadata.tables[table].columns]
    rows = [row for (row,) in raw.execute(f"SELECT rowid FROM {table}")]
    if not rows:
        return "", 0
    row, column, what = rng.choice(rows), rng.choice(columns), rng.randrange(10)
    if what == 0:
        return "", raw.execute(f"DELETE FROM {table} WHERE rowid = ?", (row,)).rowcount
    if what == 1:
        # A row like it under another key: somebody puts in what was never decided.
        key = metadata.tables[table].primary_key.columns
        assignments = ", ".join(
            (f"\"{c}\" || 'x'" if metadata.tables[table].c[c].type.python_type is str else f'"{c}" + 17')
            if c in key else f'"{c}"' for c in columns
        )  # fmt: skip
        column_list = ", ".join(f'"{c}"' for c in columns)
        return "", raw.execute(
            f"INSERT INTO {table} ({column_list}) SELECT {assignments} FROM {table} WHERE rowid = ?", (row,)
        ).rowcount
    (old,) = raw.execute(f'SELECT "{column}" FROM {table} WHERE rowid = ?', (row,)).fetchone()
    other = [value for (value,) in raw.execute(f'SELECT DISTINCT "{column}" FROM {table}') if value != old]
    new = rng.choice([*other, None, *_changed(rng, old)]) if what < 9 else None
    if new == old:
        return column, 0
    return column, raw.execute(f'UPDATE {table} SET "{column}" = ? WHERE rowid = ?', (new, row)).rowcount


def _changed(rng: random.Random, value: object) -> list[object]:
    if isinstance(value, (int, float)):
        return [value + 1, -value, value * 1.0001]
    if isinstance(value, bytes) and value:
        at = rng.randrange(len(value))
        return [value[:at] + bytes([value[at] ^ 1]) + value[at + 1 :]]
    text = str(value or "x")
    at = rng.randrange(len(text))
    return [text + "x", text[:at] + ("1" if text[at] != "1" else "2") + text[at + 1 :]]


def edits(path: Path, folder: Path, count: int, seed: int) -> Iterator[tuple[object, ...]]:
    """Change one thing at a time by SQL, in every table as often, and give a row per table."""
    rng, content, copy = random.Random(seed), path.read_bytes(), folder / "edited.db"
    with contextlib.closing(sqlite3.connect(path)) as raw:
        filled = [t.name for t in metadata.sorted_tables if raw.execute(f"SELECT 1 FROM {t.name} LIMIT 1").fetchone()]
    for table in filled:
        outcomes: Counter[str] = Counter()
        for _ in range(max(1, round(count / len(filled)))):
            copy.write_bytes(content)
            with contextlib.closing(sqlite3.connect(copy)) as raw:
                for (trigger,) in raw.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'").fetchall():
                    raw.execute(f"DROP TRIGGER {trigger}")
                try:
                    column, changed = an_edit(rng, raw, table)
                except sqlite3.IntegrityError:
                    outcomes["refused by the database"] += 1
                    continue
                raw.commit()
            verdict = _verdict_of_edit(copy, table, column) if changed else "changed nothing"
            outcomes[verdict] += 1
            if verdict == "unseen":
                print(f"unseen: {table}.{column or '(row)'}")
        yield table, sum(outcomes.values()), *(outcomes[name] for name in EDITS[2:])


def _verdict_of_edit(copy: Path, table: str, column: str) -> str:
    try:
        with open_registry(f"sqlite:///{copy}", create=False) as registry:
            with mock.patch.object(checks, "schema_faults", lambda _: iter(())):
                lines = registry.verify()
            # The triggers were dropped to get here; somebody with more time puts them back.
            if any(not line.startswith("trigger ") for line in lines):
                return "found by verify"
    except SoftcalError:
        return "found by verify"
    columns = PASSING.get(table)
    return "unseen" if columns is None or (columns and column not in columns) else "documented"


def _bytes_as_they_are(database: Database, sha256: str) -> bytes:
    return bytes(database.value(READ_BLOB, {"sha": sha256}))


@contextlib.contextmanager
def blind() -> Iterator[None]:
    """Turn the checks off: a benchmark that tells nothing then tells nothing ever."""
    nothing: Callable[..., object] = lambda *_, **__: iter(())  # noqa: E731
    with contextlib.ExitStack() as stack:
        stack.enter_context(mock.patch.object(RegistryBase, "_check_row", lambda *_: None))
        stack.enter_context(mock.patch.object(RegistryBase, "_check_hidden", lambda *_: None))
        stack.enter_context(mock.patch("softcal.db.schema.arrays.get_bytes", _bytes_as_they_are))
        stack.enter_context(mock.patch("softcal.db.repositories.history.chain_faults", nothing))
        for name in (
            "page_faults",
            "reference_faults",
            "people_faults",
            "origin_faults",
            "_row_faults",
            "_blob_faults",
        ):
            stack.enter_context(mock.patch.object(checks, name, nothing))
        yield


def main() -> None:
    parser = parser_of(__doc__, "40 flips and 40 edits")
    parser.add_argument("--flips", type=int, default=1000)
    parser.add_argument("--edits", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--blind", action="store_true", help="without the checks: silent and unseen must appear")
    options = parser.parse_args()
    count_flips, count_edits = (40, 40) if options.quick else (options.flips, options.edits)
    with tempfile.TemporaryDirectory(prefix="softcal-bench-") as name:
        folder = Path(name)
        path = folder / "registry.db"
        make(path)
        with blind() if options.blind else contextlib.nullcontext():
            if count_flips:
                print_table(FLIPS, flips(path, folder, count_flips, options.seed))
            print()
            if count_edits:
                print_table(EDITS, edits(path, folder, count_edits, options.seed))


if __name__ == "__main__":
    main()
