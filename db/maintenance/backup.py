"""Backup and restore of a registry in use; a backup of any database is one SQLite file."""

import os
import shutil
import tempfile
from contextlib import closing
from itertools import islice
from pathlib import Path

from sqlalchemy import ColumnElement, Select, delete, insert, select, true

from softcal.core.errors import RegistryError
from softcal.db.maintenance.checks import faults
from softcal.db.maintenance.maintenance import Adoption, migrate
from softcal.db.repositories import history
from softcal.db.repositories.registry_base import RegistrySettings
from softcal.db.schema.database import Database, check_schema, open_database, schema_of
from softcal.db.schema.tables import heartbeats, metadata, registry_info, tokens, work_items

ROWS_AT_ONCE = 200
PASSING = (work_items, heartbeats, tokens)
"""Work under way and signs of life: they tell of programs that run here, and would be false
elsewhere. A token that was withdrawn since the backup must not come to life again."""


def back_up(database: Database, path: Path) -> None:
    """Write one consistent state of the registry into a new SQLite file, whole or not at all.

    `RegistryError`: the file exists, or cannot be written.
    """
    if path.exists():
        raise RegistryError(f"backup {path} exists; give a new name: a backup is never overwritten")
    if not path.absolute().parent.is_dir():
        raise RegistryError(f"backup {path}: the folder {path.absolute().parent} does not exist")
    part = path.with_name(f".{path.name}.part")
    try:
        part.unlink(missing_ok=True)
        # SQLite keeps the mode of a file that is there and empty.
        os.close(os.open(part, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o600))
        if database.is_sqlite:
            with database.outside_transactions() as connection:
                connection.execute("VACUUM INTO ?", (str(part),))
        else:
            with closing(open_database(f"sqlite:///{part}")) as copy, database.reading(), copy.writing():
                migrate(copy)
                _copy_tables(database, copy, true())
        with part.open("rb+") as file:
            os.fsync(file.fileno())
        part.rename(path)
    except OSError as error:
        raise RegistryError(f"backup {path} cannot be written: {error.strerror}") from error
    finally:
        part.unlink(missing_ok=True)


def restore(path: Path, url: str) -> None:
    """Fill an empty database from a backup after a check of every byte.

    It continues the audit trail in a new chain, so that no other copy of the same backup is confused with it.
    `RegistryError`: the backup is missing, damaged or of another schema, or the target is not empty.
    """
    if not path.is_file():
        raise RegistryError(f"backup {path}: there is no such file")
    with tempfile.TemporaryDirectory(prefix="softcal-restore-") as folder:
        # An open copy gets files beside it; the backup itself stays as it is.
        source = open_database(f"sqlite:///{shutil.copy(path, Path(folder) / 'backup.db')}")
        with closing(source):
            schema = schema_of(source)
            if schema is None:
                raise RegistryError(f"backup {path} is empty; nothing was restored")
            check_schema(source, schema)
            with source.reading():
                problems = list(faults(source))
            if problems:
                raise RegistryError(
                    f"backup {path} is damaged, nothing was restored: {problems[0]} ({len(problems)} faults in all)"
                )
            with closing(open_database(url)) as target, source.reading(), target.writing():
                if schema_of(target) is not None:
                    raise RegistryError(f"registry {target.name} is not empty; restore into a new one")
                migrate(target)
                _copy_tables(source, target, registry_info.c.key.not_in(["origin", "origin_sha256"]))
                Adoption(target, RegistrySettings()).state_restored(history.heads(source))


def _copy_tables(source: Database, target: Database, is_copied: ColumnElement[bool]) -> None:
    """Copy all but transient rows; of the registry's own metadata only some `is_copied`."""
    target.change(delete(registry_info).where(is_copied))
    for table in metadata.sorted_tables:
        if table in PASSING:
            continue
        query: Select[tuple[object, ...]] = select(table)
        if table is registry_info:
            query = query.where(is_copied)
        rows = source.stream(query, ROWS_AT_ONCE)
        while chunk := [dict(row) for row in islice(rows, ROWS_AT_ONCE)]:
            target.change(insert(table), chunk)
