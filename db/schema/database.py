"""The database behind a registry URL: checks before opening, settings, transactions.

Nothing is opened at import. No message of this module contains a password.
"""

import sqlite3
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar, cast

from sqlalchemy import URL, Connection, Engine, Executable, RowMapping, inspect, make_url, text
from sqlalchemy.exc import ArgumentError, DBAPIError, IntegrityError, OperationalError, SQLAlchemyError

from softcal.core.errors import RegistryBusy, RegistryError, RegistryReadOnly, WrongSchema
from softcal.db.schema.engines import IN_MEMORY, READ_ONLY, postgresql_engine, sqlite_engine
from softcal.db.schema.tables import SCHEMA
from softcal.db.schema.transaction_cache import HAS_AUDIT_ROWS, TransactionCache, cache_of

AGAIN_AFTER_S = 0.5
"""Wait before what was cut is done again: the server may be ending all connections."""

WRITER_LOCK = 1_900_178
"""Key of the PostgreSQL advisory lock that puts writers of the audit chain in a row."""

VALUES_AT_ONCE = 500

DENIED = ("42501", "25006")
"""PostgreSQL's codes of a missing privilege and of a transaction that may only read."""

BUSY = (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED, "40001", "40P01", "55P03", "57014")
"""Codes of what others hold: SQLite's two; PostgreSQL's of a serialisation, a deadlock, a lock and a timeout."""

Answer = TypeVar("Answer")
Values = Mapping[str, Any] | Sequence[Mapping[str, Any]] | None
Part = TypeVar("Part")


class ConnectionCut(RegistryError):
    """The connection to the server broke; `is_undone` is False if it broke in the commit, else nothing was stored."""

    def __init__(self, message: str, is_undone: bool) -> None:
        super().__init__(message)
        self.is_undone = is_undone
        self.was_repeated = False


class _Joined(threading.local):
    """Open transactions of a thread, which later calls of that thread join."""

    reader: Connection | None = None
    writer: Connection | None = None


