"""A role of the line can calibrate and cannot rewrite history; a reader can only read."""

import uuid
from contextlib import nullcontext
from datetime import date
from functools import partial

import pytest
from sqlalchemy import text

from softcal.core.errors import InputError, RegistryError
from softcal.core.lot import Lot
from softcal.core.messages.reason import plain
from softcal.core.quality.line_rules import LineRules
from softcal.db.access.grants import grant_statements
from softcal.db.connection import open_registry
from softcal.db.entries import CellCertificate
from softcal.db.queues.work_queue import WorkSet
from softcal.db.registry import Registry
from softcal.db.schema.tables import metadata
from tests.system_packages import NO_POSTGRESQL


@pytest.fixture
def as_role(postgresql_admin, require):
    """`as_role("line" | "manager" | "reader")` gives a registry of somebody who signed in with that role."""
    require(postgresql_admin is not None, NO_POSTGRESQL)
    mark = uuid.uuid4().hex[:8]
    name, roles = f"softcal_test_{mark}", {kind: f"{kind}_{mark}" for kind in ("line", "manager", "reader")}
    postgresql_admin.execute(text(f"CREATE DATABASE {name}"))
    url = postgresql_admin.engine.url.set(database=name)
    for role in roles.values():
        postgresql_admin.execute(text(f"CREATE ROLE {role} LOGIN PASSWORD '{mark}'"))
    owner_url = url.render_as_string(hide_password=False)
    with open_registry(owner_url) as owner, owner.database.writing() as connection:
        for statement in grant_statements(**roles):
            connection.execute(text(statement))
    opened = []

    def registry_of(kind: str) -> Registry:
        mine = url.set(username=roles[kind], password=mark)
        opened.append(open_registry(mine.render_as_string(hide_password=False), create=False))
        return opened[-1]

    yield registry_of
    for registry in opened:
        registry.close()
    postgresql_admin.execute(text(f"DROP DATABASE {name} WITH (FORCE)"))
    for role in roles.values():
        postgresql_admin.execute(text(f"DROP ROLE {role}"))


def test_the_line_can_do_all_its_work(as_role, make_factory, recording_of):
    manager = as_role("manager")
    make_factory(manager)
    manager.people.set("kim", "operator", "2580", actor="admin")
    registry = as_role("line")
    factory = make_factory(registry)
    registry.recordings.add("L1", recording_of("A1"), "unit")
    factory.calibrate("A1", 1)
    factory.calibrate("A1", 2)
    registry.calibrations.rollback("A1", 1, reason="remounted")
    registry.lots.add(Lot("L2", "S0", 50.0))
    queue, work = registry.work_queue, WorkSet("L1", "a" * 64)
    queue.enqueue(work, {"A1": "b" * 64})
    assert all(queue.finish("me", [item.id]) for item in queue.claim("me", work, 1, 60))
    with pytest.raises(InputError):
        registry.people.sign_in("kim", "0000")
    assert registry.people.sign_in("kim", "2580").name == "kim" and registry.verify() == []


def test_what_the_line_may_not_set_is_reported_in_one_line(as_role, make_factory):
    make_factory(as_role("manager"))
    line = as_role("line")
    for forbidden in (
        lambda: line.lots.set_limit("L1", 5.0, reason="easier"),
        lambda: line.lots.set_line_rules("L1", LineRules(), reason="easier"),
        lambda: line.people.set("eve", "quality", "1234", actor="eve"),
        lambda: line.stations.add_certificate(
            CellCertificate("C", "1", "x", date(2026, 1, 1), date(2027, 1, 1), 50.0, 0.1)
        ),
    ):
        with pytest.raises(RegistryError, match="permission denied") as refused:
            forbidden()
        assert "\n" not in str(refused.value)
    assert line.verify() == []


