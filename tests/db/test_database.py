"""Opening a registry: every way it can go wrong is one clear line, and nothing is made by mistake."""

import multiprocessing
import sqlite3

import pytest

from softcal.core.errors import RegistryError
from softcal.db.connection import open_registry
from softcal.db.file_system import refuse_network_share
from softcal.db.job_board import JobBoard
from softcal.db.order_queue import OrderQueue
from softcal.db.registry import Registry
from softcal.db.work_queue import WorkQueue


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("sqlite:////nonexistent-folder/x.db", "folder /nonexistent-folder does not exist"),
        ("mysql://root@localhost/x", "kind 'mysql'; sqlite and postgresql are supported"),
        ("not a url", "cannot be read; expected sqlite:///FILE"),
        ("postgresql://nobody:hush@127.0.0.1:1/x", "Connection refused"),
    ],
)
def test_a_wrong_url_is_one_line_without_its_password(url, message):
    with pytest.raises(RegistryError, match=message) as caught:
        open_registry(url)
    assert "hush" not in str(caught.value) and "\n" not in str(caught.value)


def test_a_folder_is_refused(tmp_path):
    with pytest.raises(RegistryError, match="is a folder"):
        open_registry(f"sqlite:///{tmp_path}")


def test_a_file_of_another_kind_is_refused_and_untouched(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("not a database, " * 100)
    with pytest.raises(RegistryError, match="file is not a database"):
        open_registry(f"sqlite:///{path}")
    assert path.read_text() == "not a database, " * 100


def test_a_database_of_something_else_is_refused(tmp_path):
    path = tmp_path / "other.db"
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE customers (id INTEGER)")
    connection.close()
    with pytest.raises(RegistryError, match="database of something else"):
        open_registry(f"sqlite:///{path}")


def test_reading_commands_make_no_registry(new_url):
    with pytest.raises(RegistryError, match="there is no"):
        open_registry(new_url(), create=False)


def test_a_file_that_is_not_there_is_not_made(tmp_path):
    with pytest.raises(RegistryError, match="no such file"):
        open_registry(f"sqlite:///{tmp_path / 'typo.db'}", create=False)
    assert list(tmp_path.iterdir()) == []


def test_a_registry_is_found_again(registry_url, make_factory):
    with open_registry(registry_url) as registry:
        make_factory(registry).calibrate("A1", 1)
        origin = registry.origin
    with open_registry(registry_url, create=False) as again:
        assert again.origin == origin and again.calibration("A1").revision == 1


def test_a_newer_schema_is_refused(new_url):
    registry_url = new_url()
    with open_registry(registry_url) as registry, registry.database.writing() as connection:
        connection.exec_driver_sql("UPDATE alembic_version SET version_num = '9999'")
    with pytest.raises(RegistryError, match="schema 9999, newer than"):
        open_registry(registry_url)


@pytest.mark.parametrize(
    ("kind", "is_refused"), [("nfs4", True), ("cifs", True), ("fuse.sshfs", True), ("ext4", False), ("fuse.ext", False)]
)
def test_a_network_share_is_refused_with_the_reason(tmp_path, kind, is_refused):
    share = tmp_path / "a share"
    share.mkdir()
    mounts = tmp_path / "mounts"
    mounts.write_text(f"/dev/root / ext4 rw 0 0\nserver:/x {str(share).replace(' ', chr(92) + '040')} {kind} rw 0 0\n")
    if is_refused:
        with pytest.raises(RegistryError, match="network share .*; use a local folder, or postgresql"):
            refuse_network_share(share, mounts)
    refuse_network_share(tmp_path, mounts)
    if not is_refused:
        refuse_network_share(share, mounts)


def test_a_registry_that_cannot_be_written_stays_readable_or_says_so(tmp_path, make_factory):
    path = tmp_path / "registry.db"
    with open_registry(f"sqlite:///{path}") as registry:
        factory = make_factory(registry)
        with registry.database.outside_transactions() as connection:
            connection.execute("PRAGMA query_only=ON")
        with pytest.raises(RegistryError, match="readonly"):
            factory.calibrate("A1", 1)
        assert [unit.serial for unit in registry.units()] == ["S0"]


def test_a_full_disk_is_a_clear_error_and_the_registry_stays_whole(tmp_path, make_factory, recording_of):
    with open_registry(f"sqlite:///{tmp_path / 'registry.db'}") as registry:
        make_factory(registry)
        with registry.database.outside_transactions() as connection:
            pages = connection.execute("PRAGMA page_count").fetchone()[0]
            connection.execute(f"PRAGMA max_page_count={pages + 5}")
        with pytest.raises(RegistryError, match="full"):
            for seed in range(100):
                registry.add_recording("L1", recording_of("A1", seed, samples=5000), "unit")
        assert registry.verify() == []


def test_two_processes_may_make_the_same_registry(new_url):
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        assert len(set(pool.map(_origin, [new_url()] * 2, chunksize=1))) == 1


def _origin(url: str) -> str:
    with open_registry(url) as registry:
        return registry.origin


def test_every_public_method_of_registry_and_queues_has_a_second_try():
    wanted = {Registry: ("units", "add_calibration", "verify", "unit_page", "sign_in", "standings", "add_event"),
              WorkQueue: ("claim", "finish", "counts"), OrderQueue: ("place", "take"), JobBoard: ("end",)}  # fmt: skip
    assert all(hasattr(getattr(kind, name), "__wrapped__") for kind, names in wanted.items() for name in names)