class Database:
    """An open database: short read transactions, write transactions one after another.

    Every read joins the open transaction of its thread, every write an open write transaction: all is seen, kept or
    lost together.
    """

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self.on_first_write: Callable[[], None] | None = None
        """Called once, after the first transaction that wrote into the audit trail was kept."""
        self._thread = _Joined()

    @property
    def _joined(self) -> Connection | None:
        return self._thread.writer or self._thread.reader

    @property
    def cache(self) -> TransactionCache:
        """Cache of this thread's transaction; None outside a transaction."""
        return TransactionCache() if self._joined is None else cache_of(self._joined)

    @property
    def is_sqlite(self) -> bool:
        return self.engine.dialect.name == "sqlite"

    @property
    def is_in_memory(self) -> bool:
        """Whether the database is an SQLite database of this process alone, with one connection."""
        return self.is_sqlite and self.path is None

    @property
    def name(self) -> str:
        """URL without its password, wherever the URL contains it."""
        return redacted_url(self.engine.url)

    @property
    def path(self) -> Path | None:
        """The SQLite file; None in memory and on a server."""
        database = self.engine.url.database
        return Path(database) if self.is_sqlite and database not in IN_MEMORY else None

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """Yield a connection with one consistent snapshot."""
        if self._joined is not None:
            yield self._joined
            return
        with self._translate_errors(), self.engine.connect() as connection:
            if not self.is_sqlite:
                connection.execution_options(isolation_level="REPEATABLE READ", postgresql_readonly=True)
            with connection.begin(), self._joinable("reader", connection):
                yield connection

    def rows(self, query: Executable, values: Values = None) -> Sequence[RowMapping]:
        with self.reading() as connection:
            return connection.execute(query, values).mappings().all()

    def row(self, query: Executable, values: Values = None) -> RowMapping | None:
        """Return the first row of a query, or None."""
        with self.reading() as connection:
            return connection.execute(query, values).mappings().first()

    def tuples(self, query: Executable, values: Values = None) -> list[Any]:
        with self.reading() as connection:
            return list(connection.execute(query, values))

    def stream(self, query: Executable, size: int = 1000) -> Iterator[RowMapping]:
        """Yield the rows of a query, with `size` rows in memory at once."""
        with self.reading() as connection:
            yield from connection.execute(query, execution_options={"yield_per": size}).mappings()

    def values(self, query: Executable) -> list[Any]:
        """Return the first column of a query."""
        with self.reading() as connection:
            return list(connection.execute(query).scalars())

    def value(self, query: Executable, values: Values = None) -> Any:
        """Return the first value of a query, or None."""
        with self.reading() as connection:
            return connection.execute(query, values).scalar()

    def change(self, statement: Executable, values: Values = None) -> int:
        """Execute one statement, alone or in the open transaction; return the number of changed rows."""
        with self.writing(in_turn=False) as connection:
            return connection.execute(statement, values).rowcount

    def insert_new(self, statement: Executable) -> bool:
        """Insert a row, alone or in the open transaction; return False if one of its keys exists."""
        with self.writing(in_turn=False) as connection:
            try:
                with connection.begin_nested():
                    connection.execute(statement)
            except IntegrityError:
                return False
        return True

    def check_writable(self) -> None:
        """Raise `RegistryError` if the file or its folder is read-only, or a server says so."""
        if cause := self.engine.get_execution_options().get(READ_ONLY):
            raise RegistryReadOnly(f"registry {self.name} is read-only: {cause}; nothing was changed")

    @contextmanager
    def writing(self, *, in_turn: bool = True) -> Iterator[Connection]:
        """Yield a connection whose changes are committed if the block ends without an exception.

        Args:
            in_turn: one writer at a time, as the audit chain needs it. SQLite allows nothing else; PostgreSQL lets
                writers with `in_turn=False` (work queue, heartbeats) go side by side.
        """
        if self._thread.writer is not None:
            yield self._thread.writer
            return
        self.check_writable()
        with self._translate_errors(is_writing=True) as progress, self.engine.connect() as connection:
            connection.execution_options(softcal_writes=True)
            with connection.begin(), self._joinable("writer", connection):
                if in_turn and not self.is_sqlite:
                    connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": WRITER_LOCK})
                connection.info.pop(HAS_AUDIT_ROWS, None)
                yield connection
                # The commit follows: of what is cut from here on nobody knows what was kept.
                progress["is_committing"] = True
            has_audit_rows = connection.info.pop(HAS_AUDIT_ROWS, False)
        if has_audit_rows and self.on_first_write is not None:
            callback, self.on_first_write = self.on_first_write, None
            callback()

    def once_more(self, action: Callable[[], Answer], *, is_repeatable: bool = False) -> Answer:
        """Run whole transactions, and repeat them if their connection was lost.

        Inside an open transaction once: what came before is lost, too. Else again where nothing was kept, or where
        twice changes nothing (`is_repeatable`).
        """
        if self._joined is not None:
            return action()
        try:
            return action()
        except ConnectionCut as cut:
            if cut.was_repeated or not (cut.is_undone or is_repeatable):
                raise
        time.sleep(AGAIN_AFTER_S)
        try:
            return action()
        except ConnectionCut as cut:
            cut.was_repeated = True
            raise

    @contextmanager
    def outside_transactions(self) -> Iterator[sqlite3.Connection]:
        """Yield the plain SQLite connection, for statements that SQLite runs outside transactions only."""
        with self._translate_errors():
            pooled = self.engine.raw_connection()
            try:
                yield cast(sqlite3.Connection, pooled.driver_connection)
            finally:
                pooled.close()

    def close(self) -> None:
        """Close every connection. A transaction that is open is rolled back."""
        self.engine.dispose()

    @contextmanager
    def _joinable(self, role: str, connection: Connection) -> Iterator[None]:
        setattr(self._thread, role, connection)
        try:
            yield
        finally:
            setattr(self._thread, role, None)

    @contextmanager
    def _translate_errors(self, is_writing: bool = False) -> Iterator[dict[str, bool]]:
        progress = {"is_committing": False}
        try:
            yield progress
        # SQLite may quote a damaged name, which is no text.
        except (SQLAlchemyError, sqlite3.Error, UnicodeDecodeError) as error:
            message = without_password(first_line(error), self.engine.url)
            if progress["is_committing"] and not self.is_sqlite and isinstance(error, OperationalError):
                raise ConnectionCut(
                    f"registry {self.name}: {message}; this happened while the change was being kept: look whether it "
                    "is there before you repeat it",
                    is_undone=False,
                ) from error
            if isinstance(error, DBAPIError) and error.connection_invalidated:
                cut = f"registry {self.name}: {message}; nothing was changed; run it again when the server answers"
                raise ConnectionCut(cut, is_undone=True) from error
            kind: type[RegistryError] = RegistryBusy if is_busy(error) else RegistryError
            if is_denied(error):
                may_not = "this is read-only for" if is_writing else "this is hidden from"
                message += f"; {may_not} the database account, ask who manages the registry to do it"
                kind = RegistryReadOnly if is_writing else RegistryError
            raise kind(f"registry {self.name}: {message}; nothing was changed") from error