NEEDED_BY_THE_LINE = {
    "blobs": {"INSERT"}, "lots": {"INSERT"}, "units": {"INSERT"}, "recordings": {"INSERT"}, "networks": {"INSERT"},
    "methods": {"INSERT"}, "fits": {"INSERT"}, "trims": {"INSERT"}, "corrections": {"INSERT"},
    "sample_releases": {"INSERT"}, "audits": {"INSERT"}, "source_networks": {"INSERT"}, "load_readings": {"INSERT"},
    "checked_units": {"INSERT"}, "lot_decisions": {"INSERT"},
    "calibrations": {"INSERT"}, "refusals": {"INSERT"}, "in_use": {"INSERT"}, "audit": {"INSERT"},
    "adaptations": {"INSERT"}, "golden_runs": {"INSERT"}, "work_items": {"INSERT", "UPDATE", "DELETE"},
    "orders": {"INSERT", "UPDATE"}, "heartbeats": {"INSERT", "UPDATE"}, "run_signals": {"INSERT", "DELETE"},
    "jobs": {"INSERT", "UPDATE"}, "line_places": {"INSERT", "UPDATE"},
    "deliveries": {"INSERT", "UPDATE"},
    "alerts": {"INSERT"}, "draws": {"INSERT"}, "drawn_units": {"INSERT"}, "exports": {"INSERT"},
    "known_loads": {"INSERT"}, "line_spreads": {"INSERT"}, "lot_references": {"INSERT"}, "lot_sources": {"INSERT"},
    "lot_statements": {"INSERT"}, "map_families": {"INSERT"}, "station_qualifications": {"INSERT"},
    "unit_golden_runs": {"INSERT"},
}  # fmt: skip
"""Written down by hand: what a line does. Everything else must be refused."""


@pytest.mark.parametrize("kind", ["line", "reader"])
def test_every_change_of_every_table_is_tried_by_who_may_not_make_it(as_role, make_factory, kind):
    make_factory(as_role("manager")).calibrate("A1", 1)
    database, allowed = as_role(kind).database, NEEDED_BY_THE_LINE if kind == "line" else {}
    wrong = []
    for name in (*(table.name for table in metadata.sorted_tables), "alembic_version"):
        column = "version_num" if name == "alembic_version" else metadata.tables[name].c[0].name
        # Without rows: PostgreSQL asks for the right before it looks for any.
        tries = {
            "INSERT": f'INSERT INTO {name} ("{column}") SELECT "{column}" FROM {name} WHERE false',
            "UPDATE": f'UPDATE {name} SET "{column}" = "{column}" WHERE false',
            "DELETE": f"DELETE FROM {name} WHERE false",
            "TRUNCATE": f"TRUNCATE {name} CASCADE",
            "DROP": f"DROP TABLE {name} CASCADE",
            "ALTER": f"ALTER TABLE {name} DISABLE TRIGGER ALL",
        }
        for right, statement in tries.items():
            try:
                with database.writing() as connection:
                    connection.execute(text(statement))
                is_done = True
            except RegistryError as error:
                is_done = "permission denied" not in str(error) and "must be owner" not in str(error)
            # The triggers of append-only tables refuse more than that; here only rights count.
            if is_done != (right in allowed.get(name, ())):
                wrong.append((name, right, is_done))
    assert wrong == []


@pytest.mark.parametrize("column", [c.name for c in metadata.tables["users"].c])
def test_of_people_the_line_may_count_wrong_pins_only(as_role, column):
    database = as_role("line").database
    statement = text(f'UPDATE users SET "{column}" = "{column}" WHERE false')
    is_allowed = column in ("failures", "locked_until")
    refused = nullcontext() if is_allowed else pytest.raises(RegistryError, match="permission denied")
    with refused, database.writing() as connection:
        connection.execute(statement)


def test_a_reader_lists_and_is_told_in_one_line_that_it_may_not_write(as_role, make_factory):
    make_factory(as_role("manager")).calibrate("A1", 1)
    reader = as_role("reader")
    assert [unit.serial for unit in reader.lots.units("L1")] == ["A1", "S0"]
    with pytest.raises(RegistryError, match="read-only for the database account") as refused:
        reader.trail.add("use", "unit", ("L1", "A1"), {"verdict": "fail"})
    assert "\n" not in str(refused.value)


def test_a_reader_reads_units_and_no_pins(as_role, make_factory):
    make_factory(as_role("manager")).calibrate("A1", 1)
    reader = as_role("reader")
    assert reader.calibrations.get("A1").revision == 1
    refuse = partial(reader.calibrations.refuse, "L1", "A2", "retest", (plain("cable"),))
    # What may not be read is no fault of the registry.
    for forbidden in (reader.people.all, refuse, reader.verify):
        with pytest.raises(RegistryError, match="permission denied"):
            forbidden()


def test_a_name_that_is_no_role_is_refused():
    with pytest.raises(InputError, match="role"):
        grant_statements("line; DROP TABLE audit", "reader", "manager")
