"""What users would pick instead of softcal's map, on the units of one lot folder: same f, same windows, same test rows.

python benchmarks/transfer.py LOT [--figure FILE.html] [--seed N] [--labels K ...] [--hidden 120,70,35]

LOT is a lot folder with audits (docs/engineer.md). A unit's audit is cut: the last quarter tests, the rest may be
learnt from by the methods that need labels of the unit. Where the audit is the unit's own recording, no method sees
its last quarter. Each error is an RMSE over the test rows, and is shown over that of a calibration of the unit's own.

Without labels of the unit: softcal's default, POT's transports on windows (EMD as the paper used it, Sinkhorn, linear),
skada's JDOT, di-PLS of diPLSlib. With K labelled windows, spread over the load: a gain and an offset of the output,
and the calibration transfer of chemotools (DS, PDS, SST), all from pairs; a window's partner is the source's window of
the nearest load and slope. chemotools and diPLSlib are no dependency of softcal:
pip install chemotools diPLSlib. A baseline that is not installed, and one that fails, is named and left out.
"""

import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import ot
import plotly.graph_objects as go
import sklearn.utils.validation
from common.command import parser_of
from common.map_methods import METHODS, Method, own_error, pot, summary, thinned
from common.tables import print_table

from softcal.app.files.lot_folder import open_lot_folder
from softcal.core.errors import UnitRefused
from softcal.core.maps.interface import FitProblem
from softcal.core.metrics import rmse
from softcal.core.network.config import NetworkConfig
from softcal.core.network.training import fit_network
from softcal.core.recording import Array, LabelledRecording

UNLABELLED = (
    "before (no map)", "softcal default", "ot.da.EMDTransport", "ot.da.LinearTransport", "skada JDOTRegressor"
)  # fmt: skip
SINKHORN = 0.01
"""Entropy of Sinkhorn's transport, over the largest cost."""

COMPONENTS = 5
"""Latent variables of the PLS and SST baselines: level, slope, bend and two more of fifteen samples."""

DI_PLS_WEIGHT = 10.0
"""What domains that differ cost in di-PLS, as in its documentation's example."""


@dataclass(frozen=True)
class Unit:
    """One unit: what may be learnt from it without labels, with labels, and what tests."""

    problem: FitProblem
    train: LabelledRecording
    test: LabelledRecording


@dataclass(frozen=True)
class Score:
    """What one method reached on one unit: error over own, and seconds of processor time."""

    ratio: float
    seconds: float


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("lot", type=Path, help="lot folder with audits")
    parser.add_argument("--figure", type=Path, help="standalone page with the error of every unit")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--labels", type=int, nargs="+", default=[2, 10, 50], help="labelled windows of a unit")
    parser.add_argument("--hidden", default="120,70,35", help="widths of f and of own calibrations")
    options = parser.parse_args()
    config = NetworkConfig(hidden=tuple(map(int, options.hidden.split(","))), seed=options.seed)
    units = read_units(options.lot, config)
    methods = unlabelled() | {f"{n}, {k} labels": m for k in options.labels for n, m in labelled(k).items()}
    own_rmse = {serial: own_error(unit.train, unit.test, config) for serial, unit in units.items()}
    scores = {
        name: {s: score(method, unit, own_rmse[s]) for s, unit in units.items()} for name, method in methods.items()
    }
    report(scores, own_rmse, next(iter(units.values())).test.reference_unit)
    if options.figure:
        options.figure.write_text(figure(scores).to_html(include_plotlyjs=True), encoding="utf-8")


def read_units(source_folder: Path, config: NetworkConfig) -> dict[str, Unit]:
    """Read the units that have an audit, with f trained on the lot's source."""
    folder = open_lot_folder(source_folder)
    source = folder.read_source()
    network, units = fit_network(source, config).network, {}
    for serial in folder.unit_paths:
        if (audit := folder.read_audit(serial)) is None:
            continue
        recording, cut = folder.read_unit(serial), 3 * len(audit) // 4
        if len(recording) == len(audit) and np.array_equal(recording.output, audit.unlabelled.output):
            recording = recording.part(0, cut)
        problem = FitProblem(source, network, recording, seed=config.seed)
        units[serial] = Unit(problem, audit.part(0, cut), audit.part(cut, len(audit)))
    if not units:
        raise SystemExit(f"{source_folder}: no unit has an audit, so no error can be measured")
    return units


def unlabelled() -> dict[str, Callable[[Unit], Array]]:
    """Methods that see the unit's output alone: estimates on its test windows."""
    methods = {name: METHODS[name] for name in UNLABELLED}
    methods["ot.da.SinkhornTransport"] = pot(lambda: ot.da.SinkhornTransport(reg_e=SINKHORN, norm="max"))
    methods["diPLSlib DIPLS (linear, no f)"] = di_pls
    return {name: _without_labels(method) for name, method in methods.items()}


def _without_labels(method: Method) -> Callable[[Unit], Array]:
    return lambda unit: method(unit.problem, unit.test)


def di_pls(problem: FitProblem, test: LabelledRecording) -> Array:
    """Domain-invariant PLS (Nikzad-Langerodi et al. 2018): a linear model of its own in place of f and a map."""
    from diPLSlib import models

    # diPLSlib 2.5 calls an argument by the name that it had before scikit-learn 1.8.
    for name in ("check_X_y", "check_array"):
        setattr(models, name, partial(_renamed, getattr(sklearn.utils.validation, name)))
    source, scale = problem.source, float(problem.source.unlabelled.output.std())
    model = models.DIPLS(A=COMPONENTS, l=DI_PLS_WEIGHT)
    x, xt = np.array(source.windows) / scale, thinned(problem.target.windows) / scale
    model.fit(x, source.window_reference[:, None], x, xt)
    return np.asarray(model.predict(np.array(test.windows) / scale)).ravel()


