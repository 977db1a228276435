"""Status of a unit: a refusal newer than its calibration leaves no map to export.

Whoever gives out files, warns at use or shows a verdict asks here: all say the same word.
"""

from softcal.core.errors import RegistryError
from softcal.core.messages.reason import plain
from softcal.core.unit.verdict import Verdict
from softcal.db.entries import UNDECIDED, StoredCalibration, UnitResult
from softcal.db.registry import Registry


def find_unit_status(registry: Registry, stored: StoredCalibration) -> UnitResult:
    """Return the present status of the unit of a calibration; `calibration` is None after a refusal."""
    status = registry.pages.unit_statuses(stored.lot_id, [stored.serial]).get(stored.serial)
    undecided = UnitResult(stored.serial, UNDECIDED, (plain("none of its calibrations is in use"),), stored.made_at)
    return undecided if status is None else status


def caution(registry: Registry, stored: StoredCalibration, action: str) -> str:
    """Return the warning, and record the use; empty where the unit passed and still does."""
    status = find_unit_status(registry, stored)
    # An older calibration that passed is cautioned against where the unit does not pass any more.
    verdict, reasons = status.verdict, status.reasons
    if status.calibration is not None and not stored.state.is_released:
        verdict, reasons = str(stored.state.verdict), stored.state.decision.reasons
    if verdict == Verdict.PASS:
        return ""
    cause = str(reasons[0]) if reasons else "no reason is stored"
    warning = f"warning: unit {stored.serial} has the verdict {verdict}: {cause}"
    details = {"verdict": verdict, "revision": stored.revision, "action": action}
    try:
        key, reason = (stored.lot_id, stored.serial), f"{action} of a unit that did not pass"
        registry.trail.add("use", "unit", key, details, reason=reason)
    except RegistryError:
        # Who may only read must still be able to estimate; the line is then all there is.
        return f"{warning}; this use could not be recorded, the registry cannot be written"
    return warning
