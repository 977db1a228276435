"""A registry on SQLite and on PostgreSQL: every test that asks for `registry` or `registry_url` runs on both."""

import os
import shutil
import uuid
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import URL, create_engine, delete, text
from sqlalchemy.exc import OperationalError
from sqlalchemy.pool import NullPool

from softcal.core.lot import Lot
from softcal.core.network.network import Network
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.unit.state import UnitState
from softcal.db.connection import open_registry
from softcal.db.registry import Registry
from softcal.db.schema.tables import metadata
from tests.system_packages import NO_POSTGRESQL
from tests.unit_states import state_of

ADMIN_URL = os.environ.get("SOFTCAL_TEST_POSTGRESQL", "postgresql+psycopg://postgres@127.0.0.1:5432/postgres")
CASES_ON_SERVER = 3
LIMIT_N = 2.0


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Of a table of cases, the first few run on PostgreSQL every time, the others in the long layer."""
    attempts: Counter[str] = Counter()
    for item in items:
        if isinstance(item, pytest.Function) and item.path.parent == Path(__file__).parent:
            cases = item.callspec.params if hasattr(item, "callspec") else {}
            is_on_server = "postgresql" in cases.values()
            attempts[item.originalname] += is_on_server
            if is_on_server and len(cases) > 1 and attempts[item.originalname] > CASES_ON_SERVER:
                item.add_marker(pytest.mark.long)


@pytest.fixture(scope="session")
def postgresql_admin():
    """A connection that makes and drops databases; None where no server answers."""
    engine = create_engine(ADMIN_URL, isolation_level="AUTOCOMMIT")
    try:
        with engine.connect() as connection:
            yield connection
    except OperationalError:
        yield None
    engine.dispose()


@pytest.fixture(params=["sqlite", "postgresql"])
def new_url(request, tmp_path, require) -> Iterator[Callable[[], str]]:
    """`new_url()` gives the URL of a database that is empty, of the kind the test runs on."""
    urls: list[str] = []

    def on_sqlite() -> str:
        return f"sqlite:///{tmp_path / uuid.uuid4().hex}.db"

    def on_postgresql() -> str:
        admin = request.getfixturevalue("postgresql_admin")
        require(admin is not None, NO_POSTGRESQL)
        urls.append(f"softcal_test_{uuid.uuid4().hex[:12]}")
        admin.execute(text(f"CREATE DATABASE {urls[-1]}"))
        return admin.engine.url.set(database=urls[-1]).render_as_string(hide_password=False)

    yield on_sqlite if request.param == "sqlite" else on_postgresql
    for name in urls:
        request.getfixturevalue("postgresql_admin").execute(text(f"DROP DATABASE {name} WITH (FORCE)"))


@pytest.fixture(scope="session")
def sqlite_template(tmp_path_factory) -> Path:
    """A registry with tables and nothing in it: copying it is faster than migrating anew for each test."""
    path = tmp_path_factory.mktemp("template") / "registry.db"
    open_registry(f"sqlite:///{path}").close()
    return path


@pytest.fixture(scope="session")
def postgresql_registry(postgresql_admin) -> Iterator[URL]:
    """One database with tables for all tests that start from nothing: a new database takes seconds."""
    name = f"softcal_test_{uuid.uuid4().hex[:12]}"
    postgresql_admin.execute(text(f"CREATE DATABASE {name}"))
    postgresql_admin.execute(text(f"ALTER DATABASE {name} SET synchronous_commit = off"))
    url = postgresql_admin.engine.url.set(database=name)
    open_registry(url.render_as_string(hide_password=False)).close()
    yield url
    postgresql_admin.execute(text(f"DROP DATABASE {name} WITH (FORCE)"))


def emptied(url: URL) -> str:
    """Empty every table of a PostgreSQL registry; as an administrator, past the triggers that forbid it."""
    engine = create_engine(url, poolclass=NullPool)
    with engine.begin() as connection:
        connection.execute(text("SET LOCAL session_replication_role = replica"))
        for table in metadata.sorted_tables:
            if table.name != "registry_info":
                connection.execute(delete(table))
    return url.render_as_string(hide_password=False)


@pytest.fixture(params=["sqlite", "postgresql"])
def registry_url(request, tmp_path, require) -> str:
    """The URL of a registry with nothing in it."""
    if request.param == "postgresql":
        require(request.getfixturevalue("postgresql_admin") is not None, NO_POSTGRESQL)
        return emptied(request.getfixturevalue("postgresql_registry"))
    shutil.copy(request.getfixturevalue("sqlite_template"), tmp_path / "registry.db")
    return f"sqlite:///{tmp_path / 'registry.db'}"


@pytest.fixture
def registry(registry_url) -> Iterator[Registry]:
    with open_registry(registry_url) as opened:
        yield opened


@pytest.fixture
def file_registry(tmp_path: Path) -> Iterator[Registry]:
    """A registry in an SQLite file, for what concerns files."""
    with open_registry(f"sqlite:///{tmp_path / 'station.db'}") as opened:
        yield opened


@pytest.fixture(scope="session")
def network() -> Network:
    rng = np.random.default_rng(1)
    weights = (rng.normal(size=(15, 4)), rng.normal(size=(4, 1)))
    return Network(weights, (np.zeros(4), np.zeros(1)), 0.5, 0.1, 1.0, 2.0)


@pytest.fixture(scope="session")
def recording_of() -> Callable[..., OutputRecording]:
    """`recording_of(serial, seed=0)` gives a short output recording."""
    return output_recording


@pytest.fixture(scope="session")
def labelled_of() -> Callable[..., LabelledRecording]:
    """`labelled_of(serial, seed=0)` gives a short labelled recording."""
    return labelled_recording


def output_recording(serial: str, seed: int = 0, samples: int = 60) -> OutputRecording:
    output = np.random.default_rng([seed, *serial.encode()]).normal(size=samples)
    return OutputRecording(serial, np.arange(samples) / 50.0, output, 50.0)


def labelled_recording(serial: str, seed: int = 0) -> LabelledRecording:
    unlabelled = output_recording(serial, seed)
    return LabelledRecording(unlabelled, 3.0 * unlabelled.output)


@dataclass(frozen=True)
class Factory:
    """A lot with its network in a registry, and calibrations that differ by their number."""

    registry: Registry
    lot_id: str
    network_id: str

    def state(self, serial: str, number: int = 1, verdict: str = "pass") -> UnitState:
        return state_of(serial, self.network_id, output_recording(serial).sha256, number, verdict, LIMIT_N)

    def calibrate(self, serial: str, number: int = 1) -> int:
        return self.registry.calibrations.add(self.lot_id, self.state(serial, number), actor="tester")


@pytest.fixture
def make_factory(network) -> Callable[..., Factory]:
    """`make_factory(registry, lot_id="L1")` registers a lot with source S0 and a network."""

    def make(registry: Registry, lot_id: str = "L1") -> Factory:
        registry.lots.add(Lot(lot_id, "S0", 50.0, limit_rmse=LIMIT_N))
        registry.recordings.add(lot_id, labelled_recording("S0"), "source")
        network_id = registry.networks.add(lot_id, network, {"rmse": 0.05}, {"seed": 0}, "a" * 64)
        return Factory(registry, lot_id, network_id)

    return make


@pytest.fixture
def factory(registry, make_factory) -> Factory:
    return make_factory(registry)
