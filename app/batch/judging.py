"""Judge lots at once where something changed that their verdicts rest on: no verdict outlives it.

Whoever sets a limit, rolls back, trims, confirms or syncs calls `judge_again` after it.
"""

from collections.abc import Iterable

from softcal.app.batch.audit import CONFIRMED, update_lot
from softcal.app.batch.release import STATEMENT, is_stale, judge_lot
from softcal.app.registry.stated import stated
from softcal.core.errors import InputError
from softcal.core.quality.qualification import EARLIER_LOTS
from softcal.db.registry import Registry


def confirm(registry: Registry, lot_id: str, serial: str, *, reason: str, actor: str | None = None) -> None:
    """Write down that the audit of a unit is what it is said to be, and judge the lot with it.

    Raises:
        InputError: nobody doubts it, or no reason was given.
    """
    standing = registry.pages.standings(lot_id, [serial]).get(serial)
    made = None if standing is None else standing.made
    if made is None or made.audit is None or made.decision.doubt is None:
        raise InputError(f"the audit of {serial} in lot {lot_id!r} is not in doubt; there is nothing to confirm")
    if not reason.strip():
        raise InputError(f"say why the audit of {serial} is right in spite of the doubt; a reason was expected")
    facts = {"serial": serial, "output_sha256": made.audit.output_sha256, "doubt": made.decision.doubt.to_json()}
    registry.trail.add("confirm", CONFIRMED, (lot_id,), facts, reason=reason, actor=actor)
    judge_again(registry, [lot_id], actor)


def judge_again(registry: Registry, lot_ids: Iterable[str], actor: str | None = None) -> None:
    """Judge lots anew, and those that lean on them."""
    for lot_id in lot_ids:
        judge_lot(registry, lot_id, actor)
        update_lot(registry, lot_id, actor)
        judge_leaning(registry, lot_id, actor)


def judge_leaning(registry: Registry, lot_id: str, actor: str | None = None) -> None:
    """Judge the lots anew that released units on audits of other lots of this sensor model.

    An audit or golden unit that failed withdraws what they were released on.
    """
    model = registry.lots.get(lot_id).sensor_model
    for lot in registry.lots.all():
        if not model or lot.sensor_model != model or lot.id == lot_id:
            continue
        if (stated(registry, STATEMENT, (lot.id,)) or {}).get("qualification") == EARLIER_LOTS:
            judge_lot(registry, lot.id, actor)


def judge_stale(registry: Registry) -> list[str]:
    """Judge the lots with verdicts against another limit than the one in force; return their ids.

    Two registries that come together may bring a limit to units that were judged without it.
    """
    lots = sorted({unit.lot_id for unit in registry.lots.units() if is_stale(unit)})
    judge_again(registry, lots)
    return lots
