"""The calibration that a trim began from."""

from softcal.db.entries import StoredCalibration
from softcal.db.registry import Registry

UNTRIMMED = "untrimmed_revision"
"""Number among a trimmed calibration's evidence: the revision it was made from."""


def untrimmed(registry: Registry, stored: StoredCalibration) -> StoredCalibration:
    """Return the calibration behind trims, and behind what audits of other units said: a new trim replaces them.

    Those audits are asked again what the trimmed one is worth; what trims leave open does not add up.
    """
    evidence = stored.record.evidence
    revision = evidence.get(UNTRIMMED, evidence.get("base_revision"))
    if revision is None:
        return stored
    return registry.calibration(stored.serial, int(revision), lot_id=stored.lot_id)
