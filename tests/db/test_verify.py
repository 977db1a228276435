"""What `verify` looks at beside rows and blobs: the database itself, its schema, people, and what is kept elsewhere."""

import json
import sqlite3
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import create_engine, text
from sqlalchemy.pool import NullPool

from softcal.app.cli.main import main
from softcal.core.errors import RegistryError, SoftcalError
from softcal.core.messages.reason import plain
from softcal.core.recording import OutputRecording
from softcal.core.unit.state_json import adjustments_to_json, fit_to_json
from softcal.db.connection import open_registry
from softcal.db.entries import Anchor, GoldenRun
from softcal.db.maintenance import checks
from softcal.db.maintenance.backup import back_up, restore
from softcal.db.repositories.lot_pages import UnitFilter
from softcal.db.schema.tables import AUDITED, metadata


@pytest.fixture
def people(factory):
    factory.calibrate("A1", 1)
    factory.calibrate("A1", 2)
    factory.registry.people.set("kim", "operator", "2580", actor="lee")
    factory.registry.people.set("lee", "quality", "7777", actor="lee")
    return factory.registry


def behind(registry, *statements: str) -> None:
    """Change a registry as an administrator can; triggers stay where they are."""
    engine = create_engine(registry.database.engine.url, poolclass=NullPool)
    with engine.begin() as connection:
        if not registry.database.is_sqlite:
            connection.execute(text("SET LOCAL session_replication_role = replica"))
        for statement in statements:
            connection.execute(text(statement))


@pytest.mark.parametrize("is_quick", [True, False])
@pytest.mark.parametrize(
    ("statement", "fault"),
    [
        ("UPDATE users SET role = 'quality' WHERE name = 'kim'", 'users ["kim"]: role'),
        ("UPDATE users SET pin_hash = (SELECT pin_hash FROM users WHERE name = 'lee') WHERE name = 'kim'", "PIN"),
        ("UPDATE users SET is_active = false WHERE name = 'lee'", 'users ["lee"]'),
        ("INSERT INTO users SELECT 'eve', role, pin_hash, is_active, failures, locked_until, version, changed_at "
         "FROM users WHERE name = 'lee'", 'users ["eve"]'),
        ("DELETE FROM users WHERE name = 'lee'", 'users ["lee"]'),
        ("UPDATE registry_info SET value = 'deadbeef0000' WHERE key = 'origin'", "origin 'deadbeef0000'"),
        ("CREATE TABLE aside (x INTEGER)", "table aside"),
    ],
)  # fmt: skip
def test_what_was_changed_behind_its_back_is_found(people, statement, fault, is_quick):
    assert people.verify(is_quick=is_quick) == []
    behind(people, statement)
    try:
        assert any(fault in line for line in people.verify(is_quick=is_quick))
    finally:
        # The database of PostgreSQL is shared by the tests.
        if "aside" in statement:
            behind(people, "DROP TABLE aside")
        if "registry_info" in statement:
            behind(people, f"UPDATE registry_info SET value = '{people.origin}' WHERE key = 'origin'")


@pytest.mark.parametrize("rows", [1, 2, 5, 1000])
def test_a_quick_look_finds_nothing_wrong_wherever_in_a_whole_trail_it_begins(people, monkeypatch, rows):
    monkeypatch.setattr(checks, "ROWS_OF_QUICK", rows)
    assert people.verify(is_quick=True) == []


def test_triggers_that_are_gone_off_or_others_are_found(people):
    before, after = (
        ("DROP TRIGGER audit_no_update", None)
        if people.database.is_sqlite
        else ("ALTER TABLE audit DISABLE TRIGGER audit_append_only", "ALTER TABLE audit ENABLE TRIGGER ALL")
    )
    behind(people, before)
    try:
        assert any("trigger audit_" in line for line in people.verify(is_quick=True))
    finally:
        if after:
            behind(people, after)


def test_a_function_that_forbids_nothing_any_more_is_found(people):
    if people.database.is_sqlite:
        behind(people, "DROP TRIGGER blobs_no_delete",
               "CREATE TRIGGER blobs_no_delete BEFORE DELETE ON blobs BEGIN SELECT 1; END")  # fmt: skip
        assert any("blobs_no_delete" in line for line in people.verify())
        return
    with people.database.reading() as connection:
        definition = connection.execute(text("SELECT pg_get_functiondef('softcal_append_only'::regproc)")).scalar_one()
    behind(people, "CREATE OR REPLACE FUNCTION softcal_append_only() RETURNS trigger LANGUAGE plpgsql AS "
                   "$$ BEGIN RETURN NULL; END $$")  # fmt: skip
    try:
        assert people.verify() != []
    finally:
        behind(people, definition)


