"""The engines of both databases; an SQLite file's write-ahead log works over no network."""

import os
import random
import shutil
import sqlite3
import tempfile
import time
import weakref
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import cast
from urllib.parse import quote

from sqlalchemy import URL, Connection, Engine, create_engine, event
from sqlalchemy.pool import NullPool, StaticPool

from softcal.core.errors import NoRegistry, RegistryError
from softcal.db.schema.transaction_cache import clear_cache

SQLITE_WAIT_S = 60
"""How long a writer waits for its turn before the registry counts as locked."""

LOOK_EVERY_S = (0.001, 0.005)
IN_MEMORY = (None, "", ":memory:")
STATEMENT_TIMEOUT = "120s"

NETWORK_TYPES = frozenset("nfs nfs4 cifs smb smb2 smb3 smbfs 9p afs ceph glusterfs lustre gpfs beegfs".split())
MOUNTS = Path("/proc/mounts")

READ_ONLY = "softcal_read_only"
"""Execution option of an engine whose file can only be read: why it cannot be written."""


def network_share(folder: Path, mounts: Path = MOUNTS) -> str:
    """Return the kind of network share of `folder` (Linux mounts, UNC paths); empty for a local folder."""
    inside, best, kind = folder.resolve(), Path("/"), ""
    for line in mounts.read_text(errors="replace").splitlines() if mounts.is_file() else ():
        match line.split():
            case [_, point, of_type, *_]:
                mounted = Path(point.replace("\\040", " "))
                if inside.is_relative_to(mounted) and len(mounted.parts) >= len(best.parts):
                    best, kind = mounted, of_type
    if str(folder).startswith(("\\\\", "//")):
        return "a UNC path"
    is_network = kind in NETWORK_TYPES or kind.startswith(("fuse.sshfs", "fuse.rclone", "fuse.gluster", "fuse.ceph"))
    return kind if is_network else ""


def refuse_network_share(folder: Path, mounts: Path = MOUNTS) -> None:
    """Raise `RegistryError` where `folder` is on a network share."""
    if kind := network_share(folder, mounts):
        raise RegistryError(
            f"registry folder {folder} is on a network share ({kind}); SQLite loses data there, because its "
            "write-ahead log needs shared memory of one machine; use a local folder, or postgresql:// for many stations"
        )


def sqlite_engine(url: URL, create: bool) -> Engine:
    """Return the engine of memory or of a file, made with `create` (`RegistryError`: unusable file)."""
    if url.database in IN_MEMORY:
        engine = create_engine(url, poolclass=StaticPool, connect_args={"check_same_thread": False})
    else:
        path = Path(str(url.database))
        folder = path.absolute().parent
        try:
            problem = _problem(path, folder, create)
        except OSError as error:
            problem = f"registry {path}: cannot be read: {error.strerror}"
        if problem:
            raise (RegistryError if create or path.exists() else NoRegistry)(problem)
        parts = (path, folder) if path.exists() else (folder,)
        if cause := next((f"{part} cannot be written" for part in parts if not os.access(part, os.W_OK)), ""):
            if path.exists():
                return _read_only_engine(url, path, cause)
            raise RegistryError(f"registry {path}: {cause}; a new registry was asked for")
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
    event.listen(engine, "rollback_savepoint", clear_cache)
    return engine


def _problem(path: Path, folder: Path, create: bool) -> str:
    if not folder.is_dir():
        return f"registry {path}: the folder {folder} does not exist; make it or give another URL"
    if path.is_dir():
        return f"registry {path} is a folder; a file was expected"
    if not create and not path.exists():
        return f"registry {path}: there is no such file; `softcal batch` or `softcal demo` makes one"
    if path.exists() and not os.access(path, os.R_OK):
        return f"registry {path}: cannot be read by this account"
    return ""


def _read_only_engine(url: URL, path: Path, cause: str) -> Engine:
    """Return the engine of a read-only file, which creates no further file."""
    # Every transaction looks anew: what somebody else writes meanwhile is seen by the next one.
    engine = create_engine(url, creator=_opener(path), poolclass=NullPool, execution_options={READ_ONLY: cause})
    event.listen(engine, "begin", _begin_sqlite)
    event.listen(engine, "begin", partial(_note_state, path))
    event.listen(engine, "commit", partial(_check_state, path))
    return engine


def _sidecar_path(path: Path, suffix: str) -> Path:
    return path.with_name(path.name + suffix)


