"""Nothing in a registry can be edited, removed or put in unseen: not a row, not a byte, not a line of the trail."""

import hashlib
import json
from datetime import UTC, date, datetime

import numpy as np
import pytest
from sqlalchemy import create_engine, delete, insert, select, text, update
from sqlalchemy.pool import NullPool

from softcal.core.errors import RegistryError
from softcal.core.lot import UnitKey
from softcal.core.messages.reason import plain
from softcal.core.quality.line_rules import LineRules
from softcal.db.entries import CellCertificate, GoldenRun
from softcal.db.maintenance.sync import synchronise
from softcal.db.schema.arrays import get_arrays, parts_of, put_arrays
from softcal.db.schema.tables import APPEND_ONLY, audit, blobs, calibrations, fits, metadata, units
from tests.declarations import declare_all
from tests.unit_states import adjusted


@pytest.fixture
def past_the_triggers(registry):
    """`past_the_triggers(statement)` changes rows as somebody with the rights of an administrator can."""

    def execute(statement):
        # An engine of its own: SQLite checks foreign keys only where a connection asks for it.
        engine = create_engine(registry.database.engine.url, poolclass=NullPool)
        with engine.begin() as connection:
            if registry.database.is_sqlite:
                for name in connection.scalars(text("SELECT name FROM sqlite_master WHERE type = 'trigger'")).all():
                    connection.execute(text(f"DROP TRIGGER {name}"))
            else:
                connection.execute(text("SET LOCAL session_replication_role = replica"))
            connection.execute(statement)

    return execute


@pytest.fixture
def filled(factory, recording_of, labelled_of):
    declare_all(factory, labelled_of("S0"))
    factory.registry.recordings.add("L1", recording_of("A1"), "unit")
    factory.calibrate("A1", 1)
    factory.calibrate("A1", 2)
    factory.registry.calibrations.add("L1", adjusted(factory.state("A3")))
    factory.registry.calibrations.refuse("L1", "A2", "fail", (plain("constant"),))
    factory.registry.lots.set_line_rules("L1", LineRules(), reason="first lot")
    factory.registry.adaptations.add(UnitKey("L1", "A1"), 1, [{"stream": "s", "sample": 3, "gain": 1.5}])
    factory.registry.stations.add_golden_run(
        GoldenRun("s1", "L1", "G1", datetime(2026, 5, 4, 6, tzinfo=UTC), 0.01, "N", True)
    )
    factory.registry.decisions.add("L1", {"released": []}, action="withhold")
    factory.registry.networks.withdraw(factory.registry.networks.all()[0].id, reason="to be trained again")
    factory.registry.stations.add_certificate(
        CellCertificate("C1", "7", "lab", date(2026, 1, 1), date(2027, 1, 1), 50.0, 0.01)
    )
    return factory


def verify_without_triggers(registry):
    """Return what `verify` finds but for the triggers that `past_the_triggers` took away."""
    return [line for line in registry.verify() if not line.startswith("trigger ")]


def test_a_registry_in_use_is_whole(filled):
    assert filled.registry.verify() == []


def test_the_newest_rows_come_first_whoever_wrote_them(filled, make_factory, file_registry):
    other = make_factory(file_registry, "L2")
    synchronise(filled.registry, file_registry)
    other.calibrate("B1")
    synchronise(filled.registry, file_registry)
    rows = filled.registry.trail.rows()
    newest = filled.registry.trail.newest(7)
    assert newest == sorted(rows, key=lambda row: (row.at, row.origin, row.seq))[:-8:-1]
    assert newest[0].action == "put_in_use" and newest[0].origin == file_registry.origin


@pytest.mark.parametrize("table", APPEND_ONLY)
def test_the_database_refuses_to_change_or_delete_rows(filled, table):
    column = metadata.tables[table].c[0]
    for statement in (update(metadata.tables[table]).values({column: column}), delete(metadata.tables[table])):
        with pytest.raises(RegistryError, match=table), filled.registry.database.writing() as connection:
            connection.execute(statement)


