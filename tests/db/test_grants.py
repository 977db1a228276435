"""A role of the line can calibrate and cannot rewrite history; a reader can only read."""

import uuid

import pytest
from sqlalchemy import event, text

from softcal.core.errors import InputError, RegistryError
from softcal.db.connection import open_registry
from softcal.db.database import open_database
from softcal.db.grants import grant_statements
from softcal.db.registry import Registry
from softcal.db.registry_base import RegistrySettings


@pytest.fixture
def as_role(postgresql_admin, require):
    """`as_role("line" | "reader")` gives a registry that is used with the rights of that role alone."""
    require(postgresql_admin is not None, "no PostgreSQL")
    mark = uuid.uuid4().hex[:8]
    name, roles = f"softcal_test_{mark}", {"line": f"line_{mark}", "reader": f"reader_{mark}"}
    postgresql_admin.execute(text(f"CREATE DATABASE {name}"))
    url = postgresql_admin.engine.url.set(database=name).render_as_string(hide_password=False)
    for role in roles.values():
        postgresql_admin.execute(text(f"CREATE ROLE {role}"))
    with open_registry(url) as owner, owner.database.writing() as connection:
        for statement in grant_statements(**roles):
            connection.execute(text(statement))
    opened = []

    def registry_of(kind: str) -> Registry:
        database = open_database(url)
        event.listen(database.engine, "begin", lambda connection: connection.exec_driver_sql(f"SET ROLE {roles[kind]}"))
        opened.append(Registry(database, RegistrySettings()))
        return opened[-1]

    yield registry_of
    for registry in opened:
        registry.close()
    postgresql_admin.execute(text(f"DROP DATABASE {name} WITH (FORCE)"))
    for role in roles.values():
        postgresql_admin.execute(text(f"DROP ROLE {role}"))


def test_the_line_can_do_all_its_work(as_role, make_factory, recording_of):
    registry = as_role("line")
    factory = make_factory(registry)
    registry.add_recording("L1", recording_of("A1"), "unit")
    factory.calibrate("A1", 1)
    factory.calibrate("A1", 2)
    registry.rollback("A1", 1, reason="remounted")
    registry.set_user("kim", "operator", "2580", actor="admin")
    assert registry.sign_in("kim", "2580").name == "kim" and registry.verify() == []


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE calibrations SET verdict = 'pass'",
        "DELETE FROM audit",
        "TRUNCATE blobs",
        "DROP TRIGGER audit_append_only ON audit",
        "ALTER TABLE audit DISABLE TRIGGER ALL",
        "UPDATE registry_info SET value = 'x'",
    ],
)
def test_the_line_cannot_rewrite_history(as_role, make_factory, statement):
    registry = as_role("line")
    make_factory(registry).calibrate("A1", 1)
    with pytest.raises(RegistryError, match="permission denied|must be owner"):
        with registry.database.writing() as connection:
            connection.execute(text(statement))


def test_a_reader_reads_units_and_no_pins(as_role, make_factory):
    make_factory(as_role("line")).calibrate("A1", 1)
    reader = as_role("reader")
    assert reader.calibration("A1").revision == 1
    with pytest.raises(RegistryError, match="permission denied"):
        reader.users()
    with pytest.raises(RegistryError, match="permission denied"):
        reader.add_unit("L1", "A2")


def test_a_name_that_is_no_role_is_refused():
    with pytest.raises(InputError, match="role"):
        grant_statements("line; DROP TABLE audit", "reader")
