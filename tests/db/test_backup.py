"""A backup is one whole file taken while the registry is in use; what comes back is what was there."""

import threading

import pytest

from softcal.core.errors import RegistryError
from softcal.db.connection import open_registry
from softcal.db.maintenance.backup import back_up, restore
from softcal.db.queues.work_queue import WorkSet


@pytest.fixture
def backup(factory, tmp_path):
    factory.calibrate("A1", 1)
    factory.calibrate("A1", 2)
    factory.registry.work_queue.enqueue(WorkSet("L1", "a" * 64), {"A1": "b" * 64})
    path = tmp_path / "backup.db"
    back_up(factory.registry.database, path)
    return path


def test_what_comes_back_is_what_was_there(factory, backup, new_url):
    url = new_url()
    restore(backup, url)
    with open_registry(url, create=False) as again:
        assert again.verify() == []
        assert again.lots.units() == factory.registry.lots.units()
        assert again.trail.rows(factory.registry.origin) == factory.registry.trail.rows()
        assert [row.action for row in again.trail.rows(again.origin)] == ["restore"]
        assert again.origin != factory.registry.origin, "two copies that are both written to must be told apart"
        again.calibrations.rollback("A1", 1, reason="goes on")
        assert again.verify() == []


def test_a_backup_is_a_registry_by_itself(factory, backup):
    with open_registry(f"sqlite:///{backup}", create=False) as copy:
        assert copy.verify() == [] and copy.origin == factory.registry.origin


def test_a_backup_taken_while_others_write_is_consistent(factory, tmp_path):
    stop = threading.Event()

    def write() -> None:
        number = 0
        while not stop.is_set():
            factory.calibrate(f"A{number % 5}", number := number + 1)

    writer = threading.Thread(target=write)
    writer.start()
    try:
        for k in range(3):
            back_up(factory.registry.database, tmp_path / f"{k}.db")
    finally:
        stop.set()
        writer.join()
    for k in range(3):
        with open_registry(f"sqlite:///{tmp_path / f'{k}.db'}", create=False) as copy:
            assert copy.verify() == []


def test_a_backup_is_never_overwritten(factory, backup):
    content = backup.read_bytes()
    with pytest.raises(RegistryError, match="backup.db"):
        back_up(factory.registry.database, backup)
    assert backup.read_bytes() == content


def test_a_registry_with_data_is_never_restored_over(factory, backup, registry_url):
    with pytest.raises(RegistryError):
        restore(backup, registry_url)
    assert factory.registry.calibrations.get("A1").revision == 2


def test_a_damaged_backup_restores_nothing(backup, tmp_path):
    content = bytearray(backup.read_bytes())
    at = content.index(b"interval.half_width") + 200
    content[at] ^= 0xFF
    damaged, target = tmp_path / "damaged.db", tmp_path / "target.db"
    damaged.write_bytes(content)
    with pytest.raises(RegistryError, match="damaged.db"):
        restore(damaged, f"sqlite:///{target}")
    assert not target.exists()


def test_a_backup_into_no_folder_leaves_nothing(factory, tmp_path):
    with pytest.raises(RegistryError, match="nowhere"):
        back_up(factory.registry.database, tmp_path / "nowhere" / "backup.db")
    with pytest.raises(RegistryError, match="nothing.db"):
        restore(tmp_path / "nothing.db", "sqlite://")