@pytest.mark.parametrize(("kind", "other"), [("arrays", "array"), ("arrays", "document"), ("array", "arrays")])
def test_a_blob_of_another_kind_is_found(people, kind, other):
    long = np.linspace(0.0, 1.0, 2000)
    people.recordings.add("L1", OutputRecording("A1", np.arange(2000) / 50.0, long, 50.0), "unit")
    if people.database.is_sqlite:
        behind(people, "DROP TRIGGER blobs_no_update")
    behind(people, f"UPDATE blobs SET kind = '{other}' WHERE sha256 = "
                   f"(SELECT min(sha256) FROM blobs WHERE kind = '{kind}')")  # fmt: skip
    assert any(line.startswith("blob ") for line in people.verify())


def test_a_trail_that_was_cut_is_found_by_what_is_kept_elsewhere(people):
    anchor = Anchor(people.trail.heads(), "in a safe")
    assert people.verify(anchors=[anchor]) == []
    last = people.trail.heads()[people.origin][0]
    if people.database.is_sqlite:
        behind(people, "DROP TRIGGER audit_no_delete")
    behind(people, f"DELETE FROM audit WHERE seq = {last}")
    assert any(f"row {last}" in line for line in people.verify(is_quick=True, anchors=[anchor]))


def test_rows_that_refer_to_nothing_are_found(people):
    if people.database.is_sqlite:
        behind(people, "DROP TRIGGER networks_no_delete")
    behind(people, "DELETE FROM networks")
    assert any(line.startswith("fits: 2 rows") and "networks" in line for line in people.verify())


