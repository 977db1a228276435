"""The engines of both databases; an SQLite file's write-ahead log works over no network."""

import os
import random
import sqlite3
import time
from pathlib import Path
from typing import cast

from sqlalchemy import URL, Connection, Engine, create_engine, event
from sqlalchemy.pool import StaticPool

from softcal.core.errors import RegistryError
from softcal.db.schema.transaction_cache import forget

SQLITE_WAIT_S = 60
"""How long a writer waits for its turn before the registry counts as locked."""

LOOK_EVERY_S = (0.001, 0.005)
IN_MEMORY = (None, "", ":memory:")
STATEMENT_TIMEOUT = "120s"

NETWORK_TYPES = frozenset("nfs nfs4 cifs smb smb2 smb3 smbfs 9p afs ceph glusterfs lustre gpfs beegfs".split())
MOUNTS = Path("/proc/mounts")


def refuse_network_share(folder: Path, mounts: Path = MOUNTS) -> None:
    """Raise `RegistryError` where `folder` is on a network share (Linux mounts, UNC paths)."""
    inside, best, kind = folder.resolve(), Path("/"), ""
    for line in mounts.read_text(errors="replace").splitlines() if mounts.is_file() else ():
        match line.split():
            case [_, point, of_type, *_]:
                mounted = Path(point.replace("\\040", " "))
                if inside.is_relative_to(mounted) and len(mounted.parts) >= len(best.parts):
                    best, kind = mounted, of_type
    if str(folder).startswith(("\\\\", "//")):
        kind = "a UNC path"
    elif kind not in NETWORK_TYPES and not kind.startswith(("fuse.sshfs", "fuse.rclone", "fuse.gluster", "fuse.ceph")):
        kind = ""
    if kind:
        raise RegistryError(
            f"registry folder {folder} is on a network share ({kind}); SQLite loses data there, because its "
            "write-ahead log needs shared memory of one machine; use a local folder, or postgresql:// for many stations"
        )


def sqlite_engine(url: URL, create: bool) -> Engine:
    """Return the engine of memory or of a file, made with `create` (`RegistryError`: it cannot be used)."""
    if url.database in IN_MEMORY:
        engine = create_engine(url, poolclass=StaticPool, connect_args={"check_same_thread": False})
    else:
        path = Path(str(url.database))
        folder = path.absolute().parent
        if not folder.is_dir():
            raise RegistryError(f"registry {path}: the folder {folder} does not exist; make it or give another URL")
        if path.is_dir():
            raise RegistryError(f"registry {path} is a folder; a file was expected")
        if not create and not path.exists():
            raise RegistryError(f"registry {path}: there is no such file; `softcal batch` or `softcal demo` makes one")
        if not os.access(path if path.exists() else folder, os.W_OK) or not os.access(folder, os.W_OK):
            raise RegistryError(f"registry {path}: {folder} cannot be written; SQLite needs the folder, too")
        refuse_network_share(folder)
        # It holds hashes of PINs: for its owner alone. SQLite gives its log the same mode.
        try:
            if not path.exists():
                os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o600))
        except FileExistsError:
            pass
        except OSError as error:
            raise RegistryError(f"registry {path}: cannot be written: {error.strerror}") from error
        engine = create_engine(url, connect_args={"timeout": SQLITE_WAIT_S, "check_same_thread": False})
    event.listen(engine, "connect", _set_up_sqlite)
    event.listen(engine, "begin", _begin_sqlite)
    event.listen(engine, "rollback_savepoint", forget)
    return engine


def _set_up_sqlite(connection: sqlite3.Connection, record: object) -> None:
    # Else Python starts transactions, deferred, and "database is locked" comes at once.
    connection.isolation_level = None
    for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON", f"busy_timeout={SQLITE_WAIT_S * 1000}"):
        connection.execute(f"PRAGMA {pragma}")


def _begin_sqlite(connection: Connection) -> None:
    if not connection.get_execution_options().get("softcal_writes", False):
        connection.exec_driver_sql("BEGIN")
        return
    # SQLite's own waiting slows down to a look every 100 ms, so that of many writers one may starve; looking at short
    # random intervals gives each the same chance.
    bare = cast(sqlite3.Connection, connection.connection.driver_connection)
    deadline_s = time.monotonic() + SQLITE_WAIT_S
    bare.execute("PRAGMA busy_timeout = 0")
    try:
        while True:
            try:
                bare.execute("BEGIN IMMEDIATE")
                return
            except sqlite3.OperationalError as error:
                if error.sqlite_errorcode & 0xFF != sqlite3.SQLITE_BUSY or time.monotonic() > deadline_s:
                    raise
            time.sleep(random.uniform(*LOOK_EVERY_S))
    finally:
        bare.execute(f"PRAGMA busy_timeout = {SQLITE_WAIT_S * 1000}")


def postgresql_engine(url: URL) -> Engine:
    """Return the engine of a PostgreSQL server (`RegistryError`: its driver is missing)."""
    try:
        engine = create_engine(
            url, pool_pre_ping=True, pool_size=5, connect_args={"application_name": "softcal", "connect_timeout": 10}
        )
    except ModuleNotFoundError as error:
        raise RegistryError("PostgreSQL needs psycopg; run: pip install 'softcal[postgresql]'") from error
    event.listen(engine, "connect", _set_up_postgresql)
    event.listen(engine, "rollback_savepoint", forget)
    return engine


def _set_up_postgresql(connection: object, record: object) -> None:
    cursor = connection.cursor()  # type: ignore[attr-defined]
    cursor.execute(f"SET statement_timeout = '{STATEMENT_TIMEOUT}'")
    cursor.execute("SET timezone = 'UTC'")
    cursor.close()
    connection.commit()  # type: ignore[attr-defined]
