"""Every schema that was ever released comes up to today's with its data, on both databases."""

import base64
import json
from datetime import UTC, date, datetime
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Date, DateTime, LargeBinary, MetaData, insert, select, text

from softcal.app.registry.maintenance import upgrade
from softcal.core.errors import RegistryError
from softcal.db.care.maintenance import MIGRATIONS, migrate
from softcal.db.connection import open_registry
from softcal.db.schema.database import open_database
from softcal.db.schema.tables import SCHEMA, metadata, registry_info
from tests.layers import layered

SCRIPTS = ScriptDirectory(str(MIGRATIONS), version_locations=[str(MIGRATIONS)])
RELEASED = sorted(Path(__file__).with_name("released").glob("*.json"))


@pytest.fixture
def released(new_url):
    """`released(file)` gives the URL of a registry as an older version left it."""

    def build(rows_file: Path) -> str:
        url = new_url()
        database = open_database(url)
        migrate(database, rows_file.stem)
        tables, rows = MetaData(), json.loads(rows_file.read_text())
        with database.writing() as connection:
            tables.reflect(connection)
            connection.execute(text("DELETE FROM registry_info"))
            for table in tables.sorted_tables:
                for row in rows.get(table.name, ()):
                    connection.execute(insert(table).values({n: _value(table.c[n], v) for n, v in row.items()}))
        database.close()
        return url

    return build


def _value(column, value):
    if isinstance(column.type, LargeBinary):
        return base64.b64decode(value["base64"])
    if isinstance(column.type, Date):
        return date.fromisoformat(value)
    is_time = isinstance(column.type, DateTime) and value is not None
    return datetime.fromisoformat(value).replace(tzinfo=UTC) if is_time else value


def test_the_newest_migration_is_the_schema_of_this_version():
    assert SCRIPTS.get_current_head() == SCHEMA


def test_the_rows_of_every_released_schema_are_recorded():
    older = {script.revision for script in SCRIPTS.walk_revisions()} - {SCHEMA}
    assert older <= {path.stem for path in RELEASED}


def test_migrations_give_exactly_the_tables(registry):
    with registry.database.reading() as connection:
        assert compare_metadata(MigrationContext.configure(connection), metadata) == []


@pytest.mark.parametrize("rows_file", layered(RELEASED, (RELEASED[0], RELEASED[-1])), ids=lambda path: path.stem)
def test_an_older_registry_is_refused_then_upgraded_with_its_data(released, rows_file):
    url = released(rows_file)
    if rows_file.stem != SCHEMA:
        with pytest.raises(RegistryError, match="softcal registry upgrade"):
            open_registry(url)
    done = upgrade(url)
    assert (done.before, done.after) == (rows_file.stem, SCHEMA)
    with open_registry(url, create=False) as registry:
        assert registry.verify() == []
        assert [(c.revision, c.rolled_back_to) for c in registry.calibrations.history("A1")] == [
            (1, None),
            (2, None),
            (3, 1),
        ]
        verdicts = {unit.serial: unit.verdict for unit in registry.lots.units("L1")}
        assert verdicts == {"A1": "pass", "A2": "retest", "S0": None}
        assert {(state.state, state.actor) for state in registry.networks.states("L1")} == {("released", "softcal")}
        with registry.database.reading() as connection:
            assert compare_metadata(MigrationContext.configure(connection), metadata) == []
            keys = set(connection.execute(select(registry_info.c.key)).scalars())
            assert keys == {"origin", "origin_sha256"}, "what decides anything stands under the audit trail"


def test_an_sqlite_registry_is_backed_up_before_its_upgrade(released):
    url = released(RELEASED[0])
    backup = upgrade(url).backup
    if url.startswith("sqlite"):
        assert backup is not None and upgrade(f"sqlite:///{backup}").before == RELEASED[0].stem
    else:
        assert backup is None


def test_an_upgrade_of_today_s_registry_does_nothing(registry_url):
    done = upgrade(registry_url)
    assert (done.before, done.after, done.backup) == (SCHEMA, SCHEMA, None)
