"""A fresh registry on either database, calibrations to fill it, and lot folders of any size."""

import os
import sys
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from sqlalchemy import create_engine, text

from softcal.app.files.lot_toml import write_lot_toml
from softcal.core.identity import content_sha256
from softcal.core.lot import Lot
from softcal.core.maps.affine_map import AffineMap
from softcal.core.maps.interface import map_sha256
from softcal.core.network.network import Network
from softcal.core.profiles import source_profile, unit_profile
from softcal.core.simulated_lot import DEPTH_MM, draw_twins
from softcal.core.twin.simulate import simulate
from softcal.core.unit.correspondence import find_correspondence
from softcal.core.unit.fit import Fit, FittedMap
from softcal.core.unit.health import OutputLimits
from softcal.core.unit.method import LEVELS, Method
from softcal.core.unit.state import UnitState
from softcal.core.unit.uncertainty import ErrorForecast, Interval, Support
from softcal.core.unit.verdict import Limit
from softcal.db.connection import open_registry
from softcal.db.registry import Registry

ADMIN_URL = os.environ.get("SOFTCAL_TEST_POSTGRESQL", "postgresql+psycopg://postgres@127.0.0.1:5432/postgres")
DATABASES = ("SQLite", "PostgreSQL")
SOFTCAL = str(Path(sys.executable).with_name("softcal"))
RATE_HZ = 50.0
SAMPLES = 1250
SIMULATED = 40
"""Units that are simulated; all the others repeat one of them with a gain, an offset and noise of their own."""


@contextmanager
def fresh_url(kind: str, template: str = "") -> Iterator[str]:
    """Give the URL of an empty database, or of a copy of `template` on the server; remove it afterwards."""
    if kind == "SQLite":
        with tempfile.TemporaryDirectory(prefix="softcal-bench-") as folder:
            yield f"sqlite:///{Path(folder) / 'registry.db'}"
        return
    name = f"softcal_bench_{uuid.uuid4().hex[:10]}"
    admin = create_engine(ADMIN_URL, isolation_level="AUTOCOMMIT")
    with admin.connect() as connection:
        connection.execute(text(f"CREATE DATABASE {name}" + (f" TEMPLATE {template}" if template else "")))
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


METHOD = Method()


def state(serial: str, number: int, network_id: str) -> UnitState:
    """Return a calibration of about 4 kB, unlike every other one."""
    unit_map = AffineMap(1.0 + number, 0.0)
    support = Support(0.0, 1.0, np.zeros(2), np.ones(2), np.zeros((16, 16)), 1.0, 1.0)
    interval = Interval(support, np.full((3, LEVELS), float(number + 1)), 0.0, 3.0, 1.0, 1.0, 1.0)
    fit = Fit(
        id=content_sha256({}, {"serial": serial, "number": number}),
        serial=serial,
        network_id=network_id,
        recording_sha256=content_sha256({}, {"recording": serial}),
        family=unit_map.family,
        map_sha256=map_sha256(unit_map),
        method=METHOD,
        correspondence=find_correspondence({}, METHOD.correspondence),
        forecast=ErrorForecast(0.1, 0.05, 0.2),
        fit_s=0.01,
        fitted=FittedMap(unit_map, interval, OutputLimits(-np.inf, np.inf, 100)),
    )
    return UnitState(fit=fit, limit=Limit("N", 0.5))


def database_of(kind: str) -> str:
    """Return the version of a database, for the caption of a table."""
    with fresh_url(kind) as url, open_registry(url) as registry, registry.database.reading() as connection:
        query = "SELECT sqlite_version()" if kind == "SQLite" else "SHOW server_version"
        return f"{kind} {str(connection.execute(text(query)).scalar_one()).split()[0]}"


def make_lot(folder: Path, units: int, source_s: float = 100.0, seed: int = 0) -> Path:
    """Write a lot folder of `units` recordings of 1,250 samples and a source of 5,000; return it."""
    rng = np.random.default_rng(seed)
    twins = draw_twins(rng, SIMULATED + 1)
    for name in ("source", "units"):
        (folder / name).mkdir(parents=True)
    write_lot_toml(folder, Lot(folder.name, "S0", RATE_HZ))
    t_s, stage_mm = source_profile(rng, source_s, DEPTH_MM).sample(RATE_HZ)
    force_N, output_V = simulate(twins[0], t_s, stage_mm, rng)
    rows = np.column_stack([t_s, output_V, force_N])
    np.savetxt(folder / "source/S0.csv", rows, "%.9g", ",", header="t_s,output,reference", comments="")
    outputs_V = []
    for twin in twins[1:]:
        t_s, stage_mm = unit_profile(rng, SAMPLES / RATE_HZ, DEPTH_MM).sample(RATE_HZ)
        outputs_V.append(simulate(twin, t_s, stage_mm, rng)[1][:SAMPLES])
    stamps = [f"{k / RATE_HZ:.2f}" for k in range(SAMPLES)]
    for k in range(units):
        output_V = _varied(rng, outputs_V[k % SIMULATED])
        lines = "\n".join(f"{t},{v:.6f}" for t, v in zip(stamps, output_V.tolist(), strict=True))
        (folder / f"units/U{k:06d}.csv").write_text(f"t_s,output\n{lines}\n")
    return folder


def _varied(rng: np.random.Generator, output_V: np.ndarray) -> np.ndarray:
    middle_V = output_V.mean()
    gain, offset_V = rng.normal(1.0, 0.1), rng.normal(0.0, 0.02)
    return np.asarray(middle_V + offset_V + gain * (output_V - middle_V) + rng.normal(0.0, 2e-4, len(output_V)))
