"""Measured recordings and the methods that the map benchmarks put side by side, on the same windows in the same run."""

import os
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import ot
import pandas as pd

from softcal.core.errors import UnitRefused
from softcal.core.maps.choose import choose_map
from softcal.core.maps.config import MapConfig
from softcal.core.maps.interface import FitProblem
from softcal.core.metrics import rmse
from softcal.core.network.config import NetworkConfig
from softcal.core.network.network import Network
from softcal.core.network.training import fit_network
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.unit.calibrate import UnitProblem, calibrate
from softcal.core.unit.source_model import SourceModel

DATA = Path(os.environ.get("SOFTCAL_DATA", Path(__file__).parents[3] / "shared" / "data"))
SOURCES = ("taxel_001", "taxel_030", "taxel_060", "taxel_061", "taxel_135")
STRETCHES = 32
NETWORK = NetworkConfig(hidden=(40, 20), max_epochs=60, batch=128)
"""Smaller than the paper's for f and own calibrations alike, so that hundreds of units fit in minutes."""

EXACT_ROWS = 1200
"""Windows per side for POT's exact solver where all of them would take hours."""

Method = Callable[[FitProblem, LabelledRecording], Array]
"""Fit to the unit's unlabelled recording, then estimate the reference on the test windows."""


def egain(serial: str) -> LabelledRecording:
    """One of the paper's two eGaIn sensors: 1,200 samples at 50 Hz."""
    return labelled(serial, pd.read_csv(DATA / "egain_pair" / f"{serial}.csv"))


def skin(position: str) -> LabelledRecording:
    """One place of the skin, its trials joined, at the 50 Hz that fit its speeds."""
    return labelled(position, pd.read_parquet(DATA / "skin_places" / f"{position}.parquet"))


def labelled(serial: str, table: pd.DataFrame) -> LabelledRecording:
    """Output and force of a table, sampled at 50 Hz."""
    output_V, force_N = (table[name].to_numpy(np.float64) for name in ("output_V", "force_N"))
    return LabelledRecording(OutputRecording(serial, np.arange(len(table)) / 50.0, output_V, 50.0), force_N)


def insole(name: str) -> pd.DataFrame:
    """All taxels of one day's load programme."""
    return pd.read_parquet(DATA / "insole_lot" / f"{name}.parquet")


def taxels(table: pd.DataFrame) -> list[str]:
    """Names of the taxels."""
    return [column for column in map(str, table) if column.startswith("taxel")]


def taxel(table: pd.DataFrame, name: str, rows: Array | None = None) -> LabelledRecording:
    """One taxel with the common pressure beside it, on some rows."""
    part = table if rows is None else table[rows]
    output = OutputRecording(name, part["t_s"].to_numpy(), part[name].to_numpy(np.float64), 48.9, "count")
    return LabelledRecording(output, part["pressure_bar"].to_numpy(), "bar")


def split(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Masks of the insole's rows to fit and of its held-out quarter: eight stretches spread over the programme."""
    is_test = np.arange(count) * STRETCHES // count % 4 == 2
    return ~is_test, is_test


def verdict_word(problem: FitProblem, model: SourceModel) -> str:
    """Verdict on the unit against the default limit, made without a label of it."""
    try:
        return calibrate(UnitProblem(model, problem.target, anchors=problem.anchors)).decision.verdict
    except UnitRefused:
        return "refused"


def score(network: Network, mapped: Array, test: LabelledRecording) -> float:
    """RMSE of f on mapped windows."""
    return rmse(network.evaluate(mapped), test.window_reference)


def default(problem: FitProblem, test: LabelledRecording) -> Array:
    """The product's own choice."""
    return problem.network.evaluate(choose_map(problem).unit_map.apply(test.windows))


def one_family(name: str) -> Method:
    """One family of the catalogue; NaN where it refuses the unit."""

    def method(problem: FitProblem, test: LabelledRecording) -> Array:
        try:
            unit_map = choose_map(replace(problem, config=MapConfig(name))).unit_map
        except UnitRefused:
            return np.full(len(test.windows), np.nan)
        return problem.network.evaluate(unit_map.apply(test.windows))

    return method


def pot(make: Callable[[], ot.da.BaseTransport]) -> Method:
    """A transport of POT's domain adaptation module with its own out-of-sample rule, as the paper used it."""

    def method(problem: FitProblem, test: LabelledRecording) -> Array:
        transport = make()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            transport.fit(Xs=thinned(problem.target.windows), Xt=thinned(problem.source.windows))
            return problem.network.evaluate(transport.transform(Xs=np.array(test.windows)))

    return method


def skada_jdot(problem: FitProblem, test: LabelledRecording) -> Array:
    """skada's joint distribution transport regressor, on kernel ridge regression (it cannot train a network)."""
    from skada import JDOTRegressor
    from sklearn.kernel_ridge import KernelRidge

    source, target = problem.source.windows, problem.target.windows
    rows, scale = _spread(len(source), 600), float(source.std())
    x = np.concatenate([source[rows], target[_spread(len(target), 600)]]) / scale
    domain = np.where(np.arange(len(x)) < len(rows), 1, -2)
    y = np.where(domain > 0, np.resize(problem.source.window_reference[rows], len(x)), np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = JDOTRegressor(KernelRidge(kernel="rbf", alpha=0.1))
        model.fit(x, y, sample_domain=domain)
        return np.asarray(model.predict(np.array(test.windows) / scale))


METHODS: Mapping[str, Method] = {
    "before (no map)": one_family("identity"),
    "softcal default": default,
    "affine (two extremes)": one_family("affine"),
    "two_point": one_family("two_point"),
    "monotone": one_family("monotone"),
    "exact": one_family("exact"),
    "joint": one_family("joint"),
    "ot.da.EMDTransport": pot(lambda: ot.da.EMDTransport(max_iter=2_000_000)),
    "ot.da.LinearTransport": pot(lambda: ot.da.LinearTransport(reg=1e-8)),
    "skada JDOTRegressor": skada_jdot,
}


def thinned(windows: Array) -> Array:
    """Windows spread evenly, at most EXACT_ROWS."""
    return np.array(windows[_spread(len(windows), EXACT_ROWS)])


def _spread(count: int, maximum: int) -> np.ndarray:
    return np.linspace(0, count - 1, min(count, maximum)).astype(int)


def own_error(train: LabelledRecording, test: LabelledRecording, config: NetworkConfig) -> float:
    """RMSE of a network trained on the unit's own labels."""
    return score(fit_network(train, config).network, np.asarray(test.windows), test)


def summary(ratios: Iterable[float]) -> tuple[float, float, float]:
    """Median, 95th percentile and largest of finite ratios."""
    values = np.array([r for r in ratios if np.isfinite(r)])
    return (
        (float(np.median(values)), float(np.quantile(values, 0.95)), float(values.max()))
        if len(values)
        else (np.nan,) * 3
    )
