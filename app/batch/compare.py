"""Compare networks and map families on the units of a lot: what each forecasts, and what audits say of it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np

from softcal.app.registry.audits import audit_of, newest_audits
from softcal.app.registry.reference import lot_reference
from softcal.app.registry.source import source_model, unlabelled
from softcal.core.errors import UnitRefused
from softcal.core.maps.config import MapConfig
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.unit.budget import Reference
from softcal.core.unit.calibrate import UnitProblem, calibrate
from softcal.core.unit.method import Method
from softcal.core.unit.source_model import SourceModel
from softcal.core.unit.verdict import Limit, Verdict, stated_limit
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
    limit, reference = stated_limit(lot.reference_unit, lot.limit_rmse), lot_reference(registry, lot.id)
    pairs = [(network, family) for network in request["networks"] for family in request["families"]]
    rows = []
    for k, (network_id, family) in enumerate(pairs):
        tell(k / len(pairs), f"{network_id[:12]}, {family}")
        model = source_model(registry, network_id, Method(map=MapConfig(family)))
        rows.append({"network": network_id, "family": family, **_row(model, units, limit, reference)})
    return rows


def _units(registry: Registry, lot_id: str, most: int) -> list[_Unit]:
    """Return the newest recording of each unit, those with an audit first: they say most."""
    newest = {entry.serial: entry.sha256 for entry in registry.recordings(lot_id, kind="unit")}
    audits = newest_audits(registry, lot_id)
    chosen = sorted(newest, key=lambda serial: (serial not in audits, serial))[:most]
    return [
        _Unit(unlabelled(registry.recording(newest[serial])), audit_of(registry, audits.get(serial)))
        for serial in chosen
    ]


def _row(
    model: SourceModel, units: Sequence[_Unit], limit: Limit | None, reference: Reference | None
) -> dict[str, object]:
    predicted: list[float] = []
    before: list[float] = []
    after: list[float] = []
    passed = refused = 0
    for unit in units:
        try:
            found = calibrate(UnitProblem(model, unit.recording, limit, audit=unit.audit, reference=reference))
        except UnitRefused:
            refused += 1
            continue
        passed += found.decision.verdict is Verdict.PASS
        predicted += [] if found.predicted_rmse is None else [found.predicted_rmse]
        if found.scores is not None:
            before.append(found.scores.before)
            after.append(found.scores.after)
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
