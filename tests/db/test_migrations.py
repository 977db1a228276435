"""One schema: what the migration makes is what the tables say, on both databases, and nothing else is opened."""

from contextlib import closing

import pytest
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import inspect, text
from sqlalchemy.exc import DBAPIError

from softcal.app.cli.main import main
from softcal.app.registry.maintenance import upgrade
from softcal.core.errors import RegistryError
from softcal.db.connection import open_registry
from softcal.db.maintenance.backup import back_up, restore
from softcal.db.maintenance.maintenance import MIGRATIONS
from softcal.db.schema.database import open_database, schema_of
from softcal.db.schema.tables import APPEND_ONLY, SCHEMA, metadata


def restamp(url: str, revision: str) -> None:
    """Let a registry say that it has another schema."""
    with closing(open_database(url)) as database:
        database.change(text("UPDATE alembic_version SET version_num = :to"), {"to": revision})


@pytest.fixture
def of_schema(new_url):
    """`of_schema(revision)` gives the URL of a registry that another version wrote."""

    def build(revision: str) -> str:
        upgrade(url := new_url())
        restamp(url, revision)
        return url

    return build


def test_there_is_one_migration_and_it_makes_the_schema_of_this_version():
    scripts = ScriptDirectory(str(MIGRATIONS), version_locations=[str(MIGRATIONS)])
    assert [script.revision for script in scripts.walk_revisions()] == [SCHEMA] == ["1"]


def test_the_migration_makes_exactly_the_tables(registry):
    with registry.database.reading() as connection:
        assert compare_metadata(MigrationContext.configure(connection), metadata) == []
        inspector = inspect(connection)
        for name, table in metadata.tables.items():
            checks = {str(one.name) for one in table.constraints if type(one).__name__ == "CheckConstraint"}
            assert {one["name"] for one in inspector.get_check_constraints(name)} == checks, name
            indices = {
                (one["name"], tuple(one["column_names"]), bool(one["unique"])) for one in inspector.get_indexes(name)
            }
            assert indices == {(i.name, tuple(c.name for c in i.columns), bool(i.unique)) for i in table.indexes}, name
            assert inspector.get_pk_constraint(name)["name"] == table.primary_key.name


@pytest.mark.parametrize("change", ["UPDATE {0} SET {1} = {1}", "DELETE FROM {0}"])
def test_what_was_written_cannot_be_changed(factory, change):
    factory.calibrate("A1")
    database = factory.registry.database
    # SQLite's triggers run once a row, PostgreSQL's once a statement.
    filled = [name for name in APPEND_ONLY if not database.is_sqlite or database.value(text(f"SELECT 1 FROM {name}"))]
    assert {"audit", "blobs", "lots", "units", "calibrations", "in_use"} <= set(filled)
    for name in filled:
        column = next(iter(metadata.tables[name].columns)).name
        with pytest.raises(RegistryError, match="append-only"):
            database.change(text(change.format(name, column)))


@pytest.mark.parametrize(("revision", "cure"), [("0001", "softcal batch"), ("0010", "softcal batch"), ("2", "update")])
@pytest.mark.parametrize("act", ["list", "upgrade", "backup"])
def test_a_registry_of_another_schema_is_refused_in_one_line(of_schema, tmp_path, capsys, act, revision, cure):
    url = of_schema(revision)
    file = [str(tmp_path / "backup.db")] if act == "backup" else []
    assert main(["registry", act, *file, "--registry", url]) == 4
    (message,) = capsys.readouterr().err.strip().splitlines()
    assert f"schema {revision}" in message and SCHEMA in message and cure in message
    with closing(open_database(url)) as database:
        assert schema_of(database) == revision


def test_a_backup_of_another_schema_is_refused(file_registry, tmp_path):
    back_up(file_registry.database, tmp_path / "backup.db")
    restamp(f"sqlite:///{tmp_path / 'backup.db'}", "0010")
    with pytest.raises(RegistryError, match="schema 0010"):
        restore(tmp_path / "backup.db", f"sqlite:///{tmp_path / 'restored.db'}")


def test_an_upgrade_makes_the_tables_once(new_url):
    url = new_url()
    assert (upgrade(url), upgrade(url)) == (None, SCHEMA)
    with open_registry(url, create=False) as registry:
        assert registry.verify() == []


def test_one_station_has_one_run_at_a_time_and_any_number_that_are_over(registry):
    table = metadata.tables["orders"]
    values = {c.name: "x" for c in table.columns} | {"station": "S", "fraction": 0.0, "remaining_s": 0.0}

    def add_order(order_id: str, state: str, kind: str) -> None:
        with registry.database.writing() as connection:
            now = registry.settings.clock()
            row = values | {"order_id": order_id, "state": state, "kind": kind, "created": now, "changed_at": now}
            connection.execute(table.insert().values(row))

    for order_id, state, kind in [("1", "done", "unit"), ("2", "done", "unit"), ("3", "queued", "unit")]:
        add_order(order_id, state, kind)
    add_order("4", "queued", "home")
    with pytest.raises((RegistryError, DBAPIError)):
        add_order("5", "running", "golden")
