"""One line of warning where somebody uses a unit that did not pass, and a row of it in the audit trail."""

from softcal.core.errors import RegistryError
from softcal.core.unit.verdict import Verdict
from softcal.db.entries import StoredCalibration
from softcal.db.registry import Registry


def caution(registry: Registry, stored: StoredCalibration, action: str) -> str:
    """Return the warning, and record the use; empty where the unit passed.

    Args:
        registry: where the use is recorded.
        stored: the calibration that is used.
        action: what is done with it, for example `estimate`.
    """
    record = stored.record
    if record.verdict == Verdict.PASS:
        return ""
    why = str(record.reasons[0]) if record.reasons else "no reason is stored"
    warning = f"warning: unit {stored.serial} has the verdict {record.verdict}: {why}"
    facts = {"verdict": record.verdict, "revision": stored.revision, "action": action}
    try:
        key, reason = (stored.lot_id, stored.serial), f"{action} of a unit that did not pass"
        registry.add_event("use", "unit", key, facts, reason=reason)
    except RegistryError:
        # Who may only read must still be able to estimate; the line on the terminal is then all there is.
        return f"{warning}; this use could not be recorded, the registry cannot be written"
    return warning
