"""What the source of a lot was compared with: stated once, kept in the audit trail, completed from the registry."""

import json
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import numpy as np

from softcal.core.recording import LabelledRecording
from softcal.core.unit.budget import Reference
from softcal.core.unit.method import DecisionConfig
from softcal.db.registry import Registry

ENTITY = "lot_reference"


def state_reference(
    registry: Registry, lot_id: str, stated: Reference | None, source: LabelledRecording, actor: str | None = None
) -> Reference | None:
    """Keep what is stated of a lot's reference, and return what is in force for its units.

    Args:
        source: what was recorded with it: at its RMS load the reference's U counts against the limit.
        stated: None where nothing is stated; what was stated before stays in force then. A reference that only names
            its instrument gets the certificate that the registry has of it on the day of use, else the newest one.
    """
    if stated is None:
        return lot_reference(registry, lot_id)
    found = stated if stated.is_simulated else _completed(registry, lot_id, stated)
    facts = {"reference": found.to_json(), "source_rms": float(np.sqrt(np.mean(source.reference**2)))}
    if facts != _stated(registry, lot_id):
        registry.trail.add("state", ENTITY, (lot_id,), facts, actor=actor)
    return found


def lot_reference(registry: Registry, lot_id: str) -> Reference | None:
    """Return what was stated last; None where nobody said."""
    stated = _stated(registry, lot_id)
    return None if stated is None else Reference.of(stated["reference"])


def reference_expanded(registry: Registry, lot_id: str) -> float:
    """Return U of a lot's reference as it counts against the limit, in the reference unit; 0 where nobody stated it."""
    stated = _stated(registry, lot_id)
    if stated is None:
        return 0.0
    return Reference.of(stated["reference"]).expanded(stated["source_rms"], DecisionConfig().coverage_factor)


def _stated(registry: Registry, lot_id: str) -> dict[str, Any] | None:
    told = registry.trail.of(ENTITY, (lot_id,))
    facts: dict[str, Any] | None = json.loads(told[-1].after or "{}") if told else None
    return facts


def _completed(registry: Registry, lot_id: str, stated: Reference) -> Reference:
    if stated.used_on is None:
        sources = registry.recordings.of_lot(lot_id, kind="source")
        used_at = sources[-1].added_at if sources else datetime.now(UTC)
        stated = replace(stated, used_on=used_at.astimezone().date())
    if stated.certificate or not stated.cell or stated.used_on is None:
        return stated
    known = registry.stations.certificate(stated.cell, stated.used_on) or next(
        reversed(registry.stations.certificates(stated.cell)), None
    )
    if known is None:
        return stated
    return replace(
        stated,
        certificate=known.number,
        laboratory=known.laboratory,
        issued_on=known.issued_on,
        due_on=known.due_on,
        uncertainty=known.uncertainty_N,
        capacity=known.capacity_N,
    )
