"""What changes how units of a lot are judged, and the judgement at once: no verdict outlives what it rests on."""

import json
from collections.abc import Iterable

from softcal.app.batch.audit import confirm_audit, update_lot
from softcal.app.batch.release import STATEMENT, is_stale, judge_lot
from softcal.core.quality.qualification import EARLIER_LOTS
from softcal.db.entries import LimitEntry
from softcal.db.registry import Registry


def change_limit(
    registry: Registry,
    lot_id: str,
    rmse: float | None,
    *,
    reason: str,
    actor: str | None = None,
    expected_version: int | None = None,
) -> LimitEntry:
    """Write the next version of a lot's limit and judge its units by it; arguments and errors of `set_limit`."""
    entry = registry.set_limit(lot_id, rmse, reason=reason, actor=actor, expected_version=expected_version)
    judge_again(registry, [lot_id], actor)
    return entry


def roll_back(
    registry: Registry,
    serial: str,
    to: int,
    *,
    reason: str,
    actor: str | None = None,
    lot_id: str | None = None,
    origin: str | None = None,
) -> int:
    """Bring an older revision of a unit back into use and judge it as it stands; arguments and errors of `rollback`."""
    revision = registry.rollback(serial, to, reason=reason, actor=actor, lot_id=lot_id, origin=origin)
    lots = [lot_id] if lot_id is not None else registry.lots_of(serial)
    judge_again(registry, lots, actor)
    return revision


def confirm(registry: Registry, lot_id: str, serial: str, *, reason: str, actor: str | None = None) -> None:
    """Let a doubted audit count, and judge the lot with it; arguments and errors of `confirm_audit`."""
    confirm_audit(registry, lot_id, serial, reason=reason, actor=actor)
    judge_again(registry, [lot_id], actor)


def judge_again(registry: Registry, lot_ids: Iterable[str], actor: str | None = None) -> None:
    """Judge lots anew, and those that lean on them; lots without a calibrated unit have nothing to judge."""
    for lot_id in lot_ids:
        judge_lot(registry, lot_id, actor)
        update_lot(registry, lot_id, actor)
        judge_leaning(registry, lot_id, actor)


def judge_leaning(registry: Registry, lot_id: str, actor: str | None = None) -> None:
    """Judge the lots anew that released units on the audits of other lots of this lot's sensor model.

    An audit or golden unit that failed withdraws what they were released on.
    """
    model = registry.lot(lot_id).sensor_model
    for lot in registry.lots():
        if not model or lot.sensor_model != model or lot.id == lot_id:
            continue
        told = registry.events(STATEMENT, (lot.id,))
        if told and json.loads(told[-1].after or "{}").get("qualification") == EARLIER_LOTS:
            judge_lot(registry, lot.id, actor)


def judge_stale(registry: Registry, actor: str | None = None) -> list[str]:
    """Judge the lots that have verdicts against another limit than the one in force, and return their ids.

    Two registries that come together may bring a limit to units that were judged without it.
    """
    lots = sorted({unit.lot_id for unit in registry.units() if is_stale(unit)})
    judge_again(registry, lots, actor)
    return lots