def _opener(path: Path) -> Callable[[], sqlite3.Connection]:
    """Return what connects to a file without writing into its folder.

    Without a write-ahead log the file alone is the registry, and SQLite may leave out its locks (`immutable`). With a
    log it needs the log's index: the one that is there, or else one beside a private copy of both.
    """
    copy: list[Path] = []

    def connect() -> sqlite3.Connection:
        connected = partial(sqlite3.connect, timeout=SQLITE_WAIT_S, check_same_thread=False, isolation_level=None)
        name = f"file:{quote(str(path.absolute()))}?mode=ro"
        if _has_no_log(path):
            return connected(f"{name}&immutable=1", uri=True)
        if os.access(_sidecar_path(path, "-shm"), os.R_OK) and not network_share(path.absolute().parent):
            return connected(name, uri=True)
        if not copy:
            copy.append(_private_copy(path, _sidecar_path(path, "-wal")))
            weakref.finalize(connect, shutil.rmtree, copy[0].parent, ignore_errors=True)
        return connected(copy[0])

    return connect


def _private_copy(path: Path, wal: Path) -> Path:
    folder = Path(tempfile.mkdtemp(prefix="softcal-registry-"))
    try:
        before, copy = [_state(path), _state(wal)], folder / "registry.db"
        shutil.copyfile(path, copy)
        shutil.copyfile(wal, _sidecar_path(copy, "-wal"))
        if [_state(path), _state(wal)] != before:
            raise _was_written(path)
    except BaseException as error:
        shutil.rmtree(folder, ignore_errors=True)
        if isinstance(error, OSError):
            raise RegistryError(f"registry {path}: {wal} cannot be read: {error.strerror}") from error
        raise
    return copy


def _has_no_log(path: Path) -> bool:
    wal = _sidecar_path(path, "-wal")
    return not wal.exists() or (wal.stat().st_size == 0 and not _sidecar_path(path, "-shm").exists())


def _state(path: Path) -> tuple[int, int]:
    return path.stat().st_mtime_ns, path.stat().st_size


def _note_state(path: Path, connection: Connection) -> None:
    connection.info["state"] = _state(path) if _has_no_log(path) else None


def _check_state(path: Path, connection: Connection) -> None:
    """Refuse data that were read without locks while another process wrote into the file."""
    if connection.info.pop("state") not in (None, _state(path)):
        raise _was_written(path)


def _was_written(path: Path) -> RegistryError:
    return RegistryError(f"registry {path} was written by another program while it was read; run the command again")


def _set_up_sqlite(connection: sqlite3.Connection, record: object) -> None:
    # Else Python starts transactions, deferred, and "database is locked" comes at once.
    connection.isolation_level = None  # noqa: V101
    for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON", f"busy_timeout={SQLITE_WAIT_S * 1000}"):
        connection.execute(f"PRAGMA {pragma}")


def _begin_sqlite(connection: Connection) -> None:
    if not connection.get_execution_options().get("softcal_writes", False):
        connection.exec_driver_sql("BEGIN")
        return
    # SQLite's own waiting slows down to a look every 100 ms, so that of many writers one may starve; looking at short
    # random intervals gives each the same chance.
    sqlite_connection = cast(sqlite3.Connection, connection.connection.driver_connection)
    deadline_s = time.monotonic() + SQLITE_WAIT_S
    sqlite_connection.execute("PRAGMA busy_timeout = 0")
    try:
        while True:
            try:
                sqlite_connection.execute("BEGIN IMMEDIATE")
                return
            except sqlite3.OperationalError as error:
                if error.sqlite_errorcode & 0xFF != sqlite3.SQLITE_BUSY or time.monotonic() > deadline_s:
                    raise
            time.sleep(random.uniform(*LOOK_EVERY_S))
    finally:
        sqlite_connection.execute(f"PRAGMA busy_timeout = {SQLITE_WAIT_S * 1000}")


def postgresql_engine(url: URL) -> Engine:
    """Return the engine of a PostgreSQL server (`RegistryError`: its driver is missing)."""
    try:
        engine = create_engine(
            url, pool_pre_ping=True, pool_size=5, connect_args={"application_name": "softcal", "connect_timeout": 10}
        )
    except ModuleNotFoundError as error:
        raise RegistryError("PostgreSQL needs psycopg; run: pip install 'softcal[postgresql]'") from error
    event.listen(engine, "connect", _set_up_postgresql)
    event.listen(engine, "rollback_savepoint", clear_cache)
    return engine


def _set_up_postgresql(connection: object, record: object) -> None:
    cursor = connection.cursor()  # type: ignore[attr-defined]
    cursor.execute(f"SET statement_timeout = '{STATEMENT_TIMEOUT}'")
    cursor.execute("SET timezone = 'UTC'")
    cursor.close()
    connection.commit()  # type: ignore[attr-defined]
