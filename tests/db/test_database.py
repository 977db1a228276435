"""Opening a registry: every way it can go wrong is one clear line, and nothing is made by mistake."""

import multiprocessing
import sqlite3
from contextlib import nullcontext

import pytest

from softcal.core.errors import RegistryError
from softcal.db.connection import open_registry
from softcal.db.schema.engines import refuse_network_share


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("sqlite:////nonexistent-folder/x.db", "/nonexistent-folder"),
        ("sqlite:////tmp", "/tmp"),
        ("mysql://root@localhost/x", "'mysql'.*sqlite.*postgresql"),
        ("not a url", "sqlite:///"),
        ("postgresql://nobody:hush@127.0.0.1:1/x", "127.0.0.1"),
    ],
)
def test_a_wrong_url_is_one_line_without_its_password(url, message):
    with pytest.raises(RegistryError, match=message) as caught:
        open_registry(url)
    assert "hush" not in str(caught.value) and "\n" not in str(caught.value)


def test_a_file_of_another_kind_is_refused_and_untouched(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("not a database, " * 100)
    with pytest.raises(RegistryError, match="notes.txt"):
        open_registry(f"sqlite:///{path}")
    assert path.read_text() == "not a database, " * 100


def test_a_database_of_something_else_is_refused(tmp_path):
    path = tmp_path / "other.db"
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE customers (id INTEGER)")
    connection.close()
    with pytest.raises(RegistryError, match="other.db"):
        open_registry(f"sqlite:///{path}")


def test_a_registry_that_is_not_there_is_not_made(tmp_path, new_url):
    with pytest.raises(RegistryError, match="typo.db"):
        open_registry(f"sqlite:///{tmp_path / 'typo.db'}", create=False)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(RegistryError):
        open_registry(new_url(), create=False)


def test_a_registry_is_found_again(registry_url, make_factory):
    with open_registry(registry_url) as registry:
        make_factory(registry).calibrate("A1", 1)
        origin = registry.origin
    with open_registry(registry_url, create=False) as again:
        assert again.origin == origin and again.calibrations.get("A1").revision == 1


def test_a_newer_schema_is_refused(new_url):
    registry_url = new_url()
    with open_registry(registry_url) as registry, registry.database.writing() as connection:
        connection.exec_driver_sql("UPDATE alembic_version SET version_num = '9999'")
    with pytest.raises(RegistryError, match="9999"):
        open_registry(registry_url)


@pytest.mark.parametrize(
    ("kind", "is_refused"), [("nfs4", True), ("cifs", True), ("fuse.sshfs", True), ("ext4", False), ("fuse.ext", False)]
)
def test_a_network_share_is_refused(tmp_path, kind, is_refused):
    share = tmp_path / "a share"
    share.mkdir()
    mounts = tmp_path / "mounts"
    mounts.write_text(f"/dev/root / ext4 rw 0 0\nserver:/x {str(share).replace(' ', chr(92) + '040')} {kind} rw 0 0\n")
    with pytest.raises(RegistryError, match=kind) if is_refused else nullcontext():
        refuse_network_share(share, mounts)
    refuse_network_share(tmp_path, mounts)


def test_two_processes_may_make_the_same_registry(new_url):
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        assert len(set(pool.map(_origin, [new_url()] * 2, chunksize=1))) == 1


def _origin(url: str) -> str:
    with open_registry(url) as registry:
        return registry.origin
