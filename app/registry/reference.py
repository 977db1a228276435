"""Reference of a lot's source: stated once, completed from the registry."""

from dataclasses import fields, replace
from datetime import UTC, datetime

import numpy as np

from softcal.core.recording import LabelledRecording
from softcal.core.unit.budget import Reference
from softcal.db.registry import Registry


def state_reference(
    registry: Registry, lot_id: str, reference: Reference | None, source: LabelledRecording, actor: str | None = None
) -> Reference | None:
    """Store the stated reference of a lot, and return the reference in force for its units.

    Args:
        source: recorded with it: at its RMS load the reference's U counts.
        reference: None where nothing is stated; what was stated before stays in force then. One that only names its
            instrument gets the certificate that the registry has of it on the day of use, else the newest one.
    """
    if reference is None:
        return lot_reference(registry, lot_id)
    completed = reference if reference.is_simulated else _completed(registry, lot_id, reference)
    facts = {"lot_id": lot_id, **vars(completed), "source_rms": float(np.sqrt(np.mean(source.reference**2)))}
    registry.declarations.declare("lot_references", facts, actor=actor)
    return completed


def lot_reference(registry: Registry, lot_id: str) -> Reference | None:
    """Return the last stated reference of a lot, or None."""
    facts = registry.declarations.newest("lot_references", lot_id)
    return None if facts is None else Reference(**{one.name: facts[one.name] for one in fields(Reference)})


def reference_expanded(registry: Registry, lot_id: str) -> float | None:
    """Return the expanded uncertainty U of a lot's reference, in the reference unit, or None."""
    reference, facts = lot_reference(registry, lot_id), registry.declarations.newest("lot_references", lot_id)
    return None if reference is None or facts is None else reference.expanded(facts["source_rms"])


def _completed(registry: Registry, lot_id: str, given: Reference) -> Reference:
    if given.used_on is None:
        sources = registry.recordings.of_lot(lot_id, kind="source")
        used_at = sources[-1].added_at if sources else datetime.now(UTC)
        given = replace(given, used_on=used_at.astimezone().date())
    if given.certificate or not given.cell or given.used_on is None:
        return given
    known = registry.stations.certificate(given.cell, given.used_on) or next(
        reversed(registry.stations.certificates(given.cell)), None
    )
    if known is None:
        return given
    facts = {name: getattr(known, name) for name in ("laboratory", "issued_on", "due_on")}
    return replace(given, certificate=known.number, uncertainty=known.uncertainty_N, capacity=known.capacity_N, **facts)
