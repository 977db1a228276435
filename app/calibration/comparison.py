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

Tell = Callable[[float, str], None]


def compare_on_lot(registry: Registry, request: Mapping[str, Any], tell: Tell) -> list[dict[str, object]]:
    """Map the same units with every network and family and return one row each. The request has
    lot, networks (ids), families (or auto) and how many units at most.

    Raises:
        InputError: a lot, network or source recording is not in the registry.
    """
    lot = registry.lots.get(request["lot"])
    newest = {entry.serial: entry.sha256 for entry in registry.recordings.of_lot(lot.id, kind="unit")}
    kept = StoredInputs(registry, lot.id, list(newest))
    # Those with an audit first: they say most.
    chosen = sorted(newest, key=lambda serial: (serial not in kept.audits, serial))[: int(request["units"])]
    units = [(unlabelled(registry.recordings.get(newest[serial])), kept.unit(serial)) for serial in chosen]
    pairs = [(network, family) for network in request["networks"] for family in request["families"]]
    rows: list[dict[str, object]] = []
    for k, (network_id, family) in enumerate(pairs):
        tell(k / len(pairs), f"{network_id[:12]}, {family}")
        model = source_model(registry, network_id, Method.with_family(family))
        facts = read_lot_context(registry, lot, [model], golden=kept.golden_runs)
        made = [calibrate_unit(facts, recording, known) for recording, known in units]
        states = [one.state for one in made if isinstance(one, Calibrated)]
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
                "refused": len(made) - len(states),
                "audited": len(after),
                **{name: median(known) if known else None for name, known in errors.items()},
                "after_95": float(np.quantile(after, 0.95)) if after else None,
            }
        )
    return rows
