"""Quality figures: gauge studies, capability, yields and golden units."""

import csv
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from softcal.core.errors import InputError
from softcal.core.quality.control_chart import Capability, ControlChart, capability, control_chart
from softcal.core.quality.gauge_study import GaugeStudy, study_by_anova, study_by_ranges
from softcal.core.quality.yields import Share, UnitRun, Yields, kind, yields
from softcal.core.unit.verdict import Release, Verdict
from softcal.db.registry import Registry

STUDY_COLUMNS = ("unit", "station", "trial", "value")
METHODS = {"anova": study_by_anova, "range": study_by_ranges}


def gauge_study(path: Path, method: str) -> GaugeStudy:
    """Read a crossed study (`unit, station, trial, value`) and split its variation.

    Raises:
        InputError: the file cannot be read, or some unit misses a station or a trial.
    """
    cells: dict[tuple[str, str, str], float] = {}
    for line, row in enumerate(_rows(path, STUDY_COLUMNS), 2):
        key = (row["unit"], row["station"], row["trial"])
        if key in cells:
            raise InputError(f"{path}, row {line}: unit {key[0]}, station {key[1]}, trial {key[2]} stands there twice")
        cells[key] = _number(path, line, row["value"])
    axes = [sorted({key[k] for key in cells}) for k in range(3)]
    for key in ((u, s, t) for u in axes[0] for s in axes[1] for t in axes[2]):
        if key not in cells:
            raise InputError(f"{path}: unit {key[0]} on station {key[1]} has no trial {key[2]}; all must be there")
    measured = [[[cells[u, s, t] for t in axes[2]] for s in axes[1]] for u in axes[0]]
    return METHODS[method](np.array(measured).reshape([len(axis) for axis in axes]))


def file_chart(path: Path, column: str) -> ControlChart:
    """Read one column of numbers in time order and make its control chart."""
    values = [_number(path, line, row[column]) for line, row in enumerate(_rows(path, (column,)), 2)]
    return control_chart(np.array(values))


def lot_capability(registry: Registry, lot_id: str, maximum: float | None) -> tuple[ControlChart, Capability]:
    """Return chart and capability of predicted errors against a maximum, else the limit.

    Raises:
        InputError: no limit was stated, or capability must be refused.
    """
    limit = maximum if maximum is not None else registry.lots.get(lot_id).limit_rmse
    if limit is None:
        raise InputError(f"lot {lot_id!r} has no stated limit; give --max")
    errors = [run.predicted_rmse for run in registry.lots.runs(lot_id) if run.predicted_rmse is not None]
    chart = control_chart(np.array(errors))
    return chart, capability(chart, None, limit)


def lot_yields(registry: Registry, lot_id: str, *, conditional_is_good: bool = False) -> Yields:
    """Count the yields of a lot; golden units are left out."""
    runs: dict[str, list[UnitRun]] = {}
    for run in registry.lots.runs(lot_id):
        runs.setdefault(run.serial, []).append(UnitRun(run.verdict, run.reasons))
    golden = {run.serial for run in registry.stations.golden_runs(lot_id=lot_id)}
    release = Release.CONDITIONAL if conditional_is_good else Release.PASS
    good = [verdict for verdict in Verdict if release.releases(verdict)]
    return yields(runs, golden, good)


def golden_charts(
    registry: Registry, station: str | None, serial: str | None, baseline: int | None
) -> dict[tuple[str, str, str], ControlChart]:
    """Return a control chart per station, lot and golden unit that has enough checks."""
    values: dict[tuple[str, str, str], list[float]] = {}
    for run in registry.stations.golden_runs(station, serial):
        values.setdefault((run.station, run.lot_id, run.serial), []).append(run.value)
    if not values:
        raise InputError("the registry holds no checks with golden units that fit")
    return {key: control_chart(np.array(series), baseline) for key, series in values.items()}


def study_json(study: GaugeStudy) -> dict[str, object]:
    """Return a gauge study as JSON values."""
    derived = {"grr": study.grr, "total": study.total, "grr_percent": study.grr_percent}
    return asdict(study) | derived | {"categories": study.categories, "word": study.word}


def chart_json(chart: ControlChart) -> dict[str, object]:
    """Return a control chart as JSON values."""
    limits = {"centre": chart.centre, "sigma": chart.sigma, "lower": chart.lower, "upper": chart.upper}
    signals = [asdict(signal) for signal in chart.signals]
    return limits | {"is_stable": chart.is_stable, "signals": signals, "values": chart.values.tolist()}


def yields_json(counts: Yields) -> dict[str, object]:
    """Return yields as JSON values."""
    shares = {
        name: {"count": share.count, "of": share.of, "value": share.value, "interval": list(share.interval)}
        for name, share in list_shares(counts)
    }
    return {**shares, "reasons": {kind(reason): count for reason, count in counts.reasons}}


def list_shares(counts: Yields) -> list[tuple[str, Share]]:
    """Return the shares under the names of a report."""
    names = ("first_pass", "second_pass", "last_pass", "runs")
    return [(name, getattr(counts, name)) for name in names]


def _rows(path: Path, columns: Sequence[str]) -> list[dict[str, str]]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = csv.DictReader(file)
            missing = [name for name in columns if name not in (rows.fieldnames or ())]
            if missing:
                raise InputError(f"{path}: no column {', '.join(missing)}; found {', '.join(rows.fieldnames or ())}")
            return list(rows)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: is no CSV file: {error}") from error


def _number(path: Path, line: int, text: str | None) -> float:
    try:
        value = float(text or "")
    except ValueError as error:
        raise InputError(f"{path}, row {line}: {text!r} is not a number") from error
    if not np.isfinite(value):
        raise InputError(f"{path}, row {line}: {text!r} is not a finite number")
    return value
