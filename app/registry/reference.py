"""Reference of a lot's source: stated once, completed from the registry."""

from dataclasses import fields, replace
from datetime import UTC, datetime

import numpy as np

from softcal.core.recording import LabelledRecording
from softcal.core.unit.budget import Reference
from softcal.db.registry import Registry


def declare_reference(
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
    complete = reference if reference.is_simulated else _complete_reference(registry, lot_id, reference)
    values = {"lot_id": lot_id, **vars(complete), "source_rms": float(np.sqrt(np.mean(source.reference**2)))}
    registry.declarations.declare("lot_references", values, actor=actor)
    return complete


def lot_reference(registry: Registry, lot_id: str) -> Reference | None:
    """Return the last stated reference of a lot, or None."""
    values = registry.declarations.newest("lot_references", lot_id)
    return None if values is None else Reference(**{one.name: values[one.name] for one in fields(Reference)})


def reference_expanded(registry: Registry, lot_id: str) -> float | None:
    """Return the expanded uncertainty U of a lot's reference, in the reference unit, or None."""
    reference, values = lot_reference(registry, lot_id), registry.declarations.newest("lot_references", lot_id)
    return None if reference is None or values is None else reference.expanded(values["source_rms"])


def _complete_reference(registry: Registry, lot_id: str, reference: Reference) -> Reference:
    if reference.used_on is None:
        sources = registry.recordings.of_lot(lot_id, kind="source")
        used_at = sources[-1].added_at if sources else datetime.now(UTC)
        reference = replace(reference, used_on=used_at.astimezone().date())
    if reference.certificate or not reference.cell or reference.used_on is None:
        return reference
    certificate = registry.stations.certificate(reference.cell, reference.used_on) or next(
        reversed(registry.stations.certificates(reference.cell)), None
    )
    if certificate is None:
        return reference
    values = {name: getattr(certificate, name) for name in ("laboratory", "issued_on", "due_on")}
    return replace(
        reference,
        certificate=certificate.number,
        uncertainty=certificate.uncertainty_N,
        capacity=certificate.capacity_N,
        **values,
    )