def first_line(error: Exception) -> str:
    """Return the first line of a driver's message, or the type of its error."""
    cause = error.orig if isinstance(error, DBAPIError) and error.orig is not None else error
    lines = [line.strip() for line in str(cause).splitlines() if line.strip()]
    return lines[0] if lines else type(cause).__name__


def is_denied(error: Exception) -> bool:
    """Whether the account at the server lacks the right to the statement."""
    return _code_of(error) in DENIED


def is_busy(error: Exception) -> bool:
    """Return whether an error means that other connections held a lock for too long."""
    code = _code_of(error)
    # The low byte of an SQLite code is its kind.
    return code in BUSY or (isinstance(code, int) and code & 0xFF in BUSY)


def _code_of(error: Exception) -> int | str | None:
    cause = error.orig if isinstance(error, DBAPIError) else error
    code: int | str | None = getattr(cause, "sqlite_errorcode", getattr(cause, "sqlstate", None))
    return code


def equality_conditions(*pairs: tuple[Any, object]) -> list[Any]:
    """Return the conditions that columns equal a value, or one of several; None is any value."""
    constrained = [(column, value) for column, value in pairs if value is not None]
    return [column.in_(value) if isinstance(value, list | tuple) else column == value for column, value in constrained]


def parts(values: Sequence[Part]) -> Iterator[Sequence[Part]]:
    """Cut values into as many as both databases take in one statement."""
    yield from (values[start : start + VALUES_AT_ONCE] for start in range(0, len(values), VALUES_AT_ONCE))


def open_database(url: str, *, create: bool = True) -> Database:
    """Open an SQLite file (`create` makes it), `sqlite://` (in memory) or PostgreSQL, whatever its content.

    `RegistryError`: a wrong URL, no folder or one on a network share, no database, or a server that does not answer.
    """
    try:
        parsed = make_url(url)
    # A port that is no number is a plain ValueError.
    except (ArgumentError, ValueError) as error:
        raise RegistryError(
            f"the registry URL {_masked(url)!r} cannot be read; sqlite:///FILE or postgresql://USER@HOST/DATABASE was "
            f"expected{f', for a file sqlite:///{url}' if _masked(url) == url and '://' not in url else ''}"
        ) from error
    if parsed.drivername in ("sqlite", "sqlite+pysqlite"):
        database = Database(sqlite_engine(parsed, create))
    elif parsed.drivername in ("postgresql", "postgresql+psycopg"):
        database = Database(postgresql_engine(parsed.set(drivername="postgresql+psycopg")))
    else:
        raise RegistryError(f"registry URL of kind {parsed.drivername!r}; sqlite and postgresql are supported")
    try:
        with database.reading() as connection:
            connection.execute(text("SELECT 1"))
    except RegistryError:
        database.close()
        raise
    return database


def schema_of(database: Database) -> str | None:
    """Return the schema revision, None of an empty database; raise `RegistryError` for tables of another program."""
    with database.reading() as connection:
        tables = inspect(connection).get_table_names()
        if not tables:
            return None
        if "alembic_version" not in tables or "registry_info" not in tables:
            raise RegistryError(f"registry {database.name}: this is a database of something else; give another URL")
        return str(connection.execute(text("SELECT version_num FROM alembic_version")).scalar_one())


def check_schema(database: Database, schema: str) -> None:
    """Refuse a registry that this version cannot use in its present state."""
    if schema < SCHEMA:
        raise WrongSchema(
            f"registry {database.name} has schema {schema} of a development version, which nothing reads; "
            f"use another registry of schema {SCHEMA}: `softcal batch LOT` makes one and fits the lot again"
        )
    if schema > SCHEMA:
        raise WrongSchema(
            f"registry {database.name} has schema {schema}, newer than {SCHEMA} of this version; update softcal"
        )


def _masked(url: str) -> str:
    """Return a text that is no URL without what may be a password: up to `@`, or a bare word."""
    scheme, _, rest = url.rpartition("://")
    if not scheme and not set("/.\\") & set(url):
        return "..."
    return f"{scheme}://...@{rest.rpartition('@')[2]}" if "@" in rest else url


SECRET_KEYS = ("password", "passfile", "sslpassword")


def redacted_url(url: URL) -> str:
    """Return a URL as text without its password, which may also be among its options."""
    hidden = {key: "***" for key in url.query if key.lower() in SECRET_KEYS}
    return url.update_query_dict(hidden).render_as_string(hide_password=True)


def without_password(text: str, url: URL) -> str:
    """Return a driver's message without the password of the connection."""
    secrets = [url.password, *(url.query.get(key) for key in SECRET_KEYS)]
    for secret in secrets:
        if isinstance(secret, str) and secret:
            text = text.replace(secret, "***")
    return text
