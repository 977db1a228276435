"""Compare networks and map families on a lot's units: forecasts, and what audits say of them."""

from collections.abc import Callable, Mapping
from statistics import median
from typing import Any

import numpy as np

from softcal.app.calibration.lot_context import StoredInputs, read_lot_context
from softcal.app.calibration.unit_calibration import Calibrated, calibrate_unit
from softcal.app.registry.lot_recordings import source_model, unlabelled
from softcal.core.unit.method import Method
from softcal.db.registry import Registry

OnProgress = Callable[[float, str], None]


def compare_on_lot(registry: Registry, request: Mapping[str, Any], on_progress: OnProgress) -> list[dict[str, object]]:
    """Map the same units with every network and family and return one row each. The request has
    lot, networks (ids), families (or auto) and how many units at most.

    Raises:
        InputError: a lot, network or source recording is not in the registry.
    """
    lot = registry.lots.get(request["lot"])
    newest = {entry.serial: entry.sha256 for entry in registry.recordings.of_lot(lot.id, kind="unit")}
    stored = StoredInputs(registry, lot.id, list(newest))
    # Those with an audit first: they say most.
    chosen = sorted(newest, key=lambda serial: (serial not in stored.audits, serial))[: int(request["units"])]
    units = [(unlabelled(registry.recordings.get(newest[serial])), stored.unit(serial)) for serial in chosen]
    pairs = [(network, family) for network in request["networks"] for family in request["families"]]
    rows: list[dict[str, object]] = []
    for k, (network_id, family) in enumerate(pairs):
        on_progress(k / len(pairs), f"{network_id[:12]}, {family}")
        model = source_model(registry, network_id, Method.with_family(family))
        context = read_lot_context(registry, lot, [model], golden=stored.golden_runs)
        results = [calibrate_unit(context, recording, data) for recording, data in units]
        states = [one.state for one in results if isinstance(one, Calibrated)]
        scores = [state.scores for state in states if state.scores is not None]
        errors: dict[str, list[float]] = {
            "predicted": [state.predicted_rmse for state in states],
            "before": [one.before.rmse for one in scores],
            "after": [one.after.rmse for one in scores],
        }
        after = errors["after"]
        rows.append(
            {
                "network": network_id,
                "family": family,
                "units": len(units),
                "passed": sum(state.is_released for state in states),
                "refused": len(results) - len(states),
                "audited": len(after),
                **{name: median(data) if data else None for name, data in errors.items()},
                "after_95": float(np.quantile(after, 0.95)) if after else None,
            }
        )
    return rows