def _renamed(check: Callable[..., Any], *arrays: Any, force_all_finite: bool = True, **options: Any) -> Any:
    return check(*arrays, ensure_all_finite=force_all_finite, **options)


def labelled(count: int) -> dict[str, Callable[[Unit], Array]]:
    """Methods that see `count` labelled windows of the unit."""
    methods: dict[str, Callable[[Unit], Array]] = {"affine on the output": lambda unit: affine(unit, count)}
    if count > COMPONENTS:
        methods |= {f"chemotools {name}": standardised(name, count) for name in ("DS", "PDS", "SST")}
    return methods


def draw_unit(unit: Unit, count: int) -> tuple[Array, Array]:
    """Windows and loads of the unit, (count, 15) and (count,), spread evenly over the loads it was trained under."""
    order = np.argsort(unit.train.window_reference, kind="stable")
    rows = order[np.linspace(0, len(order) - 1, count).round().astype(int)]
    return np.array(unit.train.windows[rows]), unit.train.window_reference[rows]


def affine(unit: Unit, count: int) -> Array:
    """Gain and offset of the output: a line through what the unit and the source read under the same known loads."""
    windows, load = draw_unit(unit, count)
    gain, offset = np.polyfit(windows.mean(axis=1), partners(unit, windows, load).mean(axis=1), 1)
    return unit.problem.network.evaluate(offset + gain * np.array(unit.test.windows))


def standardised(name: str, count: int) -> Callable[[Unit], Array]:
    """chemotools' standardisation of the unit's windows to the source's, from paired windows."""

    def method(unit: Unit) -> Array:
        from chemotools import adaptation

        makers = {
            "DS": lambda: adaptation.DirectStandardization(),
            "PDS": lambda: adaptation.PiecewiseDirectStandardization(window_length=5, n_components=2),
            "SST": lambda: adaptation.SpectralSpaceTransform(n_components=COMPONENTS),
        }
        windows, load = draw_unit(unit, count)
        model = makers[name]().fit(windows, X_source=partners(unit, windows, load))
        return unit.problem.network.evaluate(np.asarray(model.transform(np.array(unit.test.windows))))

    return method


def partners(unit: Unit, windows: Array, load: Array) -> Array:
    """The source's window of the nearest load and slope for each window of the unit: (n, 15)."""
    source = unit.problem.source
    # Slopes are of outputs, each over its own spread: the load's slope is known at single instants only.
    slopes = [
        (x[:, -1] - x[:, 0]) / recording.unlabelled.output.std()
        for x, recording in ((windows, unit.train), (source.windows, source))
    ]
    far = (load[:, None] - source.window_reference) / source.reference.std()
    nearest = np.argmin(far**2 + (slopes[0][:, None] - slopes[1]) ** 2, axis=1)
    return np.array(source.windows[nearest])


def score(method: Callable[[Unit], Array], unit: Unit, own_rmse: float) -> Score | str:
    """Run one method on one unit; a line that says why where it gives no estimate."""
    started_s = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            estimate = method(unit)
    except ModuleNotFoundError as missing:
        return f"{missing.name} is not installed"
    except (UnitRefused, ValueError, np.linalg.LinAlgError) as error:
        return str(error).splitlines()[0]
    if not np.isfinite(estimate).all():
        return "refused, or not finite"
    return Score(rmse(estimate, unit.test.window_reference) / own_rmse, time.process_time() - started_s)


def report(scores: Mapping[str, Mapping[str, Score | str]], own_rmse: Mapping[str, float], unit: str) -> None:
    """Print the table, best median first, and what gave no estimate."""
    print(
        f"{len(own_rmse)} units. "
        f"Own calibration: {min(own_rmse.values()):.4g} to {max(own_rmse.values()):.4g} {unit}.\n"
    )
    rows: list[tuple[str, str, float, float, float, float]] = []
    for name, by_serial in scores.items():
        if scored := [s for s in by_serial.values() if isinstance(s, Score)]:
            middle, high, worst = summary(s.ratio for s in scored)
            rows.append(
                (
                    name,
                    f"{len(scored)}/{len(own_rmse)}",
                    middle,
                    high,
                    worst,
                    float(np.mean([s.seconds for s in scored])),
                )
            )
    head = ("method", "units", "median after / own", "95 %", "worst", "processor seconds a unit")
    rows.sort(key=lambda row: row[2])
    print_table(head, rows)
    for name, by_serial in scores.items():
        for why in sorted({s for s in by_serial.values() if isinstance(s, str)}):
            print(f"- {name}: {why} ({sum(s == why for s in by_serial.values())} of {len(own_rmse)} units)")


def figure(scores: Mapping[str, Mapping[str, Score | str]]) -> go.Figure:
    """Error over own, unit by unit, best method first, on a logarithmic axis as in the paper's figures."""
    drawn_figure = go.Figure()
    ratios_by_method = {n: {k: s.ratio for k, s in row.items() if isinstance(s, Score)} for n, row in scores.items()}
    for name, ratios in sorted(ratios_by_method.items(), key=lambda item: np.median([*item[1].values(), np.inf])):
        drawn_figure.add_scatter(x=list(ratios), y=list(ratios.values()), mode="markers", name=name)
    drawn_figure.add_hline(y=1.0, line_dash="dash", annotation_text="calibration of the unit's own")
    drawn_figure.update_yaxes(type="log", title="error / error of an own calibration")
    return drawn_figure.update_xaxes(title="unit")


if __name__ == "__main__":
    main()
