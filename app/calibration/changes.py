"""What an act would change of the verdicts of a lot: the act itself, done in a transaction that is not kept."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

from softcal.app.calibration.redecision import redecide
from softcal.app.registry.exported_files import Recall, list_recalls
from softcal.core.messages.reason import Reason
from softcal.core.unit.verdict import VERDICTS, Verdict
from softcal.db.registry import Registry


@dataclass(frozen=True)
class VerdictChange:
    """A unit whose verdict another one replaces, and why."""

    lot_id: str
    serial: str
    verdict: str
    next_verdict: str
    reason: Reason


@dataclass(frozen=True)
class Changes:
    """What an act changes.

    Args:
        changed: every unit whose verdict another one replaces, the withdrawn first.
        counts: units of the lot by verdict after the act.
        recalled: files that were given out and no longer hold after it.
    """

    changed: tuple[VerdictChange, ...]
    counts: dict[str, int]
    recalled: tuple[Recall, ...] = ()

    @property
    def withdrawn(self) -> tuple[VerdictChange, ...]:
        """Units that pass and would not any more."""
        return tuple(one for one in self.changed if one.verdict == Verdict.PASS)

    @property
    def released(self) -> tuple[VerdictChange, ...]:
        """Units that would pass and do not yet."""
        return tuple(one for one in self.changed if one.next_verdict == Verdict.PASS)

    def to_json(self) -> dict[str, object]:
        rows = [{**vars(one), "reason": str(one.reason)} for one in self.changed]
        return {
            "changed": rows,
            "counts": self.counts,
            "withdrawn": len(self.withdrawn),
            "released": len(self.released),
            "recalled": [one.to_json() for one in self.recalled],
        }


class _PreviewRollback(Exception):  # noqa: N818 - no error: it ends a transaction
    pass


def preview(registry: Registry, lot_id: str, act: Callable[[], object]) -> Changes:
    """Return what an act on a lot would change; nothing is kept.

    Raises:
        InputError: the act is refused, for the reason that it would be.
    """
    changes = Changes((), {})
    try:
        with registry.transaction():
            changes = carry_out(registry, lot_id, act)
            raise _PreviewRollback
    except _PreviewRollback:
        return changes


def carry_out(registry: Registry, lot_id: str, act: Callable[[], object]) -> Changes:
    """Do an act on a lot, and return what it changed.

    Raises:
        InputError: the act is refused, for its own reason.
    """
    before, lots = read_verdicts(registry, lot_id), list_affected_lots(registry, lot_id)
    old = set(list_recalls(registry, lots))
    act()
    changes = compare_verdicts(registry, lot_id, before)
    return replace(changes, recalled=tuple(one for one in list_recalls(registry, lots) if one not in old))


def change_limit(
    registry: Registry,
    lot_id: str,
    rmse: float | None,
    *,
    reason: str,
    actor: str | None = None,
    expected_version: int | None = None,
) -> None:
    """Set the limit of a lot and judge every unit by it, or nothing of both.

    Raises:
        InputError: as `Registry.lots.set_limit`.
    """
    with registry.transaction():
        registry.lots.set_limit(lot_id, rmse, reason=reason, actor=actor, expected_version=expected_version)
        redecide(registry, [lot_id], actor)


def preview_limit(registry: Registry, lot_id: str, rmse: float | None) -> Changes:
    """Return what another limit would change; nothing is kept."""
    return preview(registry, lot_id, partial(change_limit, registry, lot_id, rmse, reason="preview"))


Verdicts = dict[tuple[str, str], str]


def read_verdicts(registry: Registry, lot_id: str) -> Verdicts:
    """Return the verdict of every unit that an act on the lot may reach, by lot and serial."""
    lots = list_affected_lots(registry, lot_id)
    return {(lot, serial): verdict for lot in lots for serial, verdict in registry.pages.verdicts(lot).items()}


def list_affected_lots(registry: Registry, lot_id: str) -> list[str]:
    """Return the lots that an act on one of them may reach: those of its sensor model."""
    model = registry.lots.get(lot_id).sensor_model
    return sorted({lot_id, *(lot.id for lot in registry.lots.all() if model and lot.sensor_model == model)})


def compare_verdicts(registry: Registry, lot_id: str, before: Verdicts) -> Changes:
    """Return what changed of units that had a verdict before."""
    after = read_verdicts(registry, lot_id)
    keys = {key for key, verdict in after.items() if before.get(key, verdict) != verdict}
    units = [unit for lot in {lot for lot, _ in keys} for unit in registry.lots.units(lot)]
    changed = [
        VerdictChange(*key, before[key], after[key], unit.reasons[0])
        for unit in units
        if (key := (unit.lot_id, unit.serial)) in keys and unit.reasons
    ]
    verdicts: Sequence[str] = [verdict for (lot, _), verdict in after.items() if lot == lot_id]
    ordered = sorted(changed, key=lambda one: (one.verdict != Verdict.PASS, one.lot_id, one.serial))
    return Changes(tuple(ordered), {str(word): verdicts.count(word) for word in VERDICTS})
