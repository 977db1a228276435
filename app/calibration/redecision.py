"""Decide again where something changed that verdicts rest on: no verdict outlives it.

Whoever sets a limit, confirms, brings audits or syncs calls `redecide` after it.
"""

from collections.abc import Iterable

from softcal.app.calibration.audit import update_lot
from softcal.app.calibration.lot_decision import decision_in_force
from softcal.app.calibration.release import redecide_lot
from softcal.core.errors import InputError
from softcal.core.quality.qualification import EARLIER_LOTS
from softcal.db.registry import Registry
from softcal.db.repositories.lot_pages import is_stale


def confirm(registry: Registry, lot_id: str, serial: str, *, reason: str, actor: str | None = None) -> None:
    """Write down that the audit of a unit is what it is said to be, and decide on the lot with it.

    Raises:
        InputError: nobody suspects it, or no reason was given.
    """
    status = registry.pages.unit_statuses(lot_id, [serial], has_stale=True).get(serial)
    state = None if status is None else status.state
    if state is None or state.audit is None or state.suspect_audit is None:
        raise InputError(f"the audit of {serial} in lot {lot_id!r} is not in doubt; there is nothing to confirm")
    if not reason.strip():
        raise InputError(f"say why the audit of {serial} is right in spite of the doubt; a reason was expected")
    values = {"lot_id": lot_id, "serial": serial, "doubt": state.suspect_audit.to_json()}
    values |= {"output_sha256": state.audit.output_sha256}
    registry.declarations.declare("confirmed_audits", values, action="confirm", reason=reason, actor=actor)
    redecide(registry, [lot_id], actor)


def redecide(registry: Registry, lot_ids: Iterable[str], actor: str | None = None) -> None:
    """Decide on lots again, and on those that were released on their audits."""
    for lot_id in lot_ids:
        redecide_lot(registry, lot_id, actor)
        update_lot(registry, lot_id, actor)
        redecide_dependent_lots(registry, lot_id, actor)


def redecide_dependent_lots(registry: Registry, lot_id: str, actor: str | None = None) -> None:
    """Decide again on the lots that released units on audits of other lots of this sensor model.

    An audit or golden unit that failed withdraws what they were released on.
    """
    model = registry.lots.get(lot_id).sensor_model
    for lot in registry.lots.all():
        if not model or lot.sensor_model != model or lot.id == lot_id:
            continue
        if decision_in_force(registry, lot.id).source == EARLIER_LOTS:
            redecide_lot(registry, lot.id, actor)


def redecide_stale(registry: Registry) -> list[str]:
    """Decide again on the lots with verdicts against another limit than the one in force; return their ids.

    Two registries that come together may bring a limit to units that were judged without it.
    """
    lots = sorted({unit.lot_id for unit in registry.lots.units() if is_stale(unit)})
    redecide(registry, lots)
    return lots
