"""Compare networks and map families on a lot's units: forecasts, and what audits say of them."""

from collections.abc import Callable, Mapping, Sequence
from statistics import median
from typing import Any

import numpy as np

from softcal.app.batch.calibrating import LotFacts, UnitInputs, calibrate_unit
from softcal.app.batch.known import KeptFacts, lot_facts
from softcal.app.registry.lot_recordings import source_model, unlabelled
from softcal.core.maps.config import MapConfig
from softcal.core.recording import OutputRecording
from softcal.core.unit.calibration import CalibrationRecord
from softcal.core.unit.method import Method
from softcal.core.unit.verdict import Verdict
from softcal.db.registry import Registry

Tell = Callable[[float, str], None]
Unit = tuple[OutputRecording, UnitInputs]


def compare_on_lot(registry: Registry, request: Mapping[str, Any], tell: Tell) -> list[dict[str, object]]:
    """Map the same units with every network and family and return one row each.

    Args:
        request: lot, networks (ids), families (or auto), units (how many at most).

    Raises:
        InputError: a lot, network or source recording is not in the registry.
    """
    lot = registry.lots.get(request["lot"])
    newest = {entry.serial: entry.sha256 for entry in registry.recordings.of_lot(lot.id, kind="unit")}
    kept = KeptFacts(registry, lot.id, list(newest))
    # Those with an audit first: they say most.
    chosen = sorted(newest, key=lambda serial: (serial not in kept.audits, serial))[: int(request["units"])]
    units = [(unlabelled(registry.recordings.get(newest[serial])), kept.of(serial)) for serial in chosen]
    pairs = [(network, family) for network in request["networks"] for family in request["families"]]
    rows = []
    for k, (network_id, family) in enumerate(pairs):
        tell(k / len(pairs), f"{network_id[:12]}, {family}")
        model = source_model(registry, network_id, Method(map=MapConfig(family)))
        facts = lot_facts(registry, lot, [model], golden=kept.golden_runs)
        rows.append({"network": network_id, "family": family, **_row(facts, units)})
    return rows


def _row(facts: LotFacts, units: Sequence[Unit]) -> dict[str, object]:
    made = [calibrate_unit(facts, recording, known) for recording, known in units]
    records = [one for one in made if isinstance(one, CalibrationRecord)]
    after = [one.after_rmse for one in records if one.after_rmse is not None]
    return {
        "units": len(units),
        "passed": sum(one.verdict == Verdict.PASS for one in records),
        "refused": len(made) - len(records),
        "audited": len(after),
        "predicted": _median([one.predicted_rmse for one in records if one.predicted_rmse is not None]),
        "before": _median([one.before_rmse for one in records if one.before_rmse is not None]),
        "after": _median(after),
        "after_95": float(np.quantile(after, 0.95)) if after else None,
    }


def _median(values: Sequence[float]) -> float | None:
    return median(values) if values else None