@pytest.mark.parametrize(
    ("statement", "fault"),
    [
        (update(calibrations).where(calibrations.c.revision == 1).values(verdict="conditional"), '"A1",1'),
        (update(calibrations).where(calibrations.c.revision == 1).values(predicted_rmse=0.1000001), '"A1",1'),
        (delete(units).where(units.c.serial == "A2"), '"A2"'),
        (
            insert(units).from_select(
                ["lot_id", "serial", "role", "added_at"],
                select(units.c.lot_id, text("'A9'"), units.c.role, units.c.added_at).where(units.c.serial == "A1"),
            ),
            '"A9"',
        ),
        (update(audit).where(audit.c.seq == 4).values(actor="somebody else"), "row 4"),
        (delete(audit).where(audit.c.seq == 4), "rows 4"),
        (update(blobs).values(data=b"x"), "blob "),
        (delete(blobs), "blob "),
    ],
)
def test_verify_finds_what_was_done_behind_its_back(filled, past_the_triggers, statement, fault):
    past_the_triggers(statement)
    assert any(fault in line for line in verify_without_triggers(filled.registry))


def test_one_flipped_bit_in_a_blob_is_found_and_never_read(filled, past_the_triggers):
    with filled.registry.database.reading() as connection:
        stored = connection.execute(
            select(fits.c.blob_sha256)
            .join(calibrations, calibrations.c.fit_sha256 == fits.c.sha256)
            .where(calibrations.c.revision == 2)
        ).scalar_one()
        content = bytearray(connection.execute(select(blobs.c.data).where(blobs.c.sha256 == stored)).scalar_one())
    content[-1] ^= 1
    past_the_triggers(update(blobs).where(blobs.c.sha256 == stored).values(data=bytes(content)))
    (problem,) = verify_without_triggers(filled.registry)
    assert stored[:12] in problem
    with pytest.raises(RegistryError, match=stored[:12]):
        filled.registry.calibrations.get("A1")


@pytest.mark.parametrize("removed", [True, False], ids=["removed", "one bit flipped"])
def test_a_large_array_that_is_gone_or_changed_is_found_and_never_read(registry, past_the_triggers, removed):
    arrays = {"small": np.arange(3.0), "large": np.arange(4096.0)}
    with registry.database.writing() as connection:
        sha256 = put_arrays(registry.database, arrays)
        content = connection.execute(select(blobs.c.data).where(blobs.c.sha256 == sha256)).scalar_one()
        part = parts_of(content)["large"]
        stored = bytearray(connection.execute(select(blobs.c.data).where(blobs.c.sha256 == part)).scalar_one())
    assert registry.verify() == []
    stored[-1] ^= 1
    here = blobs.c.sha256 == part
    past_the_triggers(delete(blobs).where(here) if removed else update(blobs).where(here).values(data=bytes(stored)))
    (problem,) = verify_without_triggers(registry)
    assert part[:12] in problem and (sha256[:12] in problem) == removed
    with registry.database.reading(), pytest.raises(RegistryError, match=part[:12]):
        get_arrays(registry.database, sha256)


def test_an_edited_row_with_an_edited_trail_still_breaks_the_chain(filled, past_the_triggers):
    past_the_triggers(update(calibrations).where(calibrations.c.revision == 1).values(verdict="fail"))
    past_the_triggers(update(audit).where(audit.c.key.contains('"A1",1')).values(after=None))
    assert any("row " in line for line in verify_without_triggers(filled.registry))


def test_the_hash_of_a_row_can_be_computed_by_anybody(filled):
    row = filled.registry.trail.rows()[-1]
    fields = {name: value for name, value in vars(row).items() if name != "hash"}
    fields["at"] = row.at.isoformat(timespec="microseconds")
    text_of_row = json.dumps(fields, sort_keys=True, separators=(",", ":"))
    assert hashlib.sha256(text_of_row.encode()).hexdigest() == row.hash


def test_events_that_change_no_table_stand_in_the_trail(filled):
    filled.registry.trail.add("export", "shipments", ("A1", 2), {"format": "json"}, actor="kim", reason="shipment 7")
    last = filled.registry.trail.rows()[-1]
    assert (last.action, last.actor, last.reason) == ("export", "kim", "shipment 7")
    assert filled.registry.verify() == []
