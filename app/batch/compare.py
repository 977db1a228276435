"""Compare networks and map families on the units of a lot: what each forecasts, and what audits say of it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np

from softcal.core.errors import UnitRefused
from softcal.core.maps.choose import MapConfig
from softcal.core.maps.interface import FitProblem
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.unit.calibrate import CalibrationConfig, calibrate_unit
from softcal.core.unit.scoring import score_map
from softcal.core.unit.source_model import SourceModel, make_source_model
from softcal.core.unit.verdict import Limit
from softcal.db.registry import Registry

Tell = Callable[[float, str], None]


@dataclass(frozen=True, eq=False)
class _Unit:
    recording: OutputRecording
    audit: LabelledRecording | None


def compare_on_lot(registry: Registry, request: Mapping[str, Any], tell: Tell) -> list[dict[str, object]]:
    """Map the same units with every network and family and return one row each.

    Args:
        request: lot, networks (ids), families (of the catalogue, or auto), units (how many at most).
        tell: told fraction and a sentence.

    Raises:
        InputError: a lot, network or source recording is not in the registry.
    """
    lot = registry.lot(request["lot"])
    units = _units(registry, lot.id, int(request["units"]))
    limit = None if lot.limit_rmse is None else Limit(lot.reference_unit, lot.limit_rmse)
    pairs = [(network, family) for network in request["networks"] for family in request["families"]]
    rows, models = [], {name: _model(registry, name) for name in dict.fromkeys(request["networks"])}
    for k, (network_id, family) in enumerate(pairs):
        tell(k / len(pairs), f"{network_id[:12]}, {family}")
        rows.append({"network": network_id, "family": family, **_row(models[network_id], units, family, limit)})
    return rows


def _model(registry: Registry, network_id: str) -> SourceModel:
    sha256 = str(registry.network_entry(network_id).training["source_recording_sha256"])
    source = registry.recording(sha256)
    if not isinstance(source, LabelledRecording):
        raise ValueError("a source recording without reference")
    return make_source_model(source, registry.network(network_id))


def _units(registry: Registry, lot_id: str, most: int) -> list[_Unit]:
    """Return the newest recording of each unit, those with an audit first: they say most."""
    newest = {entry.serial: entry.sha256 for entry in registry.recordings(lot_id, kind="unit")}
    audits = {entry.serial: entry.sha256 for entry in registry.recordings(lot_id, kind="audit")}
    chosen = sorted(newest, key=lambda serial: (serial not in audits, serial))[:most]
    return [_Unit(_output(registry, newest[serial]), _labelled(registry, audits.get(serial))) for serial in chosen]


def _output(registry: Registry, sha256: str) -> OutputRecording:
    found = registry.recording(sha256)
    return found.unlabelled if isinstance(found, LabelledRecording) else found


def _labelled(registry: Registry, sha256: str | None) -> LabelledRecording | None:
    found = None if sha256 is None else registry.recording(sha256)
    return found if isinstance(found, LabelledRecording) else None


def _row(model: SourceModel, units: Sequence[_Unit], family: str, limit: Limit | None) -> dict[str, object]:
    predicted: list[float] = []
    before: list[float] = []
    after: list[float] = []
    passed = refused = 0
    for unit in units:
        try:
            problem = FitProblem(model.source, model.network, unit.recording, None)
            found = calibrate_unit(problem, limit, CalibrationConfig(MapConfig(family)), model)
        except UnitRefused:
            refused += 1
            continue
        passed += found.verdict.word == "pass"
        predicted += [] if found.predicted_rmse is None else [found.predicted_rmse]
        if unit.audit is not None:
            scores = score_map(model.network, found.unit_map, unit.audit, None)
            before.append(scores.before)
            after.append(scores.after)
    return {
        "units": len(units),
        "passed": passed,
        "refused": refused,
        "audited": len(after),
        "predicted": _median(predicted),
        "before": _median(before),
        "after": _median(after),
        "after_95": float(np.quantile(after, 0.95)) if after else None,
    }


def _median(values: Sequence[float]) -> float | None:
    return median(values) if values else None
