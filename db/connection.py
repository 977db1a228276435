"""Open the registry behind a URL."""

from softcal.core.errors import NoRegistry
from softcal.db.registry import Registry
from softcal.db.repositories.registry_base import RegistrySettings
from softcal.db.schema.database import check_schema, open_database, schema_of


def open_registry(url: str, settings: RegistrySettings | None = None, *, create: bool = True) -> Registry:
    """Open the registry behind an SQLAlchemy URL (`RegistryError`: URL, folder, file, server or schema are unusable).

    With `create` an empty database or a new SQLite file gets the tables.
    """
    database = open_database(url, create=create)
    try:
        schema = schema_of(database)
        if schema is None and not create:
            raise NoRegistry(f"registry {database.name}: there is no registry yet; `softcal batch` or `demo` makes one")
        if schema is None:
            # Whoever opens what is there needs no migrations.
            from softcal.db.maintenance.maintenance import migrate

            schema = migrate(database)
        check_schema(database, schema)
        return Registry(database, settings or RegistrySettings())
    except BaseException:
        database.close()
        raise
