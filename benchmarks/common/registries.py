"""What the registry benchmarks share: a fresh registry on either database, and calibrations to fill it."""

import os
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from sqlalchemy import create_engine, text

from softcal.core.identity import content_sha256
from softcal.core.lot import Lot
from softcal.core.network.network import Network
from softcal.core.unit.calibration import CalibrationRecord
from softcal.core.words.reason import Reason
from softcal.db.connection import open_registry
from softcal.db.registry import Registry

ADMIN_URL = os.environ.get("SOFTCAL_TEST_POSTGRESQL", "postgresql+psycopg://postgres@127.0.0.1:5432/postgres")
DATABASES = ("SQLite", "PostgreSQL")


@contextmanager
def fresh_url(kind: str) -> Iterator[str]:
    """Give the URL of an empty database, and remove it afterwards."""
    if kind == "SQLite":
        with tempfile.TemporaryDirectory(prefix="softcal-bench-") as folder:
            yield f"sqlite:///{Path(folder) / 'registry.db'}"
        return
    name = f"softcal_bench_{uuid.uuid4().hex[:10]}"
    admin = create_engine(ADMIN_URL, isolation_level="AUTOCOMMIT")
    with admin.connect() as connection:
        connection.execute(text(f"CREATE DATABASE {name}"))
        try:
            yield admin.url.set(database=name).render_as_string(hide_password=False)
        finally:
            connection.execute(text(f"DROP DATABASE {name} WITH (FORCE)"))
    admin.dispose()


def begin_lot(registry: Registry, lot_id: str = "bench") -> str:
    """Register a lot with a network of the paper's size and return the network's id."""
    registry.lots.add(Lot(lot_id, "S0", 50.0))
    rng = np.random.default_rng(0)
    sizes = (15, 120, 70, 35, 1)
    weights = tuple(rng.normal(size=shape) for shape in zip(sizes[:-1], sizes[1:], strict=True))
    network = Network(weights, tuple(np.zeros(n) for n in sizes[1:]), 0.0, 1.0, 0.0, 1.0)
    return registry.networks.add(lot_id, network, {}, {}, content_sha256({}, {"lot": lot_id}))


def record(serial: str, number: int, network_id: str) -> CalibrationRecord:
    """Return a calibration of about 4 kB, unlike every other one."""
    arrays = {"map.knots": np.linspace(0.0, 1.0 + number, 64), "interval.bands": np.full((6, 64), float(number))}
    sha256 = content_sha256(arrays, {"serial": serial})
    return CalibrationRecord(
        serial,
        network_id,
        "monotone",
        sha256,
        arrays,
        {"map": {}},
        0.1,
        "pass",
        (Reason("forecast_only"),),
        sha256,
        sha256,
        fit_s=0.01,
    )


def database_of(kind: str) -> str:
    """Return the version of a database, for the caption of a table."""
    with fresh_url(kind) as url, open_registry(url) as registry, registry.database.reading() as connection:
        query = "SELECT sqlite_version()" if kind == "SQLite" else "SHOW server_version"
        return f"{kind} {str(connection.execute(text(query)).scalar_one()).split()[0]}"
