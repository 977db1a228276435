"""A disk that is full and a folder that may not be written: one clear line, and the registry as it was."""

import subprocess
import sys

import pytest
from sqlalchemy import Engine, event

from softcal.app.cli.main import main
from softcal.core.errors import RegistryError
from softcal.db.connection import open_registry

ON_A_FULL_DISK = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
from dataclasses import replace
from pathlib import Path
from softcal.core.errors import RegistryError
from softcal.core.identity import content_sha256
from softcal.db.maintenance.backup import back_up
from softcal.db.connection import open_registry
with open_registry(sys.argv[1], create=False) as registry:
    state = registry.calibrations.get("A0").state
    limit = int(sys.argv[2])
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    try:
        if sys.argv[3:]:
            back_up(registry.database, Path(sys.argv[3]))
        for number in range(100_000):
            own = replace(state, fit=replace(state.fit, serial=f"A{number}", id=content_sha256({}, {"number": number})))
            print(f"A{number}", registry.calibrations.add("L1", own), flush=True)
    except RegistryError as error:
        print(f"refused {error}", flush=True)
"""
"""No file of this process may grow beyond the limit: for SQLite what a full disk is."""


def on_a_full_disk(*arguments: object) -> list[str]:
    """Back up where a path is given, or calibrate; return the lines that were printed until it was refused."""
    command = [sys.executable, "-c", ON_A_FULL_DISK, *map(str, arguments)]
    process = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    return process.stdout.splitlines()


def test_a_full_disk_loses_nothing_that_was_acknowledged(file_registry, make_factory):
    make_factory(file_registry).calibrate("A0")
    url = f"sqlite:///{file_registry.database.path}"
    file_registry.close()
    size = file_registry.database.path.stat().st_size
    *acknowledged, last = on_a_full_disk(url, size + 200_000)
    assert acknowledged and last.startswith("refused "), last
    with open_registry(url, create=False) as registry:
        assert registry.verify() == []
        for line in acknowledged:
            serial, revision = line.split()
            assert registry.calibrations.get(serial, int(revision)).revision == int(revision)
        make_factory(registry).calibrate("A0", 7)


def test_a_backup_onto_a_full_disk_leaves_no_file(file_registry, make_factory, tmp_path):
    make_factory(file_registry).calibrate("A0")
    (message,) = on_a_full_disk(f"sqlite:///{file_registry.database.path}", 50_000, tmp_path / "b.db")
    assert message.startswith("refused ") and not list(tmp_path.glob("*b.db*"))
    assert file_registry.verify() == []


def test_a_folder_that_may_not_be_written_is_named(capsys):
    assert main(["registry", "upgrade", "--registry", "sqlite:////proc/registry.db"]) == 4
    (message,) = capsys.readouterr().err.splitlines()
    assert "/proc" in message


def test_a_registry_that_may_only_be_read_says_so(file_registry, make_factory, monkeypatch):
    make_factory(file_registry).calibrate("A0")
    path = file_registry.database.path
    file_registry.close()
    event.listen(Engine, "connect", _only_reading)
    try:
        with open_registry(f"sqlite:///{path}", create=False) as registry:
            assert registry.calibrations.get("A0").revision == 1
            with pytest.raises(RegistryError, match="readonly"):
                make_factory(registry).calibrate("A0", 2)
    finally:
        event.remove(Engine, "connect", _only_reading)
    with open_registry(f"sqlite:///{path}", create=False) as registry:
        assert registry.verify() == [] and registry.calibrations.get("A0").revision == 1


def _only_reading(connection, record) -> None:
    connection.execute("PRAGMA query_only = ON")