def test_the_command_remembers_where_the_trail_ended(file_registry, make_factory, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    make_factory(file_registry).calibrate("A1", 1)
    url, backup = f"sqlite:///{file_registry.database.path}", tmp_path / "b.db"
    assert main(["registry", "backup", str(backup), "--registry", url]) == 0
    assert main(["registry", "verify", "--quick", "--registry", url]) == 0
    behind(file_registry, "DROP TRIGGER audit_no_delete", "DELETE FROM audit WHERE seq = (SELECT max(seq) FROM audit)")
    for more in ([], ["--against", str(backup)]):
        assert main(["registry", "verify", "--registry", url, *more]) == 4
    for content in ("{}", "[" * 100_000):
        (tmp_path / "nothing.json").write_text(content)
        assert main(["registry", "verify", "--registry", url, "--against", str(tmp_path / "nothing.json")]) == 2


def test_after_a_restore_the_trail_begins_with_it(people, tmp_path):
    back_up(people.database, tmp_path / "b.db")
    restore(tmp_path / "b.db", f"sqlite:///{tmp_path / 'again.db'}")
    with open_registry(f"sqlite:///{tmp_path / 'again.db'}") as again:
        first = again.trail.rows(again.origin)[0]
        assert first.action == "restore"
        heads = {origin: tuple(head) for origin, head in json.loads(first.after)["heads"].items()}
        assert heads == people.trail.heads()
        assert again.verify() == [] and again.verify(is_quick=True) == []
    assert main(["registry", "verify", "--registry", f"sqlite:///{tmp_path / 'again.db'}"]) == 0


def edits(registry) -> list[str]:
    """One change of every column of every table that decides something, and one row less of each."""
    edits_made = []
    for name in (*AUDITED, "audit", "blobs", "users"):
        table = metadata.tables[name]
        for column in table.columns:
            kind = column.type.python_type
            change = {
                int: f'"{column.name}" + 1', float: f'"{column.name}" * 1.5', bool: f'NOT "{column.name}"',
                bytes: "x'00'",
            }.get(kind, f"replace(replace(\"{column.name}\", '1', '2'), 'a', 'b') || 'x'")  # fmt: skip
            change = f"coalesce({change}, {1 if kind in (int, float) else repr('x')})"
            edits_made.append(
                f'UPDATE {name} SET "{column.name}" = {change} WHERE rowid = (SELECT max(rowid) FROM {name})'
            )
        edits_made.append(f"DELETE FROM {name} WHERE rowid = (SELECT max(rowid) FROM {name})")
    return edits_made


@pytest.mark.parametrize(
    ("statement", "message", "is_reported_at_use"),
    [
        # The same instant to Python, and behind every other one to the database.
        ("UPDATE refusals SET made_at = replace(made_at, ' ', 'T')", "made_at", True),
        ("UPDATE lots SET added_at = replace(added_at, ' ', '1')", "added_at", True),
        ("UPDATE audit SET at = replace(at, ' ', 'T') WHERE seq = 2", "damaged", False),
        ("UPDATE audits SET half = replace(half, ',', ', ')", "half", False),
        ("UPDATE golden_runs SET passed = 2", "passed", False),
    ],
)
def test_a_value_in_other_words_is_found(file_registry, make_factory, statement, message, is_reported_at_use):
    factory = make_factory(file_registry)
    factory.calibrate("A1", 1)
    file_registry.calibrations.refuse("L1", "A1", "fail", (plain("constant"),))
    file_registry.stations.add_golden_run(
        GoldenRun("s1", "L1", "G1", datetime(2026, 5, 4, tzinfo=UTC), 0.01, "N", True)
    )
    table = statement.split()[1]
    behind(file_registry, f"DROP TRIGGER {table}_no_update", statement)
    lines = [line for line in file_registry.verify() if not line.startswith("trigger ")]
    assert lines and all(table in line or line.startswith(("values", "audit trail", "rows")) for line in lines)
    if is_reported_at_use:
        with pytest.raises(RegistryError, match="damaged"):
            file_registry.lots.units("L1"), file_registry.lots.all()
    else:
        assert any(message in line for line in lines)


PASSING = ("failures", "locked_until", "changed_at")
"""Columns of people that change at every sign-in; docs/registry.md says so."""


@pytest.mark.long
def test_an_edit_of_any_column_of_any_row_is_found(file_registry, make_factory, recording_of, tmp_path, monkeypatch):
    # The tables stay as they are, and comparing them takes longer than all the rest.
    monkeypatch.setattr("softcal.db.maintenance.checks.schema_faults", lambda _: iter(()))
    factory = make_factory(file_registry)
    factory.registry.recordings.add("L1", recording_of("A1"), "unit")
    factory.calibrate("A1", 1)
    factory.registry.calibrations.refuse("L1", "A2", "fail", (plain("constant"),))
    factory.registry.people.set("kim", "operator", "2580", actor="lee")
    path, copy = file_registry.database.path, tmp_path / "edited.db"
    statements = [s for s in edits(file_registry) if not any(f'SET "{name}"' in s and "users" in s for name in PASSING)]
    file_registry.close()
    unseen = []
    for statement in statements:
        copy.write_bytes(path.read_bytes())
        raw = sqlite3.connect(copy)
        for (trigger,) in raw.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'").fetchall():
            raw.execute(f"DROP TRIGGER {trigger}")
        try:
            changed = raw.execute(statement).rowcount
            raw.commit()
        except sqlite3.IntegrityError:
            changed = 0
        raw.close()
        if changed:
            with open_registry(f"sqlite:///{copy}", create=False) as registry:
                if not [line for line in registry.verify() if not line.startswith("trigger ")]:
                    unseen.append(statement)
    assert unseen == []


def pages(path: Path) -> list[int]:
    """Where the pages of an SQLite file begin, one of each kind at least."""
    content = path.read_bytes()
    size = int.from_bytes(content[16:18], "big")
    return list(range(0, len(content), 65536 if size == 1 else size))


def answer(url: str) -> object:
    """What is told of the unit: its map in use, bit by bit, and its verdict everywhere."""
    with open_registry(url, create=False) as registry:
        stored = registry.calibrations.get("A1")
        fit = fit_to_json(stored.state.fit)
        arrays = {name: array.tobytes() for name, array in fit.arrays.items()}
        network = {name: a.tobytes() for name, a in registry.networks.get(stored.state.fit.network_id).arrays().items()}
        return (
            stored.revision,
            stored.origin,
            (fit.content, adjustments_to_json(stored.state), arrays),
            network,
            registry.lots.get("L1"),
        )


@pytest.mark.parametrize("seed", [7])
def test_no_flipped_bit_is_silent(file_registry, make_factory, tmp_path, seed, flips=120):
    factory = make_factory(file_registry)
    for number in (1, 2, 3):
        factory.calibrate("A1", number)
        factory.calibrate(f"B{number}", number)
    path, copy = Path(file_registry.database.path), tmp_path / "flipped.db"
    file_registry.close()
    true, rng = answer(f"sqlite:///{path}"), np.random.default_rng(seed)
    content, starts = path.read_bytes(), pages(path)
    silent, defects = [], []
    for _ in range(flips):
        at = int(rng.choice(starts)) + int(rng.integers(0, starts[1] if len(starts) > 1 else len(content)))
        flipped = bytearray(content)
        flipped[at] ^= 1 << int(rng.integers(0, 8))
        copy.write_bytes(flipped)
        try:
            answer_text = answer(f"sqlite:///{copy}")
        except SoftcalError:
            continue
        except Exception as error:
            defects.append((at, repr(error)))
            continue
        if answer_text != true:
            silent.append(at)
    assert silent == [] and defects == []


@pytest.mark.parametrize(
    "statement",
    [
        """UPDATE fits SET content = replace(content, '"rmse":0.1', '"rmse":0.2')""",
        "UPDATE fits SET method_id = replace(method_id, substr(method_id, 1, 8), 'ffffffff')",
        "UPDATE methods SET numbers = replace(numbers, '0.05', '0.06')",
        "UPDATE methods SET id = replace(id, substr(id, 1, 8), 'ffffffff')",
    ],
)
def test_whoever_reads_a_unit_is_told_that_its_fit_or_method_is_another(file_registry, make_factory, statement):
    make_factory(file_registry).calibrate("A1", 1)
    path = Path(file_registry.database.path)
    file_registry.close()
    with sqlite3.connect(path) as raw:
        raw.execute("PRAGMA foreign_keys = OFF")
        for table in ("fits", "methods"):
            raw.execute(f"DROP TRIGGER {table}_no_update")
        assert raw.execute(statement).rowcount == 1
    with open_registry(f"sqlite:///{path}", create=False) as registry:
        for read in (registry.calibrations.get, registry.calibrations.history):
            with pytest.raises(RegistryError):
                read("A1")
        with pytest.raises(RegistryError):
            registry.pages.unit_statuses("L1", ["A1"])


HIDDEN = {
    "a calibration in use": "sqlite_autoindex_calibrations_1",
    "a revision": "ix_calibrations_serial_input",
    "a statement": "sqlite_autoindex_in_use_1",
}


@pytest.mark.parametrize("index", HIDDEN.values(), ids=HIDDEN)
def test_a_row_that_a_damaged_index_hides_or_swaps_is_missed_by_whoever_asks(
    file_registry, make_factory, tmp_path, index
):
    factory = make_factory(file_registry)
    for number in (1, 2):
        for serial in ("A1", "B1"):
            factory.calibrate(serial, number)
    path, copy = Path(file_registry.database.path), tmp_path / "hidden.db"
    file_registry.close()
    with sqlite3.connect(path) as raw:
        size = raw.execute("PRAGMA page_size").fetchone()[0]
        pages = [n for (n,) in raw.execute("SELECT pageno FROM dbstat WHERE name = ? AND pagetype = 'leaf'", (index,))]

    def read_everything(url: str) -> list[object]:
        with open_registry(url, create=False) as registry:
            pages = registry.pages.unit_page("L1", UnitFilter()).units
            revisions = [[c.state.map_sha256 for c in registry.calibrations.history(serial)] for serial in ("A1", "B1")]
            revisions_in_use = [registry.calibrations.get(serial).revision for serial in ("A1", "B1")]
            return [registry.lots.units(), pages, revisions, revisions_in_use]

    true, content, refused, swapped = read_everything(f"sqlite:///{path}"), path.read_bytes(), 0, []
    for number in pages:
        for name in (b"A1", b"B1"):
            start = (number - 1) * size
            for at in range(start, start + size):
                if content[at : at + 2] == name:
                    # The index says another serial than the row it points to.
                    other = b"A1" if name == b"B1" else b"B1"
                    copy.write_bytes(content[:at] + other + content[at + 2 :])
                    try:
                        if read_everything(f"sqlite:///{copy}") != true:
                            swapped.append(at)
                    except SoftcalError:
                        refused += 1
    assert swapped == [] and refused > 0
