"""A disk that is full and a folder that may not be written: one clear line, and the registry as it was."""

import subprocess
import sys
import textwrap

import pytest
from sqlalchemy import Engine, event

from softcal.app.cli.main import main
from softcal.core.errors import RegistryError
from softcal.db.connection import open_registry

FILL = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
from dataclasses import replace
from softcal.core.errors import RegistryError
from softcal.core.identity import content_sha256
from softcal.db.connection import open_registry
with open_registry(sys.argv[1], create=False) as registry:
    record = registry.calibration("A0").record
    limit = int(sys.argv[2])
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    try:
        for number in range(100_000):
            own = replace(record, serial=f"A{number}", input_sha256=content_sha256({}, {"number": number}))
            print(f"A{number}", registry.add_calibration("L1", own), flush=True)
    except RegistryError as error:
        print(f"refused {error}", flush=True)
"""
"""No file of this process may grow beyond the limit: for SQLite what a full disk is."""


def test_a_full_disk_loses_nothing_that_was_acknowledged(file_registry, make_factory):
    make_factory(file_registry).calibrate("A0")
    url = f"sqlite:///{file_registry.database.path}"
    file_registry.close()
    size = file_registry.database.path.stat().st_size
    command = [sys.executable, "-c", FILL, url, str(size + 200_000)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    *acknowledged, last = done.stdout.splitlines()
    assert acknowledged and last.startswith("refused registry") and "nothing was changed" in last
    assert "full" in last or "I/O" in last, last
    with open_registry(url, create=False) as registry:
        assert registry.verify() == []
        for line in acknowledged:
            serial, revision = line.split()
            assert registry.calibration(serial, int(revision)).revision == int(revision)
        make_factory(registry).calibrate("A0", 7)


def test_a_backup_onto_a_full_disk_leaves_no_file(file_registry, make_factory, tmp_path, monkeypatch):
    make_factory(file_registry).calibrate("A0")
    code = textwrap.dedent(
        """
        import resource, signal, sys
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        from pathlib import Path
        from softcal.core.errors import RegistryError
        from softcal.db.backup import back_up
        from softcal.db.connection import open_registry
        with open_registry(sys.argv[1], create=False) as registry:
            resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))
            try:
                back_up(registry.database, Path(sys.argv[2]))
            except RegistryError as error:
                print(error)
        """
    )
    command = [sys.executable, "-c", code, f"sqlite:///{file_registry.database.path}", str(tmp_path / "b.db")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert len(done.stdout.splitlines()) == 1 and not list(tmp_path.glob("*b.db*"))
    assert file_registry.verify() == []


def test_a_folder_that_may_not_be_written_is_named(capsys):
    assert main(["registry", "upgrade", "--registry", "sqlite:////proc/registry.db"]) == 4
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1 and "/proc" in said[0]
    assert "cannot be written" in said[0] or "unable to open" in said[0]


def test_a_registry_that_may_only_be_read_says_so(file_registry, make_factory, monkeypatch):
    make_factory(file_registry).calibrate("A0")
    path = file_registry.database.path
    file_registry.close()
    event.listen(Engine, "connect", _only_reading)
    try:
        with open_registry(f"sqlite:///{path}", create=False) as registry:
            assert registry.calibration("A0").revision == 1
            with pytest.raises(RegistryError, match="readonly database; nothing was changed"):
                make_factory(registry).calibrate("A0", 2)
    finally:
        event.remove(Engine, "connect", _only_reading)
    with open_registry(f"sqlite:///{path}", create=False) as registry:
        assert registry.verify() == [] and registry.calibration("A0").revision == 1


def _only_reading(connection, record) -> None:
    connection.execute("PRAGMA query_only = ON")
