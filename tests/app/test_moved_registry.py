"""A registry that moved from SQLite to PostgreSQL, or came back from a backup, computes nothing again."""

import json
import os
import uuid
from pathlib import Path

import pytest
from sqlalchemy import create_engine, text

from softcal.app.calibration import unit_calibration
from softcal.app.cli.main import main
from softcal.core.errors import InputError
from softcal.db.connection import open_registry
from tests.system_packages import NO_POSTGRESQL

SMALL = ("--hidden", "16,8", "--no-own")


@pytest.fixture
def postgresql(require):
    """The URL of an empty PostgreSQL database."""
    url = os.environ.get("SOFTCAL_TEST_POSTGRESQL", "postgresql+psycopg://postgres@127.0.0.1:5432/postgres")
    engine = create_engine(url, isolation_level="AUTOCOMMIT")
    try:
        connection = engine.connect()
    except Exception:
        require(False, NO_POSTGRESQL)
    name = f"softcal_test_{uuid.uuid4().hex[:12]}"
    connection.execute(text(f"CREATE DATABASE {name}"))
    yield engine.url.set(database=name).render_as_string(hide_password=False)
    connection.execute(text(f"DROP DATABASE {name} WITH (FORCE)"))
    connection.close()
    engine.dispose()


def batch(folder: Path, url: str) -> list[dict]:
    report = folder.parent / "report.json"
    report.unlink(missing_ok=True)
    assert main(["batch", str(folder), "--registry", url, "--json", str(report), *SMALL]) in (0, 1)
    return json.loads(report.read_text())["units"]


def move(source: str, url: str, backup: Path) -> None:
    assert main(["registry", "backup", str(backup), "--registry", source]) == 0
    assert main(["registry", "restore", str(backup), "--registry", url]) == 0


@pytest.mark.long
def test_the_way_from_sqlite_to_postgresql_and_back_computes_nothing_again(
    lot_folder, registry_url, postgresql, tmp_path, monkeypatch
):
    first = batch(lot_folder, registry_url)

    def forbidden(*_):
        raise AssertionError("a unit was calibrated again")

    monkeypatch.setattr(unit_calibration, "calibrated", forbidden)
    source = registry_url
    for number, url in enumerate([postgresql, f"sqlite:///{tmp_path / 'back.db'}"]):
        move(source, url, tmp_path / f"{number}.db")
        again = batch(lot_folder, url)
        assert [unit["is_new"] for unit in again] == [False] * 3
        for kind in ("map", "verdict"):
            assert [unit[kind] for unit in again] == [unit[kind] for unit in first]
        with open_registry(url, create=False) as registry:
            assert registry.verify() == []
        source = url


@pytest.mark.long
def test_another_recording_after_the_move_is_calibrated_and_the_first_one_comes_back(
    lot_folder, registry_url, postgresql, tmp_path
):
    batch(lot_folder, registry_url)
    move(registry_url, postgresql, tmp_path / "b.db")
    path = lot_folder / "units/A1.csv"
    original = path.read_text()
    path.write_text((lot_folder / "units/A2.csv").read_text().replace(",0.", ",0.0"))
    moved = {unit["serial"]: unit for unit in batch(lot_folder, postgresql)}
    assert moved["A2"]["is_new"] is False
    path.write_text(original)
    assert {unit["serial"]: unit["map"]["revision"] for unit in batch(lot_folder, postgresql)}["A1"] == 1
    with open_registry(postgresql, create=False) as registry, pytest.raises(InputError, match="9"):
        registry.calibrations.get("A1", 9)
