"""One line of warning where somebody uses a unit that does not pass, and a row of it in the audit trail."""

from softcal.app.registry.standing import standing_of
from softcal.core.errors import RegistryError
from softcal.core.unit.verdict import Verdict
from softcal.db.entries import StoredCalibration
from softcal.db.registry import Registry


def caution(registry: Registry, stored: StoredCalibration, action: str) -> str:
    """Return the warning, and record the use; empty where the calibration passed and the unit still does.

    Args:
        stored: the calibration that is used.
        action: what is done with it, for example `estimate`.
    """
    standing = standing_of(registry, stored)
    # An older calibration that passed is cautioned against where the unit does not pass any more.
    is_bad = standing.made is not None and stored.record.verdict != Verdict.PASS
    told = stored.record if is_bad else standing
    if told.verdict == Verdict.PASS:
        return ""
    why = str(told.reasons[0]) if told.reasons else "no reason is stored"
    warning = f"warning: unit {stored.serial} has the verdict {told.verdict}: {why}"
    facts = {"verdict": told.verdict, "revision": stored.revision, "action": action}
    try:
        key, reason = (stored.lot_id, stored.serial), f"{action} of a unit that did not pass"
        registry.add_event("use", "unit", key, facts, reason=reason)
    except RegistryError:
        # Who may only read must still be able to estimate; the line on the terminal is then all there is.
        return f"{warning}; this use could not be recorded, the registry cannot be written"
    return warning
