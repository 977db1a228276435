"""A second computer joins the line with one line of configuration, and with the rights of the line alone."""

import json
import os
import subprocess
import sys
import uuid
from pathlib import Path

import pytest
from sqlalchemy import create_engine, text
from sqlalchemy.exc import OperationalError

from softcal.app.cli.main import main
from softcal.db.access.grants import grant_statements
from softcal.db.connection import open_registry
from tests.system_packages import NO_POSTGRESQL

pytestmark = pytest.mark.long

ADMIN_URL = os.environ.get("SOFTCAL_TEST_POSTGRESQL", "postgresql+psycopg://postgres@127.0.0.1:5432/postgres")
SMALL = ("--hidden", "16,8", "--no-own")


@pytest.fixture
def line_url(require):
    """The URL of a registry on PostgreSQL as the owner made it, for a role that may only do the line's work."""
    engine = create_engine(ADMIN_URL, isolation_level="AUTOCOMMIT")
    try:
        admin = engine.connect()
    except OperationalError:
        require(False, NO_POSTGRESQL)
    mark = uuid.uuid4().hex[:8]
    name, line = f"softcal_test_{mark}", f"line_{mark}"
    reader, manager = f"reader_{mark}", f"manager_{mark}"
    statements = (f"DATABASE {name}", f"ROLE {line} LOGIN PASSWORD 'hush'", f"ROLE {reader}", f"ROLE {manager}")
    for one in statements:
        admin.execute(text(f"CREATE {one}"))
    owner = admin.engine.url.set(database=name)
    with open_registry(owner.render_as_string(hide_password=False)) as registry:
        with registry.database.writing() as connection:
            for statement in grant_statements(line, reader, manager):
                connection.execute(text(statement))
    yield owner.set(drivername="postgresql", username=line, password="hush").render_as_string(hide_password=False)
    admin.execute(text(f"DROP DATABASE {name} WITH (FORCE)"))
    admin.execute(text(f"DROP ROLE {line}, {reader}, {manager}"))
    admin.close()
    engine.dispose()


def softcal(url: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a command on a computer that knows nothing but where the registry is."""
    command = [sys.executable, "-m", "softcal.app.cli.main", *arguments]
    environment = os.environ | {"SOFTCAL_REGISTRY": url, "OMP_NUM_THREADS": "1"}
    return subprocess.run(command, capture_output=True, text=True, timeout=120, env=environment)


def test_one_line_of_configuration_is_enough(lot_folder: Path, line_url: str, tmp_path: Path) -> None:
    assert main(["batch", str(lot_folder), *SMALL, "--registry", line_url]) in (0, 1)
    again = softcal(line_url, "batch", str(lot_folder), *SMALL, "--json", str(tmp_path / "report.json"))
    assert again.returncode in (0, 1)
    units = json.loads((tmp_path / "report.json").read_text())["units"]
    assert [unit["is_new"] for unit in units] == [False] * 3
    listed = softcal(line_url, "registry", "list", "--json", "-")
    assert {unit["serial"] for unit in json.loads(listed.stdout)["units"]} == {"A0", "A1", "A2", "A3"}
    whole = softcal(line_url, "registry", "verify")
    assert whole.returncode == 0
    for process in (again, listed, whole):
        assert "hush" not in process.stdout + process.stderr
